"""The function block of the plate: an object dictionary and its plate, without CAN."""

from __future__ import annotations

from enum import Enum
from typing import Any, Final

from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.scaling import QuantisedOnDemand, Quantiser
from smarttac_can.instrument.nodes.front_end import STAGE_TOLERANCE, FrontEnd
from smarttac_can.instrument.nodes.hard_caps import PLATE_CAPS, require_caps
from smarttac_can.instrument.nodes.states import StageEvent, StageState, stage_after
from smarttac_can.science.plant.faults import Fault, PowerStage
from smarttac_can.science.plant.finger import Finger, Lifted, Stroke
from smarttac_can.science.plant.fitted import FITTED
from smarttac_can.science.plant.parameters import PlateParameters
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.sensors import Weight
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.vocabulary.faults import FaultCode, FaultKind
from smarttac_can.vocabulary.meanings import FAULT_KIND, RECORDED, START_RUN, STROKE
from smarttac_can.vocabulary.plate import TimedPlate
from smarttac_can.vocabulary.signals import Drive, Measurement

_NEVER: Final = -1
_FINGERS: Final = (*SUBJECTS, *(fitted.subject for fitted in FITTED))
"""Simulated subjects, in the order of *Simulation.Subject*, which counts from 1."""


class SimulatedPlate:
    """The simulated plate of the records `SIMULATION`, which only `sample` and `move` step.

    Parameters
    ----------
    od
        Object dictionary of ``plate.eds``.
    recording
        Finger of motion 2; None to refuse this motion.

    Attributes
    ----------
    plate
        Simulated plate of the present run.
    stage
        Output of the power stage.
    cause, trouble
        Always None and empty: a simulated plate has no fault of a front end.
    """

    cause: FaultCode | None = None
    trouble = ""

    def __init__(self, od: ObjectDictionary, recording: Finger | None) -> None:
        self._od = od
        self._recording = recording
        self._of_weight = [
            od[f"Weight.{name}"] for name in ("Force x", "Force y", "Normal force", "Position")
        ]

    def start_run(self, stage: Drive) -> None:
        """Restart with a plate at rest at ambient temperature, and a drive of 0 V."""
        od = self._od
        self.plate = Plate(
            PlateParameters(),
            _FINGERS[od["Simulation.Subject"].value - 1],
            self.finger(),
            seed=od["Simulation.Seed"].value,
            ambient=od["Simulation.Ambient temperature"].si_value,
            dead_time=od["Simulation.Drive instant"].si_value,
        )
        self._put_weight({})
        od[FAULT_KIND].value = FaultKind.NONE
        self._fault_in = _NEVER
        self._power_stage = PowerStage()
        self._moving = False
        self._old = self.stage = stage

    def sample(self) -> Measurement:
        """Step to the present tick with the drive received since the last; sample the sensors."""
        self.move()
        return self.plate.sample()

    def move(self) -> None:
        """Step to the present tick with the drive received since the last one."""
        if self._fault_in >= 0:
            self._approach_fault()
        if self._moving:
            self.plate.step(self._old, self.stage)
            self._old = self.stage
        self._moving = True

    def put_out(self, drive: Drive) -> float:
        """Put out a drive at the end of the dead time; return the voltage read back in V."""
        voltage = self._power_stage.put_out(drive.voltage)
        self.stage = drive if voltage == drive.voltage else Drive(voltage, drive.frequency)
        return voltage

    def switch_off(self, stage: Drive) -> None:
        """Put out a drive of 0 V immediately."""
        self._old = stage
        self.stage = stage

    def repeat_zero(self) -> None:
        """Do nothing: a simulated stage always obeys 0 V."""

    def on_write(self, entry: Entry, value: Any) -> None:
        """Act on a write before it is made.

        Raises
        ------
        Abort
            STATE for the motion of a recorded finger without a recording; VALUE for an invalid
            fault.
        """
        if entry.name == FAULT_KIND:
            self._set_fault(FaultKind(value))
        elif entry.name == "Finger.Motion" and value == RECORDED and self._recording is None:
            raise Abort(AbortCode.STATE, f"{entry.name} {value}: no finger was recorded")
        elif entry in self._of_weight:
            self._put_weight({entry: value})

    def _put_weight(self, written: dict[Entry, int]) -> None:
        """Put the weight of the objects on the plate; values about to be written replace some."""
        values = {entry: entry.value for entry in self._of_weight} | written
        self.plate.put(Weight(*(entry.si * value for entry, value in values.items())))

    def _set_fault(self, kind: FaultKind) -> None:
        """Clear the present fault, and read sensor, value and delay of the new one."""
        od = self._od
        fault = Fault(kind, od["Fault.Sensor"].value, od["Fault.Value"].value)
        try:
            fault.require_sense()
        except ValueError as error:
            raise Abort(AbortCode.VALUE, f"{FAULT_KIND} {kind:d}: {error}") from error
        self._power_stage.stick(0.0)
        self.plate.inject(Fault(FaultKind.NONE, 1, 0))
        self._fault = fault
        self._fault_in = od["Fault.Delay in cycles"].value if kind else _NEVER

    def _approach_fault(self) -> None:
        """Count the delay down, and inject the fault at its end, before the coming step."""
        self._fault_in -= 1
        if self._fault_in >= 0:
            return
        if self._fault.kind is FaultKind.STAGE_STUCK:
            counts = self._fault.value * self._od["Drive.Voltage"].si
            self._power_stage.stick(float(counts) or self.stage.voltage)
            self.put_out(self.stage)
        else:
            self.plate.inject(self._fault)

    def finger(self) -> Finger:
        """Return the finger that the objects describe."""
        od = self._od
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


TICK_MASK: Final = 0xFF
"""Mask of the tick count in a frame, 8 bits."""
# Needed in every cycle: module constants, as looking up an enumeration member is much slower.
_IN_USE: Final = StageState.IN_USE
_INHIBITED: Final = (StageState.WAITING, StageState.TRIPPED)


class Taken(Enum):
    """Result of a drive."""

    NOT = "ignored"
    LATE = "taken; it was not in time"
    IN_TIME = "taken"
    DISOBEYED = "the power stage does not obey it"


_COUNTS: Final = ("Cycle.Ticks", "Cycle.Lost drives", "Cycle.Foreign ticks", "Cycle.Late drives")


class PlateBlock:
    """The plate of the objects of ``plate.eds``: the simulated one, or a front end.

    The simulated plate moves only by calls of `cycle`, so a run gives the same numbers at any pace.
    It does not know the bus: the plate node calls it, or a stimulator with the plate inside.

    Parameters
    ----------
    od
        Object dictionary of ``plate.eds``.
    recording
        Finger of motion 2; None to refuse this motion.
    front_end
        Front end that replaces the simulated plate; None to simulate.

    Raises
    ------
    ValueError
        The object dictionary goes beyond the hard caps.

    Attributes
    ----------
    backend
        Simulated plate, or front end with its checks.
    state
        State of the power stage, read-only; `inhibit` and drives change it.
    session
        Session number, 0..255: the second tick of a measurement minus the first.
    instant_us
        Time in us from a tick until its drive is in force; 0 for immediately on arrival.
    commanded
        Commanded voltage of the power stage in V; the stage may put out another one.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        recording: Finger | None = None,
        front_end: TimedPlate | None = None,
    ) -> None:
        require_caps(od, PLATE_CAPS)
        self.od = od
        self.backend = (
            SimulatedPlate(od, recording) if front_end is None else FrontEnd(front_end, od)
        )
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
        self._stage_shown = QuantisedOnDemand([od["Stage.Voltage"], od["Stage.Frequency"]])
        self._ticks = od["Cycle.Ticks"]
        self._lost = od["Cycle.Lost drives"]
        self._foreign = od["Cycle.Foreign ticks"]
        self.start_run()

    def start_run(self) -> None:
        """Restart with a plate at rest, without a drive; the next tick is 0."""
        self.instant_us = self.od["Simulation.Drive instant"].value
        stage = Drive(0.0, self._frequency.si_value)
        self.backend.start_run(stage)
        self.commanded = 0.0
        self._voltage.value = 0
        self._follow(StageEvent.START_RUN)
        self._moving = False
        self._answered = self._answered_before = False
        self.tick.value = TICK_MASK
        for name in _COUNTS:
            self.od[name].value = 0
        self._stage_shown.row = stage

    def cycle(self, *, overtaken: bool = False) -> bool:
        """Step to the next tick with the drive that was received, and sample the sensors there.

        Parameters
        ----------
        overtaken
            Whether to skip sampling, because the next tick is already due.

        Returns
        -------
        bool
            Whether there is a measurement; always True for a simulated plate that samples.
        """
        if self._moving and self.state is _IN_USE and not self._answered:
            self._lost.count()
        self._moving = True
        self._answered_before = self._answered
        self._answered = False
        self.tick.value = (self.tick.value + 1) & TICK_MASK
        self._gauge_tick.value = (self.tick.value + self.session) & TICK_MASK
        self._ticks.count()
        measured = None
        if overtaken:
            self.backend.move()
        else:
            measured = self.backend.sample()
        self._stage_shown.row = self.backend.stage
        if measured is None:
            return False
        W, gauges, temperature, saturated = measured
        self._measured.write((W.real, W.imag, temperature, *gauges))
        self._saturation.value = saturated
        return True

    def take_drive(self, *, latched: bool = False) -> Taken:
        """Take the drive in the object dictionary if it answers this tick or the one before.

        A drive for the tick before is late, but still newer than the drive in force. Any other
        drive, also a second or superseded one, is ignored and counted as foreign. While inhibited,
        a voltage is ignored without being counted. 0 V is always taken; it ends the inhibit unless
        its sender is in FAULT.

        Parameters
        ----------
        latched
            Whether 0 V inhibits the stage, because its sender is in FAULT or hardware does not
            enable the stage.
        """
        in_time = self._drive_tick.value == self.tick.value
        late = self._drive_tick.value == (self.tick.value - 1) & TICK_MASK
        if self._voltage.value != 0:
            if self.inhibited:
                return Taken.NOT
            # The first voltage must be in time, or nothing would notice if it lasts too long.
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
        self.commanded = commanded = float(self._voltage.value * self._voltage.si)
        drive = Drive(commanded, float(self._frequency.value * self._frequency.si))
        read_back = self.backend.put_out(drive)
        if read_back != commanded and abs(read_back - commanded) > STAGE_TOLERANCE:
            self.inhibit()
            return Taken.DISOBEYED
        self._stage_shown.row = self.backend.stage
        return Taken.IN_TIME if in_time else Taken.LATE

    @property
    def inhibited(self) -> bool:
        """Whether the plate only takes a drive of 0 V, as after a start."""
        return self.state in _INHIBITED

    def switch_off(self) -> None:
        """Set the power stage to 0 V immediately."""
        self._go_to_zero(StageEvent.SWITCH_OFF)

    def inhibit(self) -> None:
        """Set the power stage to 0 V, and keep it there until it receives a drive of 0 V.

        Its state is then TRIPPED if it was in use, else WAITING.
        """
        self._go_to_zero(StageEvent.INHIBIT)

    def _go_to_zero(self, event: StageEvent) -> None:
        self._follow(event)
        self._voltage.value = 0
        self.commanded = 0.0
        _, frequency = self._stage_shown.row
        self.backend.switch_off(Drive(0.0, frequency))
        self._stage_shown.row = self.backend.stage

    def _follow(self, event: StageEvent) -> None:
        self.state = stage_after(self.state, event)

    def write(self, name: str, raw: int) -> None:
        """Write a raw value to an object by name, as an SDO download does.

        Raises
        ------
        Abort
            As for an SDO download; the value is then unchanged.
        """
        self.od.write(name, raw, self.on_write)

    def on_write(self, entry: Entry, value: Any) -> None:
        """Act on a write before it is made.

        Raises
        ------
        Abort
            STATE for the motion of a recorded finger without a recording, and with a front end for
            another value of an object of the simulation; VALUE for an invalid fault.
        """
        if entry.name == START_RUN:
            self.start_run()
        else:
            self.backend.on_write(entry, value)

    @property
    def plate(self) -> Plate:
        """The simulated plate of the present run, for tests and reports.

        Raises
        ------
        AttributeError
            There is a front end instead.
        """
        if isinstance(self.backend, FrontEnd):
            raise AttributeError("with a front end no plate is simulated")
        return self.backend.plate
