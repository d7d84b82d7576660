"""Function block of the stimulator: connects its object dictionary to the cascade."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.hard_caps import STIMULATOR_CAPS, require_caps, require_choices
from smarttac_can.instrument.nodes.lock import OF_STIMULATOR, Lock
from smarttac_can.instrument.nodes.loop_frames import (
    CheckedFrames,
    received_drive,
    received_measurement,
    sent_drive,
    sent_measurement,
)
from smarttac_can.instrument.nodes.loop_time import Deadline
from smarttac_can.instrument.nodes.parameters import (
    CALIBRATION,
    DESIGN,
    GAUGE_ZERO,
    MODE_SHAPE,
    MODEL,
    TEXTURE,
    UNTARED,
    ModelSheet,
    Plans,
    Present,
    Taring,
    TextureSlots,
    build_plans,
    keep_mode_shape,
    plate_model,
)
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.process_image import (
    DriveOutput,
    MeasurementInput,
    ReadBack,
    Setpoints,
)
from smarttac_can.instrument.nodes.states import Event
from smarttac_can.instrument.nodes.supervisor import Supervisor
from smarttac_can.instrument.nodes.watches import full_counts
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.tribometer import Forces
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.meanings import AUTO_ZERO, FAULT_KIND, SIMULATION, START_RUN
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.signals import MEASUREMENT_RPDOS, SHORT_DEADLINE_MS, Drive
from smarttac_can.vocabulary.states import Mode, State
from smarttac_can.vocabulary.textures import TABLES
from smarttac_can.vocabulary.watchdogs import Watchdog


class PlateInside:
    """Copy integers between two object dictionaries, as the PDOs of the loop would.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    plate
        Function block of the plate.

    Raises
    ------
    ValueError
        The PDOs of the two EDS files do not carry the same objects.

    Attributes
    ----------
    plate
        Function block of the plate.
    """

    def __init__(self, od: ObjectDictionary, plate: PlateBlock) -> None:
        self._od = od
        self.plate = plate
        self._sent, self._received = sent_measurement(plate.od), received_measurement(od)
        _require_same(self._sent, self._received)
        sent, received = sent_drive(od), received_drive(plate.od)
        _require_same(sent, received)
        self._driven = list(zip(sent.entries, received.entries, strict=True))

    def power_on(self) -> None:
        """Reset the plate, and copy the values that the simulation objects have now to it."""
        self.plate.od.reset()
        for entry in self._od:
            if entry.name.partition(".")[0] in SIMULATION:
                self.plate.od[entry.name].value = entry.value

    def start_run(self) -> None:
        """Put the plate to rest at tick 0, without an injected fault."""
        self.plate.start_run()
        self._od[FAULT_KIND].value = FaultKind.NONE

    def measure(self) -> list[int]:
        """Step and sample the plate; return the values in the order of the bus, no check sum."""
        self.plate.cycle()
        values = [entry.value for entry in self._sent.entries]
        for entry, value in zip(self._received.entries, values, strict=True):
            entry.value = value
        return values

    def drive(self) -> None:
        """Copy the drive to the plate."""
        for source, target in self._driven:
            target.value = source.value
        self.plate.take_drive()


def _require_same(sent: CheckedFrames, received: CheckedFrames) -> None:
    """Raise ValueError unless both ends map the same objects in the same order."""
    if len(sent.entries) != len(received.entries):
        raise ValueError("the PDOs of the loop carry different numbers of objects")
    for source, target in zip(sent.entries, received.entries, strict=True):
        what = source.name.rpartition(".")[2].lower()
        if not target.name.lower().endswith(what):
            raise ValueError(f"{source.name} and {target.name} are mapped at the same place")


# Needed in every cycle: module constants, as looking up an enumeration member is much slower.
_RUNNING: Final = State.RUNNING
_IDENTIFY: Final = Mode.IDENTIFY
_DESIGNED_FROM: Final = (*DESIGN, MODEL, GAUGE_ZERO, TABLES)
_TEXTURES: Final = (TEXTURE, TABLES)
_SETPOINTS: Final = {
    Mode.OPEN_LOOP: "Setpoint.Voltage",
    Mode.AMPLITUDE: "Setpoint.Amplitude",
    Mode.AMPLITUDE_RESONANCE: "Setpoint.Amplitude",
}
"""Set-points for which the default 0 means 0 V, by mode."""


class StimulatorBlock:
    """The nested controllers, with the objects of ``stimulator.eds``.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    plate
        Plate inside; None if the plate is a node of its own.

    Raises
    ------
    ValueError
        The object dictionary goes beyond the hard caps, or the PDOs of the two EDS files do not
        carry the same objects.

    Attributes
    ----------
    cascade
        Controllers, for tests and reports.
    supervisor
        State machine and faults, read-only; the methods of this class change them.
    deadline
        Deadline of the loop with a plate node.
    """

    def __init__(self, od: ObjectDictionary, plate: PlateBlock | None = None) -> None:
        require_caps(od, STIMULATOR_CAPS)
        require_choices(od)
        self.od = od
        self._inside = None if plate is None else PlateInside(od, plate)
        self._inbox = MeasurementInput(od)
        self._setpoints = Setpoints(od)
        self._outbox = DriveOutput(od)
        self._read_back = ReadBack(od)
        self._mode = od["Mode"]
        self._message = od["Message"]
        self._model_sheet = ModelSheet(od)
        self._lock = Lock(od, OF_STIMULATOR)
        self._textures = TextureSlots(od)
        self.deadline = Deadline(od, MEASUREMENT_RPDOS)
        self._plans = self._built(plate_model(od), UNTARED)
        self.supervisor = Supervisor(od, self._plans.watch)
        self._taring = Taring(od, self.supervisor)
        self._shown: State | None = None
        self._hint = ""
        self._changed: set[str] = set()
        self.cascade = Cascade(self._plans.parameters, self._plans.model)
        self.start_run()

    @property
    def state(self) -> State:
        """State of the device."""
        return self.supervisor.state

    def power_on(self) -> None:
        """Start with the values that the objects have now, also those of the simulation."""
        if self._inside is not None:
            self._inside.power_on()
        self.supervisor.restart()
        self.supervisor.rest()
        self._shown = None
        self._changed.clear()
        self.start_run()

    def start_run(self) -> None:
        """Start a run: controllers reset and off, next tick 0; a plate inside is at rest.

        The first drive is 0 V, whatever the set-points are. The state of a plate node is unknown,
        so its watchdogs keep their counts.
        """
        supervisor = self.supervisor
        if self._inside is not None:
            self._inside.start_run()
            supervisor.rest()
        self._textures.reload()
        if MODEL in self._changed:
            self._show_written_model()
        self._changed.clear()
        self._plans = plans = self._built(plate_model(self.od), UNTARED)
        self.cascade = Cascade(plans.parameters, plans.model)
        self.cascade.play(plans.control.texture)
        self._taring.begin(self.cascade)
        supervisor.plan = plans.watch
        self._begun = self._touched = False
        self._read_back.reset()
        self._switch_off()
        supervisor.start_run(self.cascade.tared)
        self._follow()

    def tick(self) -> None:
        """Run one cycle with the plate inside: step and sample it, and answer the measurement."""
        inside = self._inside
        assert inside is not None
        self.cycle(inside.measure())
        inside.drive()

    def cycle(self, measurement: Sequence[int], *, late: bool = False) -> None:
        """Compute the drive that answers a measurement.

        Parameters
        ----------
        measurement
            Values in the order of the bus; a check sum at the end is ignored.
        late
            Whether the drive reaches the plate too late for the cycle that begins with this
            measurement.
        """
        measured = self._inbox.measured(measurement)
        mode = self._prepare()
        asked = self.cascade.update(measured.si, self._setpoints.read())
        if not self._begun:
            mode, asked = self._begin_at_zero(mode, asked)
        self._taring.tare_when_due(self.cascade)
        drive = self.supervisor.permit(asked, measured, mode, self.cascade, late=late)
        if drive.voltage and self._hint:
            self._withdraw_hint()
        self._follow()
        self.cascade.realised(drive)
        self._outbox.write(drive, measured.tick)
        self._read_back.publish(measured, self.cascade)
        self._keep_results(mode)

    def _prepare(self) -> int:
        """Apply new parameters and the mode; return the mode of this cycle."""
        if self._changed:
            self._take_plans()
        running = self.supervisor.machine.state is _RUNNING
        mode = int(self._mode.value) if running else int(Mode.OFF)
        if mode != self.cascade.mode:
            self.cascade.set_mode(mode)
            self._message.value = self.cascade.reason
            self._hint_at_nothing_asked()
        return mode

    def _begin_at_zero(self, mode: int, asked: Drive) -> tuple[int, Drive]:
        """Make the first drive of a run 0 V; before it a plate takes no voltage.

        A mode that asks for a voltage begins with the next cycle.
        """
        if asked.voltage > 0.0:
            mode = int(Mode.OFF)
            self.cascade.set_mode(mode)
            asked = self.cascade.drive
        self._begun = True
        return mode, asked

    def _follow(self) -> None:
        """Show a change of state, and switch off when RUNNING is left."""
        state = self.supervisor.machine.state
        if state is self._shown:
            return
        if self._shown is State.RUNNING:
            self._withdraw_hint()
            self._switch_off()
        self._shown = state
        self._read_back.show_state(state)
        if state is State.RUNNING:
            self._hint_at_nothing_asked()

    def _hint_at_nothing_asked(self) -> None:
        """Set the Message to what is missing if mode and set-points give 0 V."""
        mode = self._mode.value
        name = _SETPOINTS.get(mode)
        if name is not None and not self.od[name].value:
            self._hint = f"running at 0 V: {name} is 0 in Mode {mode}, write another value"
        elif mode == Mode.OFF:
            self._hint = "running at 0 V: Mode is 0 (off), write another"
        else:
            self._hint = ""
            return
        self._message.value = self._hint

    def _withdraw_hint(self) -> None:
        """Clear the hint in the Message, as there is a voltage or RUNNING was left."""
        if self._message.value == self._hint:
            self._message.value = ""
        self._hint = ""

    def _switch_off(self) -> None:
        self._mode.value = Mode.OFF
        self.cascade.set_mode(Mode.OFF)
        self._outbox.switch_off()
        self._read_back.show_off()
        if self._inside is not None:
            self._inside.plate.switch_off()

    def _keep_results(self, mode: int) -> None:
        """Store what the cascade has found of the plate, and show if it has left its mode."""
        cascade = self.cascade
        touching = cascade.contact.touching
        if self._touched and not touching and keep_mode_shape(self.od, cascade.mode_shape):
            self._plans = self._built(cascade.model, cascade.zero)
            self._changed.add(MODE_SHAPE)
        self._touched = touching
        if mode == _IDENTIFY and self._model_sheet.follow(cascade):
            self._plans = self._built(cascade.model, cascade.zero)
            self.supervisor.plan = self._plans.watch
        if mode != cascade.mode:
            # The cascade has left the mode by itself.
            self._mode.value = int(cascade.mode)
            if cascade.reason and not self.supervisor.latched:
                self._message.value = cascade.reason

    def observe(self, watchdog: Watchdog, present: bool) -> None:
        """Record that a fault comes or goes between two cycles; a latched fault stays latched."""
        bit = 1 << watchdog
        self.supervisor.observe(bit if present else 0, bit)
        self._follow()

    def enter(self) -> None:
        """Follow NMT into OPERATIONAL."""
        self.supervisor.enter()

    def leave(self) -> None:
        """Follow NMT out of OPERATIONAL."""
        self.supervisor.leave()
        self._follow()
        self.mark_stale()

    def mark_stale(self) -> None:
        """Mark the values of the last cycle as stale, as no cycle follows for now."""
        self._read_back.mark_stale()

    def disarm(self) -> None:
        """Disarm, and set the drive to 0 V, whatever the controlword is."""
        self.supervisor.handle(Event.DISARM)
        self._follow()
        self._switch_off()

    def note_supervision(self, supervised: bool) -> None:
        """Record whether loss of the commander would be detected, before each controlword."""
        self.supervisor.supervised = supervised or bool(self.od["Drive unwatched"].value)

    def take_controlword(self) -> None:
        """Obey a controlword received in an RPDO."""
        self.supervisor.take_controlword()
        self._follow()

    def write(self, name: str, raw: int | bytes) -> None:
        """Write a raw value to an object by name, as an SDO download does.

        Raises
        ------
        Abort
            As for an SDO download; the value is then unchanged, and the Message gives the reason.
        """
        try:
            self.od.write(name, raw, self.on_write)
        except Abort as abort:
            self.supervisor.refuse(name, abort.explain(name))
            raise

    def on_write(self, entry: Entry, value: Any) -> None:
        """Act on a write before it is made.

        Raises
        ------
        Abort
            As for `Lock`, `TextureSlots`, `Supervisor.command` and `Taring.auto_zero`. STATE also
            for zeros and a calibration that would hide a force that has latched a fault, and for
            simulation objects without the plate inside. VALUE for limits that contradict each
            other.
        """
        if self.supervisor.armed:
            self._lock.require(entry, value)
        self._textures.on_write(entry, value)
        record = entry.name.partition(".")[0]
        if entry.name == "Controlword":
            try:
                self.supervisor.command(value)
            finally:
                self._follow()
        elif entry.name == START_RUN:
            self.start_run()
        elif record in SIMULATION:
            if self._inside is not None:
                self._inside.plate.write(entry.name, value)
            elif value != entry.value:
                raise Abort(
                    AbortCode.STATE,
                    f"{entry.name} is not simulated in this node: write it to the plate node",
                )
        elif entry.name in AUTO_ZERO:
            self._taring.auto_zero(self.cascade, value)
            if self._changed:
                # The plans that wait for the next cycle contain the old zero.
                self._plans = self._built(self.cascade.model, self.cascade.zero)
            self._follow()
        elif record in _DESIGNED_FROM:
            inhibited = record in (CALIBRATION, GAUGE_ZERO) and self.supervisor.tare_inhibited
            if inhibited and value != entry.value:
                raise Abort(
                    AbortCode.STATE,
                    f"{entry.name} {entry.shown(value)} is refused: it could hide a force that is "
                    "a fault; take the force away first",
                )
            cascade = self.cascade
            self._plans = self._built(cascade.model, cascade.zero, entry, value)
            self._changed.add(record)
        self.supervisor.accept(entry.name)

    def follow_deadline(self) -> None:
        """Apply a new deadline of the loop, by which late drives are excused."""
        self.deadline.configure()
        full = full_counts(self._deadline_ms)
        self._plans = self._plans._replace(watch=self._plans.watch._replace(full=full))
        self.supervisor.plan = self.supervisor.plan._replace(full=full)

    @property
    def _deadline_ms(self) -> int:
        return self.deadline.ms if self._inside is None else SHORT_DEADLINE_MS

    def _built(
        self, model: PlateModel, zero: Forces, entry: Entry | None = None, value: Any = 0
    ) -> Plans:
        """Build the plans, as they are after a write if an entry is given."""
        texture = self._textures.chosen(entry, value)
        present = Present(model, zero, texture, self._deadline_ms)
        return build_plans(self.od, present, entry, value)

    def _show_written_model(self) -> None:
        if self._plans.model != self.cascade.model:
            self._model_sheet.show_written(self._plans.model)

    def _take_plans(self) -> None:
        """Put the plans in force that result from writes since the last cycle."""
        changed, self._changed = self._changed, set()
        plans, cascade = self._plans, self.cascade
        self.supervisor.plan = plans.watch
        self._show_written_model()
        cascade.swap(plans.parameters, plans.model, plans.control)
        if not changed.isdisjoint(_TEXTURES):
            cascade.play(plans.control.texture)
        if GAUGE_ZERO in changed:
            self._taring.restore(cascade)
