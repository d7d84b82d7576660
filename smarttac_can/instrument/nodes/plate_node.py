"""The plate node: a device around the function block, the sender of its drives, its watchdogs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.device.port import Clock
from smarttac_can.canopen.device.storage import Storage
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.device_node import DeviceNode
from smarttac_can.instrument.nodes.front_end import STAGE_TOLERANCE
from smarttac_can.instrument.nodes.lock import LONGER, OF_PLATE, OTHER, Lock, Rule
from smarttac_can.instrument.nodes.loop_frames import (
    LATCHED,
    last_unsent,
    plate_serial,
    received_drive,
    sent_measurement,
)
from smarttac_can.instrument.nodes.loop_time import LoopPeriod, MissedTime, deadlines, set_deadline
from smarttac_can.instrument.nodes.plate_block import TICK_MASK, PlateBlock, Taken
from smarttac_can.instrument.nodes.states import StageState
from smarttac_can.instrument.nodes.watches import full_bucket, leaked
from smarttac_can.science.plant.finger import Finger
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.plate import TimedPlate
from smarttac_can.vocabulary.signals import DRIVE_RPDO, MEASUREMENT_TPDOS, PLATE_RPDOS, TICK_US
from smarttac_can.vocabulary.watchdogs import REPORTED_BY_PLATE, WATCHDOGS, level

WRONG_MAX: Final = 3
"""Drives in a row with a wrong check sum before the inhibit. Single ones fill a leaky bucket."""
_FULL_OF_WRONG: Final = full_bucket(WRONG_MAX)
_NOBODY: Final = 0
_NEVER: Final = -1


class DriveSender:
    """Identify the stimulator that commands the plate: the sender of the first drive of 0 V.

    One drive alone does not identify the sender: a check sum of an earlier session, or a corrupt
    one, also gives some node-ID. Until a second drive gives the same one, 0 V of another sender
    replaces it.

    Parameters
    ----------
    od
        Object dictionary of ``plate.eds``.

    Attributes
    ----------
    latched
        Whether the sender of the last drive was in FAULT.
    disturbed
        Whether too many drives had a wrong check sum.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._corrupt = od["Cycle.Corrupt drives"]
        self.forget()

    def forget(self) -> None:
        """Clear the sender and the count, and accept any sender."""
        self._node_id = _NOBODY
        self._wrong = 0
        self._undisturbed = True
        self.disturbed = False
        self.latched = False

    def follow(self) -> None:
        """Begin a cycle; a cycle without a wrong check sum empties the leaky bucket by 1."""
        if self._wrong and self._undisturbed:
            self._count(False)
        self._undisturbed = True

    @property
    def level(self) -> float:
        """Level of wrong check sums; from 1.0 on the stage is inhibited."""
        return self._wrong / _FULL_OF_WRONG

    def sound(self, data: bytes, session: int, *, off: bool) -> bool:
        """Take a drive; return whether this sender sent it. Count it as corrupt if not.

        Parameters
        ----------
        data
            Bytes of the drive.
        session
            Session number of the plate, 0..255.
        off
            Whether the drive asks for 0 V.
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
"""Cycles in a row with a wrong reading before the fault. Single ones fill a leaky bucket. Up to two
more pass before: both the reading and the voltage to compare with may be a cycle old."""
_FULL_OF_READINGS: Final = full_bucket(READ_BACK_CYCLES)


class HardwareWatch:
    """The inputs ``Enable`` and ``Stage read-back``. Each is supervised while it is mapped.

    An input is mapped while a valid RPDO of the plate has it in its mapping. The stage may then
    have a voltage under three conditions: each such RPDO has arrived within its event timer, a
    mapped ``Enable`` is 1, and a mapped read-back equals the commanded voltage. As a reading may be
    a cycle old, it is compared with the voltages commanded now and in the last two cycles.

    Parameters
    ----------
    device
        Device of the plate.

    Attributes
    ----------
    sources
        Numbers of the RPDOs that have one of the inputs in their mapping.
    reads_back
        Whether the read-back is mapped.
    cause
        Fault code for which the stage has to stay at 0 V; None if there is no fault.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        od = device.od
        self._enable = od["Enable"]
        self._read_back = od["Stage read-back"]
        self._inputs: tuple[Entry, ...] = ()
        self._rules: dict[Entry, Rule] = {}
        self.sources: tuple[int, ...] = ()
        self.reads_back = False
        self.cause: FaultCode | None = None
        self._commanded = (0.0, 0.0)
        self._wrong = False
        self._wrong_cycles = 0

    def configure(self) -> None:
        """Read the mapping; called after PDOs or the NMT state have changed."""
        carries = self._device.carries
        both = (self._enable, self._read_back)
        self._inputs = tuple(e for e in both if any(carries(n, e) for n in PLATE_RPDOS))
        self.sources = tuple(n for n in PLATE_RPDOS if any(carries(n, entry) for entry in both))
        self.reads_back = self._read_back in self._inputs
        if not self.reads_back:
            self._wrong = False
            self._wrong_cycles = 0
        self._rules = dict(rule for number in self.sources for rule in self._of_rpdo(number))
        self.look()

    def hear(self, commanded: float) -> None:
        """Check the inputs that an RPDO has brought, against the commanded voltage in V."""
        if self.reads_back:
            reading = float(self._read_back.value * self._read_back.si)
            of_late = (commanded, *self._commanded)
            most, least = max(of_late), min(of_late)
            self._wrong = not least - STAGE_TOLERANCE <= reading <= most + STAGE_TOLERANCE
        self.look()

    def cycle(self, commanded: float) -> None:
        """Count a cycle of the loop, at the end of which the stage was commanded a voltage in V."""
        self._commanded = (commanded, self._commanded[0])
        self._wrong_cycles = leaked(self._wrong_cycles, _FULL_OF_READINGS, self._wrong)
        self.look()

    def look(self) -> None:
        """Update the fault code for which the stage has to stay at 0 V."""
        heard = all(map(self._device.in_time, self.sources))
        enabled = self._enable.value or self._enable not in self._inputs
        self.cause = None
        if not (heard and enabled):
            self.cause = FaultCode.NOT_ENABLED
        elif self._wrong_cycles >= _FULL_OF_READINGS:
            self.cause = FaultCode.STAGE

    def require(self, entry: Entry, value: int, *, in_use: bool) -> None:
        """Refuse a write that would replace an input of the hardware, or end its supervision.

        Parameters
        ----------
        entry, value
            Entry to be written, and its raw value.
        in_use
            Whether the stage is in use.

        Raises
        ------
        Abort
            STATE for another value of a mapped input, and while the stage is in use for a write
            that relaxes the supervision.
        """
        if entry in self._inputs and OTHER.forbids(entry.value, value):
            raise Abort(AbortCode.STATE)
        rule = self._rules.get(entry)
        if in_use and rule is not None and rule.forbids(entry.value, value):
            raise Abort(AbortCode.STATE)

    def _of_rpdo(self, number: int) -> list[tuple[Entry, Rule]]:
        objects = self._device.od.objects
        communication = objects[cia.RPDO_COMMUNICATION + number - 1].entries
        mapping = objects[cia.RPDO_MAPPING + number - 1].entries
        return [
            (communication[cia.PDO_COB_ID], OTHER),
            (communication[cia.PDO_TRANSMISSION], OTHER),
            (communication[cia.PDO_EVENT], LONGER),
            *((entry, OTHER) for entry in mapping.values()),
        ]


class Protection:
    """Keep the plate at 0 V for a fault, and report each fault once by an emergency message.

    Parameters
    ----------
    device, block
        Device and function block of the plate.

    Attributes
    ----------
    faults
        Faults for which the plate stays at 0 V until the controller commands 0 V.
    reported
        Whether a fault was reported since 0 V was last commanded.
    """

    def __init__(self, device: Device, block: PlateBlock) -> None:
        self._device = device
        self._block = block
        self.faults: set[FaultCode] = set()
        self.reported = False

    def trip(self, code: FaultCode) -> None:
        """Inhibit the stage until the controller commands 0 V, and report the fault once."""
        self._block.inhibit()
        if code not in self.faults:
            self.reported = True
            self.faults.add(code)
            self._device.emergency(code, WATCHDOGS[REPORTED_BY_PLATE[code]].register)

    def trip_again(self, code: FaultCode) -> None:
        """Trip, and report a fault again that was reported before."""
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
    """Count drives that arrived after the time at which they should have been in force.

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
        """Start a tick."""
        self._ticked = self._clock.now

    def take(self, taken: Taken, instant_us: int) -> None:
        """Take a drive that is due ``instant_us`` after the tick; 0 disables the count."""
        if not (instant_us and self._ticks.value):
            return
        overdue = taken is Taken.IN_TIME and self._clock.now - self._ticked > instant_us
        if overdue or taken is Taken.LATE:
            self._late.count()


class Limited(NamedTuple):
    """Objects of voltage and temperature, and their limits."""

    voltage: Entry
    voltage_max: Entry
    temperature: Entry
    temperature_max: Entry


LIMITED: Final = (
    "Drive.Voltage", "Limit.Voltage", "Vibration.Temperature", "Limit.Temperature",
)  # fmt: skip


class PlateNode(DeviceNode):
    """Power stage, vibration pick-up and strain gauges, simulated or real. SYNC is the tick.

    Parameters
    ----------
    od
        Object dictionary of ``plate.eds``.
    presets
        Raw values by name that replace defaults of the EDS at power-on.
    recording
        Finger of ``Finger.Motion`` 2; None to refuse this motion.
    front_end
        Front end that replaces the simulated plate; None to simulate.
    session
        Number of the first session, 0..255. For hardware it is drawn at random.
    deadline_ms
        Default of the event timer of the drive in ms; None for the default of the EDS.
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
        """Take a superseded frame; the tick of a superseded SYNC is not sampled."""
        self._overtaken = True
        try:
            return self.device.receive(frame)
        finally:
            self._overtaken = False

    def overdue(self) -> list[Frame]:
        """Go to 0 V if no drive came in time, before waiting frames are processed."""
        if self._unanswered.due <= self.clock.now:
            self._unanswered.fire()
        return self.device.take()

    def transmit_failed(self) -> list[Frame]:
        """Go to 0 V as the transmit queue is full: the controller lacks the measurement."""
        self.block.inhibit()
        if self.block.state is StageState.TRIPPED:
            self._protection.trip(FaultCode.DRIVE_LOST)
        return self.device.take()

    def levels(self) -> tuple[float, ...]:
        """Return the level of each row of `PLATE_COUNTED` at the end of this tick; 1.0 trips."""
        limited = self._limited
        return (
            self.clock.level((self._unanswered,), TICK_US),
            self._sender.level,
            level(limited.temperature.value, limited.temperature_max.value),
            level(limited.voltage.value, limited.voltage_max.value),
        )

    def shutdown(self) -> list[Frame]:
        """Set the power stage to 0 V."""
        self.block.switch_off()
        self.block.backend.repeat_zero()
        return []

    def on_state(self, state: NMTState) -> None:
        """Start from rest at power-on; allow voltages only in OPERATIONAL."""
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
        """Step to this tick; return whether there is a measurement to send."""
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
        """Check the inputs of hardware that supervises the stage."""
        if number in self._hardware.sources:
            self._hardware.hear(self.block.commanded)
            self._follow_hardware()

    def on_loop_rpdo(self, _number: int, data: bytes) -> None:
        """Take a drive unless a check fails.

        The drive has to be sound and its voltage within the limit. A voltage is ignored while the
        plate is too hot, while another node uses an identifier, and while too many drives are
        corrupt. A corrupt drive, or one of another sender, counts as missing; several of them
        inhibit the stage. If hardware keeps the stage at 0 V, this is reported each time a voltage
        is commanded after 0 V.
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
        """Go to 0 V when an RPDO of hardware that supervises the stage is overdue."""
        if number in self._hardware.sources:
            self._hardware.look()
            self._follow_hardware()

    def on_parameters(self) -> None:
        """Apply another mapping, COB-ID or event timer of the hardware inputs."""
        self._hardware.configure()
        self._follow_hardware()

    def on_error_control(self, node_id: int, lost: bool) -> None:
        """Go to 0 V when a supervised node is silent, whatever the error behaviour is."""
        if lost:
            self.block.inhibit()

    def on_collision(self, heard: bool) -> None:
        """Go to 0 V, and stay there, while another node sends with an identifier of the plate."""
        if heard:
            self._protection.trip(FaultCode.DOUBLE)

    def _on_unanswered(self) -> None:
        """Go to 0 V, as no drive was taken for the time of the deadline.

        The event timer of the RPDO restarts with any valid frame; this deadline only with a drive
        that was taken.
        """
        self.block.inhibit()

    def _follow_hardware(self) -> None:
        """Go to 0 V if hardware does not allow a voltage; report it if the stage was in use."""
        cause = self._hardware.cause
        if cause is not None:
            self._protection.trip_in_use(cause)

    def _follow_front_end(self) -> None:
        """Go to 0 V for a fault of the front end; report it if the stage was, or is, live."""
        cause = self.block.backend.cause
        if cause is FaultCode.STAGE:
            self._protection.trip(cause)
        elif cause:
            self._protection.trip_in_use(cause)

    def on_store(self) -> None:
        """Refuse to store while the stage has a voltage: a file may take longer than a cycle.

        Raises
        ------
        Abort
            STATE while the power stage has a voltage.
        """
        if self._stage_voltage.read():
            raise Abort(AbortCode.STATE)

    def on_write(self, entry: Entry, value: Any) -> None:
        """Apply a write, or raise `Abort` if it relaxes a rule in use or makes no sense."""
        in_use = self.block.state is StageState.IN_USE
        self._hardware.require(entry, value, in_use=in_use)
        if in_use:
            self._lock.require(entry, value)
        if entry is self._deadline:
            self._unanswered.follow(value * TICK_US)
        self.block.on_write(entry, value)
