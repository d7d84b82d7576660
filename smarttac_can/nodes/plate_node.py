"""The plate node: a device around the function block, who drives it, and what watches it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.device.port import Clock
from smarttac_can.device.storage import Storage
from smarttac_can.nodes.device_node import DeviceNode
from smarttac_can.nodes.front_end import STAGE_TOLERANCE
from smarttac_can.nodes.lock import LONGER, OF_PLATE, OTHER, Lock, Rule
from smarttac_can.nodes.loop_frames import (
    DRIVE_RPDO,
    LATCHED,
    MEASUREMENT_TPDOS,
    PLATE_RPDOS,
    last_unsent,
    plate_serial,
    received_drive,
    sent_measurement,
)
from smarttac_can.nodes.loop_time import LoopPeriod, MissedTime, deadlines, set_deadline
from smarttac_can.nodes.plate_block import TICK_MASK, PlateBlock, Taken
from smarttac_can.nodes.states import StageState
from smarttac_can.nodes.watches import full_bucket, leaked
from smarttac_can.od.cia import (
    PDO_COB_ID,
    PDO_EVENT,
    PDO_TRANSMISSION,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    Abort,
    AbortCode,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.plant.finger import Finger
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.plate import TimedPlate
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.watchdogs import REPORTED_BY_PLATE, WATCHDOGS, level

WRONG_MAX: Final = 3
"""Drives with a wrong check in a row that disturb; those now and then fill a leaky bucket."""
_FULL_OF_WRONG: Final = full_bucket(WRONG_MAX)
_NOBODY: Final = 0
_NEVER: Final = -1


class DriveSender:
    """The stimulator that a plate works with: the first that commands 0 V.

    One drive alone does not settle who it is: a check over the session before, or over anything,
    names some node as well. Until a second one of the same comes, 0 V of another takes its place.

    Parameters
    ----------
    od
        Object dictionary of ``plate.eds``.

    Attributes
    ----------
    latched
        Whether the sender of the last drive was in FAULT.
    disturbed
        Whether too many drives had a wrong check.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._corrupt = od["Cycle.Corrupt drives"]
        self.forget()

    def forget(self) -> None:
        """Work with whoever comes first."""
        self._node_id = _NOBODY
        self._wrong = 0
        self._undisturbed = True
        self.disturbed = False
        self.latched = False

    def follow(self) -> None:
        """Begin a cycle; one without a wrong check makes up for some of those before."""
        if self._wrong and self._undisturbed:
            self._count(False)
        self._undisturbed = True

    @property
    def level(self) -> float:
        """How near wrong checks are to an inhibit; 1.0 or more while they inhibit."""
        return self._wrong / _FULL_OF_WRONG

    def sound(self, data: bytes, session: int, *, off: bool) -> bool:
        """Take a drive; return whether it is this sender's. A wrong one is counted.

        Parameters
        ----------
        data
            Its bytes.
        session
            That of the plate, 0..255.
        off
            Whether it asks for 0 V.
        """
        if self._node_id == _NOBODY and not off:
            return False
        named = last_unsent(data, bytes((session,)))
        self.latched = named >= LATCHED
        node_id = named % LATCHED
        if self._node_id == _NOBODY:
            self._node_id, self._once_in = node_id, session
        elif node_id == self._node_id:
            self._once_in = _NEVER
        elif off and session == self._once_in:
            self._node_id = node_id
        if node_id != _NOBODY and node_id == self._node_id and (off or not self.latched):
            return True
        self._corrupt.count()
        self._undisturbed = False
        self._count(True)
        return False

    def _count(self, wrong: bool) -> None:
        self._wrong = leaked(self._wrong, _FULL_OF_WRONG, wrong)
        self.disturbed = self._wrong >= _FULL_OF_WRONG


READ_BACK_CYCLES: Final = 3
"""Cycles in a row with a wrong reading that are a fault; those now and then fill a leaky bucket.
Two more pass before, at most: a reading may be a cycle old, and so may what it is compared with."""
_FULL_OF_READINGS: Final = full_bucket(READ_BACK_CYCLES)


class HardwareWatch:
    """The inputs ``Enable`` and ``Stage read-back``, each of which is watched while it is mapped.

    An input is mapped while a valid RPDO of the plate has it in its mapping. The stage may drive
    then while each such RPDO has come within its event timer, an ``Enable`` that is mapped is 1,
    and a read-back that is mapped is the voltage that the stage was commanded. A reading is
    compared with that of now and of the last two cycles: it may be a cycle old.

    Parameters
    ----------
    device
        The plate's.

    Attributes
    ----------
    sources
        RPDOs that have one of the inputs in their mapping, and whether it is the read-back.
    reads_back
        Whether the read-back is mapped.
    cause
        What keeps the stage from a voltage; None if nothing does.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        od = device.od
        self._enable = od["Enable"]
        self._read_back = od["Stage read-back"]
        self._inputs: tuple[Entry, ...] = ()
        self._rules: dict[Entry, Rule] = {}
        self.sources: dict[int, bool] = {}
        self.reads_back = False
        self.cause: FaultCode | None = None
        self._commanded = (0.0, 0.0)
        self._wrong = False
        self._wrong_cycles = 0

    def configure(self) -> None:
        """Look up what is mapped; for when PDOs have changed, or the NMT state has."""
        carries = self._device.carries
        both = (self._enable, self._read_back)
        self._inputs = tuple(e for e in both if any(carries(n, e) for n in PLATE_RPDOS))
        self.sources = {
            number: carries(number, self._read_back)
            for number in PLATE_RPDOS
            if any(carries(number, entry) for entry in both)
        }
        self.reads_back = self._read_back in self._inputs
        if not self.reads_back:
            self._wrong = False
            self._wrong_cycles = 0
        self._rules = dict(rule for number in self.sources for rule in self._of_rpdo(number))
        self.look()

    def hear(self, number: int, commanded: float) -> None:
        """Take what one of the sources has brought.

        Parameters
        ----------
        number
            That of the RPDO.
        commanded
            What the stage is commanded now, in V.
        """
        if self.sources[number]:
            reading = float(self._read_back.value * self._read_back.si)
            of_late = (commanded, *self._commanded)
            most, least = max(of_late), min(of_late)
            self._wrong = not least - STAGE_TOLERANCE <= reading <= most + STAGE_TOLERANCE
        self.look()

    def cycle(self, commanded: float) -> None:
        """Count a cycle of the loop at whose end the stage was commanded a voltage in V."""
        self._commanded = (commanded, self._commanded[0])
        self._wrong_cycles = leaked(self._wrong_cycles, _FULL_OF_READINGS, self._wrong)
        self.look()

    def look(self) -> None:
        """See what keeps the stage from a voltage."""
        heard = all(map(self._device.in_time, self.sources))
        enabled = self._enable.value or self._enable not in self._inputs
        self.cause = None
        if not (heard and enabled):
            self.cause = FaultCode.NOT_ENABLED
        elif self._wrong_cycles >= _FULL_OF_READINGS:
            self.cause = FaultCode.STAGE

    def require(self, entry: Entry, value: int, *, in_use: bool) -> None:
        """Refuse a write that would take the place of the hardware, or end the watch over it.

        Parameters
        ----------
        entry, value
            What is written, raw.
        in_use
            Whether the stage is.

        Raises
        ------
        Abort
            STATE for another value of an input that is mapped, and while the stage is in use for
            what would be laxer.
        """
        if entry in self._inputs and OTHER.forbids(entry.value, value):
            raise Abort(AbortCode.STATE)
        rule = self._rules.get(entry)
        if in_use and rule is not None and rule.forbids(entry.value, value):
            raise Abort(AbortCode.STATE)

    def _of_rpdo(self, number: int) -> list[tuple[Entry, Rule]]:
        """List what does not become laxer of an RPDO."""
        objects = self._device.od.objects
        communication = objects[RPDO_COMMUNICATION + number - 1].entries
        mapping = objects[RPDO_MAPPING + number - 1].entries
        return [
            (communication[PDO_COB_ID], OTHER),
            (communication[PDO_TRANSMISSION], OTHER),
            (communication[PDO_EVENT], LONGER),
            *((entry, OTHER) for entry in mapping.values()),
        ]


class Protection:
    """The faults for which a plate stays at 0 V, each reported once by an emergency message.

    Parameters
    ----------
    device, block
        Those of the plate.

    Attributes
    ----------
    faults
        For which it is at 0 V until the controller asks for that.
    reported
        Whether one was reported since 0 V was asked for.
    """

    def __init__(self, device: Device, block: PlateBlock) -> None:
        self._device = device
        self._block = block
        self.faults: set[FaultCode] = set()
        self.reported = False

    def trip(self, code: FaultCode) -> None:
        """Inhibit the stage until the controller asks for 0 V, and report the fault once."""
        self._block.inhibit()
        if code not in self.faults:
            self.reported = True
            self.faults.add(code)
            self._device.emergency(code, WATCHDOGS[REPORTED_BY_PLATE[code]].register)

    def trip_again(self, code: FaultCode) -> None:
        """Trip, and report a fault that was reported before once more."""
        self.faults.discard(code)
        self._device.clear_emergency(code)
        self.trip(code)

    def trip_in_use(self, code: FaultCode) -> None:
        """Inhibit the stage; trip if it is in use."""
        if self._block.state is StageState.IN_USE:
            self.trip(code)
        else:
            self._block.inhibit()

    def clear(self) -> None:
        """Report that the faults are gone."""
        for code in sorted(self.faults):
            self._device.clear_emergency(code)
        self.faults.clear()


class LateDrives:
    """Counts the drives that came after the instant of a tick at which they should be in force.

    Parameters
    ----------
    od
        Object dictionary of ``plate.eds``.
    clock
        Device time.
    """

    def __init__(self, od: ObjectDictionary, clock: Clock) -> None:
        self._clock = clock
        self._late = od["Cycle.Late drives"]
        self._ticks = od["Cycle.Ticks"]

    def tick(self) -> None:
        """Begin a tick."""
        self._ticked = self._clock.now

    def take(self, taken: Taken, instant_us: int) -> None:
        """Take a drive that should be in force ``instant_us`` after the tick; 0 for at once."""
        if not (instant_us and self._ticks.value):
            return
        overdue = taken is Taken.IN_TIME and self._clock.now - self._ticked > instant_us
        if overdue or taken is Taken.LATE:
            self._late.count()


class Limited(NamedTuple):
    """Objects of which two are limited by the other two."""

    voltage: Entry
    voltage_max: Entry
    temperature: Entry
    temperature_max: Entry


LIMITED: Final = (
    "Drive.Voltage", "Limit.Voltage", "Vibration.Temperature", "Limit.Temperature",
)  # fmt: skip


class PlateNode(DeviceNode):
    """Power stage, vibration pick-up and strain gauges, simulated or real; SYNC is the tick.

    Parameters
    ----------
    od
        Object dictionary of ``plate.eds``.
    presets
        Raw values by name that replace defaults of the EDS at power-on.
    recording
        The finger of ``Finger.Motion`` 2.
    front_end
        What takes the place of the simulated plate.
    session
        Number of the first session, 0..255; hardware draws it.
    deadline_ms
        Default of the event timer of the drive; None for that of the EDS.
    storage, node_id
        As for `Device`.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        presets: Mapping[str, int] | None = None,
        recording: Finger | None = None,
        *,
        front_end: TimedPlate | None = None,
        session: int = 0,
        deadline_ms: int | None = None,
        storage: Storage | None = None,
        node_id: int | None = None,
    ) -> None:
        self.od = od
        self._presets = dict(presets or {})
        self.block = PlateBlock(od, recording, front_end)
        if deadline_ms is not None:
            set_deadline(od, (DRIVE_RPDO,), deadline_ms)
        (self._deadline,) = deadlines(od, (DRIVE_RPDO,))
        clock = Clock()
        self._unanswered = clock.timer(self._on_unanswered)
        self._sent = sent_measurement(od)
        self._driven = received_drive(od)
        device = Device(
            od, self, storage=storage, node_id=node_id, clock=clock,
            loop_tpdos=MEASUREMENT_TPDOS, loop_rpdos=(DRIVE_RPDO,),
        )  # fmt: skip
        super().__init__(device)
        self._period = LoopPeriod(device)
        self._missed = od["Cycle.Missed deadlines"]
        self._missed_time = MissedTime(clock)
        self._overtaken = False
        self._late_drives = LateDrives(od, clock)
        self._sender = DriveSender(od)
        self._hardware = HardwareWatch(device)
        self._protection = Protection(device, self.block)
        self._lock = Lock(od, OF_PLATE)
        self._limited = Limited(*map(od.__getitem__, LIMITED))
        self._stage_voltage = od["Stage.Voltage"]
        self._serial = od["Plate serial number"]
        self._next_session = session

    def overtaken(self, frame: Frame) -> list[Frame]:
        """Take a frame that waited; a SYNC is a tick that is over, and not measured."""
        self._overtaken = True
        try:
            return self.device.receive(frame)
        finally:
            self._overtaken = False

    def overdue(self) -> list[Frame]:
        """Go to 0 V if no drive came in time, before frames are heard that waited."""
        if self._unanswered.due <= self.clock.now:
            self._unanswered.fire()
        return self.device.take()

    def transmit_failed(self) -> list[Frame]:
        """Go to 0 V, the transmit queue being full: the controller lacks what was measured."""
        self.block.inhibit()
        if self.block.state is StageState.TRIPPED:
            self._protection.trip(FaultCode.DRIVE_LOST)
        return self.device.take()

    def levels(self) -> tuple[float, ...]:
        """How near each watch of `PLATE_COUNTED` is to 0 V, 1.0, at the end of this tick."""
        limited = self._limited
        return (
            self.clock.share((self._unanswered,), TICK_US),
            self._sender.level,
            level(limited.temperature.value, limited.temperature_max.value),
            level(limited.voltage.value, limited.voltage_max.value),
        )

    def shutdown(self) -> list[Frame]:
        """Put the power stage at 0 V."""
        self.block.switch_off()
        self.block.backend.repeat_zero()
        return []

    def on_state(self, state: NMTState) -> None:
        """Start from rest at power-on; only OPERATIONAL drives."""
        if state is NMTState.RESET_APPLICATION:
            for name, raw in self._presets.items():
                self.block.write(name, raw)
            self.block.start_run()
        elif state is not NMTState.OPERATIONAL:
            self.block.inhibit()
        self._missed_time.restart()
        if state is NMTState.RESET_COMMUNICATION:
            self._protection.faults.clear()
            self._serial.value = plate_serial(self._serial, self.device.node_id)
            self._sender.forget()
        if state is NMTState.OPERATIONAL:
            self.block.session = self._next_session
            self._next_session = (self._next_session + 1) & TICK_MASK
        if state not in (NMTState.RESET_APPLICATION, NMTState.RESET_COMMUNICATION):
            self._hardware.configure()

    def on_sync(self) -> bool:
        """Step to this tick; without a loop, a measurement, or use for one, nothing goes out."""
        self.block.backend.repeat_zero()
        if self.device.nmt_state is not NMTState.OPERATIONAL:
            return False
        if not self._period.agrees():
            self.block.inhibit()
            return False
        self._late_drives.tick()
        self._missed.count(self._missed_time.cycle())
        if self._hardware.reads_back:
            self._hardware.cycle(self.block.commanded)
            if self._hardware.cause is FaultCode.STAGE:
                self._protection.trip(FaultCode.STAGE)
        measured = self.block.cycle(overtaken=self._overtaken)
        self._sender.follow()
        self._follow_front_end()
        if measured:
            self._sent.write_check()
        limited = self._limited
        if limited.temperature.value > limited.temperature_max.value:
            self._protection.trip(FaultCode.TEMPERATURE)
        elif self.block.state is StageState.TRIPPED and not self._protection.faults:
            self._protection.trip(FaultCode.DRIVE_LOST)
        return measured

    def on_rpdo(self, number: int) -> None:
        """Hear hardware that watches the stage."""
        if number in self._hardware.sources:
            self._hardware.hear(number, self.block.commanded)
            self._follow_hardware()

    def on_loop_rpdo(self, _number: int, data: bytes) -> None:
        """Take a drive if it is sound, its voltage in the limit, the plate cool and no collision.

        A corrupt one, and a stranger's, counts as a drive that did not come; several of them
        inhibit the stage. If hardware keeps the stage from a voltage, that is reported each time
        one is asked for.
        """
        self._driven.keep(self._driven.unpack(data))
        hardware, sender, protection = self._hardware, self._sender, self._protection
        limited = self._limited
        voltage = limited.voltage.value
        if not sender.sound(data, self.block.session, off=not voltage):
            if sender.disturbed:
                self.block.inhibit()
            return
        if voltage > limited.voltage_max.value:
            protection.trip(FaultCode.VOLTAGE)
            return
        cause = hardware.cause or self.block.backend.cause
        if not voltage:
            protection.reported = False
        elif cause is not None and not protection.reported:
            protection.trip_again(cause)
        hot = limited.temperature.value > limited.temperature_max.value
        if (hot or self.device.collision or sender.disturbed) and voltage:
            return
        taken = self.block.take_drive(latched=sender.latched or cause is not None)
        self._late_drives.take(taken, self.block.instant_us)
        if taken is Taken.IN_TIME:
            self._unanswered.start(self._deadline.value * TICK_US)
        elif taken is Taken.DISOBEYED:
            protection.trip(FaultCode.STAGE)
        if protection.faults and not (self.block.inhibited or hot or self.device.collision):
            protection.clear()

    def on_rpdo_timeout(self, number: int, late: bool) -> None:
        """Go to 0 V when the hardware that watches the stage falls silent."""
        if number in self._hardware.sources:
            self._hardware.look()
            self._follow_hardware()

    def on_parameters(self) -> None:
        """Follow another mapping, COB-ID or event timer of the hardware's inputs."""
        self._hardware.configure()
        self._follow_hardware()

    def on_error_control(self, node_id: int, lost: bool) -> None:
        """Go to 0 V when a watched node falls silent, whatever the error behaviour is."""
        if lost:
            self.block.inhibit()

    def on_collision(self, heard: bool) -> None:
        """Go to 0 V, and stay there, while another node sends with an identifier of the plate."""
        if heard:
            self._protection.trip(FaultCode.DOUBLE)

    def _on_unanswered(self) -> None:
        """Go to 0 V, as no drive was taken for the time of the deadline.

        The deadline of the RPDO begins anew with any values within their limits; this one with a
        drive that was taken.
        """
        self.block.inhibit()

    def _follow_hardware(self) -> None:
        """Go to 0 V if hardware keeps the stage from a voltage; report it if it was in use."""
        cause = self._hardware.cause
        if cause is not None:
            self._protection.trip_in_use(cause)

    def _follow_front_end(self) -> None:
        """Go to 0 V if a front end gives reason to; report it if the stage was, or is, live."""
        cause = self.block.backend.cause
        if cause is FaultCode.STAGE:
            self._protection.trip(cause)
        elif cause:
            self._protection.trip_in_use(cause)

    def on_store(self) -> None:
        """Refuse to store while it drives: a file may take longer than a cycle.

        Raises
        ------
        Abort
            STATE while the power stage has a voltage.
        """
        if self._stage_voltage.read():
            raise Abort(AbortCode.STATE)

    def on_write(self, entry: Entry, value: Any) -> None:
        """Start a run; refuse what is laxer while in use, and a recorded finger that is none."""
        in_use = self.block.state is StageState.IN_USE
        self._hardware.require(entry, value, in_use=in_use)
        if in_use:
            self._lock.require(entry, value)
        if entry is self._deadline:
            self._unanswered.follow(value * TICK_US)
        self.block.on_write(entry, value)
