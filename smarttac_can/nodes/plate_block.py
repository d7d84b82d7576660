"""The function block of the plate: an object dictionary and the simulated plate, without CAN."""

from __future__ import annotations

from enum import Enum
from typing import Final

from smarttac_can.nodes.hard_caps import PLATE_CAPS, require_caps
from smarttac_can.nodes.stage_state import StageEvent, StageState, follow
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import Entry, ObjectDictionary
from smarttac_can.od.scaling import Quantiser
from smarttac_can.plant.faults import Fault
from smarttac_can.plant.finger import Finger, Lifted, Stroke, Trajectory
from smarttac_can.plant.fitted import FITTED
from smarttac_can.plant.parameters import PlateParameters
from smarttac_can.plant.plate import Plate
from smarttac_can.plant.stage import PowerStage
from smarttac_can.plant.subjects import SUBJECTS
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.objects import FAULT_KIND, RECORDED, START_RUN, STROKE
from smarttac_can.vocabulary.signals import Drive

TICK_MASK: Final = 0xFF
"""Bits of the tick count in a frame: 8."""
_NEVER: Final = -1
# What every cycle asks for stands here: looking a member of an enumeration up costs much more.
_IN_USE: Final = StageState.IN_USE
_BARRED: Final = (StageState.WAITING, StageState.TRIPPED)
_FINGERS: Final = (*SUBJECTS, *(fitted.subject for fitted in FITTED))
"""What *Simulation.Subject* numbers, from 1."""
STAGE_TOLERANCE: Final = 1.0
"""Largest difference in V between what the power stage was told and what it reads back."""


class Taken(Enum):
    """What became of a drive."""

    NOT = "ignored"
    LATE = "taken; it was not in time"
    IN_TIME = "taken"
    DISOBEYED = "the power stage does not obey it"


class PlateBlock:
    """The simulated plate behind the objects of ``plate.eds``.

    The plate moves by calls of `cycle` and by nothing else, so a run gives the same numbers at any
    pace. It knows nothing of the bus: the plate node calls it, and so does a stimulator that has
    the plate inside.

    Parameters
    ----------
    od
        Object dictionary of ``plate.eds``.
    recording
        The finger of motion 2; without one, that motion is refused.

    Raises
    ------
    ValueError
        If the object dictionary goes beyond the hard caps.

    Attributes
    ----------
    plate
        The plate of the present run, for tests and reports.
    state
        State of the power stage, to look at; `bar` and drives change it.
    session
        What the second tick of a measurement is ahead of the first, 0..255.
    told
        What the power stage is told, in V; it may put out something else.
    """

    def __init__(self, od: ObjectDictionary, recording: Trajectory | None = None) -> None:
        require_caps(od, PLATE_CAPS)
        self.od = od
        self._recording = recording
        self.state = StageState.WAITING
        self._voltage = od["Drive.Voltage"]
        self._frequency = od["Drive.Frequency"]
        self._drive_tick = od["Drive.Tick"]
        self.tick = od["Vibration.Tick"]
        self._gauge_tick = od["Gauge tick"]
        self.session = 0
        self._saturation = od["Vibration.Saturation"]
        self._measured = Quantiser(
            [
                *(od[f"Vibration.{name}"] for name in ("W_d", "W_q", "Temperature")),
                *(od[f"Gauge.S{number}"] for number in range(1, 7)),
            ]
        )
        self._stage = Quantiser([od["Stage.Voltage"], od["Stage.Frequency"]])
        self._ticks = od["Cycle.Ticks"]
        self._lost = od["Cycle.Lost drives"]
        self._foreign = od["Cycle.Foreign ticks"]
        self.start_run()

    def start_run(self) -> None:
        """Begin anew: a plate at rest at ambient temperature, tick 0 next, no drive."""
        od = self.od
        self.plate = Plate(
            PlateParameters(),
            _FINGERS[od["Simulation.Subject"].value - 1],
            self._finger(),
            seed=od["Simulation.Seed"].value,
            ambient=od["Simulation.Ambient temperature"].si_value,
            dead_time=od["Simulation.Dead time"].si_value,
        )
        od[FAULT_KIND].value = FaultKind.NONE
        self._fault_in = _NEVER
        self._power_stage = PowerStage()
        self.told = 0.0
        self._voltage.value = 0
        self._follow(StageEvent.START_RUN)
        self._moving = False
        self._answered = self._answered_before = False
        self._old = Drive(0.0, self._frequency.si_value)
        self._new = self._old
        self.tick.value = TICK_MASK
        for count in (self._ticks, self._lost, self._foreign):
            count.value = 0
        self._show_stage()

    def cycle(self) -> None:
        """Step to the next tick with the drive that arrived, and sample the sensors there."""
        plate = self.plate
        if self._fault_in >= 0:
            self._approach_fault()
        if self._moving:
            if self.state is _IN_USE and not self._answered:
                self._lost.count()
            plate.step(self._old, self._new)
            self._old = self._new
        self._moving = True
        self._answered_before = self._answered
        self._answered = False
        self.tick.value = (self.tick.value + 1) & TICK_MASK
        self._gauge_tick.value = (self.tick.value + self.session) & TICK_MASK
        self._ticks.count()
        W, gauges, temperature, saturated = plate.sample()
        self._measured.write((W.real, W.imag, temperature, *gauges))
        self._saturation.value = saturated

    def take_drive(self, *, latched: bool = False) -> Taken:
        """Take the drive in the object dictionary if it answers this tick, or the one before.

        A late answer is better than a voltage in force, which is older. Anything else, a second
        answer or an overtaken one included, is ignored and counted; a voltage while barred is only
        ignored. 0 V is always taken, and lifts the bar, unless its sender is in FAULT.

        Parameters
        ----------
        latched
            Whether 0 V bars: it is from a stimulator in FAULT, or hardware does not enable.
        """
        in_time = self._drive_tick.value == self.tick.value
        late = self._drive_tick.value == (self.tick.value - 1) & TICK_MASK
        if self._voltage.value != 0:
            if self.barred:
                return Taken.NOT
            # A voltage begins in time, or nobody would see it last too long.
            late = late and self.state is _IN_USE and not self._answered_before
            if self._answered or not (in_time or late) or not self._moving:
                self._foreign.count()
                return Taken.NOT
            if self.state is not _IN_USE:
                self._follow(StageEvent.VOLTAGE)
        else:
            self._follow(StageEvent.LATCHED if latched else StageEvent.ZERO)
        if in_time:
            self._answered = True
        elif late:
            self._answered_before = True
        self.told = told = float(self._voltage.value * self._voltage.si)
        read_back = self._power_stage.put_out(told)
        if read_back != told and abs(read_back - told) > STAGE_TOLERANCE:
            self.bar()
            return Taken.DISOBEYED
        self._new = Drive(read_back, float(self._frequency.value * self._frequency.si))
        self._show_stage()
        return Taken.IN_TIME if in_time else Taken.LATE

    @property
    def barred(self) -> bool:
        """Whether the plate takes a drive of 0 V only, as at the beginning."""
        return self.state in _BARRED

    def switch_off(self) -> None:
        """Put the power stage at 0 V, now."""
        self._go_to_zero(StageEvent.SWITCH_OFF)

    def bar(self) -> None:
        """Put the power stage at 0 V, and keep it there until a drive of 0 V comes.

        It is TRIPPED then if it was in use, else WAITING.
        """
        self._go_to_zero(StageEvent.BAR)

    def _go_to_zero(self, event: StageEvent) -> None:
        self._follow(event)
        self._voltage.value = 0
        self.told = 0.0
        self._old = self._new = Drive(0.0, self._new.frequency)
        self._show_stage()

    def _follow(self, event: StageEvent) -> None:
        self.state = follow(self.state, event)

    def write(self, name: str, raw: int) -> None:
        """Write a raw value to an object by name, as an SDO write does.

        Raises
        ------
        Abort
            As for an SDO write; the value is then unchanged.
        """
        entry = self.od[name]
        entry.check(raw)
        self.on_write(entry, raw)
        entry.value = raw

    def on_write(self, entry: Entry, value: int) -> None:
        """Act on a write before it is made.

        Raises
        ------
        Abort
            STATE for the recorded finger where there is no recording; VALUE for a fault that
            makes no sense.
        """
        if entry.name == START_RUN:
            self.start_run()
        elif entry.name == FAULT_KIND:
            self._set_fault(FaultKind(value))
        elif entry.name == "Finger.Motion" and value == RECORDED and self._recording is None:
            raise Abort(AbortCode.STATE)

    def _set_fault(self, kind: FaultKind) -> None:
        """Take sensor, value and delay from the object dictionary; what was broken is mended."""
        fault = Fault(kind, self.od["Fault.Sensor"].value, self.od["Fault.Value"].value)
        try:
            fault.require_sense()
        except ValueError as error:
            raise Abort(AbortCode.VALUE) from error
        self._power_stage.stick(0.0)
        self.plate.inject(Fault(FaultKind.NONE, 1, 0))
        self._fault = fault
        self._fault_in = self.od["Fault.Delay in cycles"].value if kind else _NEVER

    def _approach_fault(self) -> None:
        """Break what is due to break before the coming step."""
        self._fault_in -= 1
        if self._fault_in >= 0:
            return
        if self._fault.kind is FaultKind.STAGE_STUCK:
            voltage, frequency = self._new
            self._power_stage.stick(float(self._fault.value * self._voltage.si) or voltage)
            self._new = Drive(self._power_stage.put_out(voltage), frequency)
            self._show_stage()
        else:
            self.plate.inject(self._fault)

    def _show_stage(self) -> None:
        self._stage.write(self._new)

    def _finger(self) -> Finger:
        od = self.od
        motion = od["Finger.Motion"].value
        if motion == STROKE:
            return Stroke(
                od["Finger.Force"].si_value,
                od["Finger.Speed"].si_value,
                od["Finger.Range"].si_value,
                force_variation=od["Finger.Force variation"].si_value,
                speed_variation=od["Finger.Speed variation"].si_value,
                seed=od["Simulation.Seed"].value,
            )
        return self._recording if motion == RECORDED and self._recording else Lifted()
