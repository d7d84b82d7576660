"""The plate node: a CANopen device around the function block of the plate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.device.port import Clock, Identifiers
from smarttac_can.device.service import Application
from smarttac_can.device.storage import Storage
from smarttac_can.nodes.drive_sender import DriveSender
from smarttac_can.nodes.hardware_watch import HardwareWatch
from smarttac_can.nodes.lock import OF_PLATE, Lock
from smarttac_can.nodes.loop_frames import (
    DRIVE_RPDO,
    MEASUREMENT_TPDOS,
    received_drive,
    sent_measurement,
)
from smarttac_can.nodes.loop_time import LoopPeriod, MissedTime, deadlines, set_deadline
from smarttac_can.nodes.plate_block import TICK_MASK, PlateBlock, Taken
from smarttac_can.nodes.plate_link import plate_serial
from smarttac_can.nodes.states import StageState
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.plant.finger import Trajectory
from smarttac_can.vocabulary.fault_codes import FaultCode
from smarttac_can.vocabulary.plate import TimedPlate
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.watchdogs import REPORTED_BY_PLATE, WATCHDOGS, level


class PlateNode(Application):
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
        recording: Trajectory | None = None,
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
        self.clock = clock = Clock()
        self._unanswered = clock.timer(self._on_unanswered)
        self._sent = sent_measurement(od)
        self._driven = received_drive(od)
        self.device = Device(
            od, self, storage=storage, node_id=node_id, clock=clock,
            loop_tpdos=MEASUREMENT_TPDOS, loop_rpdos=(DRIVE_RPDO,),
        )  # fmt: skip
        self.segments = self.device.segments
        self._period = LoopPeriod(self.device)
        self._missed = od["Cycle.Missed deadlines"]
        self._missed_time = MissedTime(clock)
        self._overtaken = False
        self._late = od["Cycle.Late drives"]
        self._ticks = od["Cycle.Ticks"]
        self._sender = DriveSender(od)
        self._hardware = HardwareWatch(self.device)
        self._reported = False
        self._lock = Lock(od, OF_PLATE)
        self._voltage = od["Drive.Voltage"]
        self._temperature = od["Vibration.Temperature"]
        self._stage_voltage = od["Stage.Voltage"]
        self._voltage_max = od["Limit.Voltage"]
        self._temperature_max = od["Limit.Temperature"]
        self._serial = od["Plate serial number"]
        self._next_session = session
        self._protecting: set[FaultCode] = set()
        self.start = self.device.start
        self.receive = self.device.receive
        self.bus_off = self.device.bus_off
        self.bus_recovered = self.device.bus_recovered
        self.advance = self.device.advance

    @property
    def ids(self) -> Identifiers:
        """CAN-IDs that the node listens to, and those of its urgent frames, now."""
        return self.device.ids

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
            self._protect(FaultCode.DRIVE_LOST)
        return self.device.take()

    def levels(self) -> tuple[float, ...]:
        """How near each watch of `PLATE_COUNTED` is to 0 V, 1.0, at the end of this tick."""
        return (
            self.clock.share((self._unanswered,), TICK_US),
            self._sender.level,
            level(self._temperature.value, self._temperature_max.value),
            level(self._voltage.value, self._voltage_max.value),
        )

    def shutdown(self) -> list[Frame]:
        """Put the power stage at 0 V."""
        self.block.switch_off()
        self.block.backend.insist()
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
            self._protecting.clear()
            self._serial.value = plate_serial(self._serial, self.device.node_id)
            self._sender.forget()
        if state is NMTState.OPERATIONAL:
            self.block.session = self._next_session
            self._next_session = (self._next_session + 1) & TICK_MASK
        if state not in (NMTState.RESET_APPLICATION, NMTState.RESET_COMMUNICATION):
            self._hardware.configure()

    def on_sync(self) -> bool:
        """Step to this tick; without a loop, a measurement, or use for one, nothing goes out."""
        self.block.backend.insist()
        if self.device.nmt_state is not NMTState.OPERATIONAL:
            return False
        if not self._period.agrees():
            self.block.inhibit()
            return False
        self._ticked = self.clock.now
        self._missed.count(self._missed_time.cycle())
        if self._hardware.reads_back:
            self._hardware.cycle(self.block.commanded)
            if self._hardware.cause is FaultCode.STAGE:
                self._protect(FaultCode.STAGE)
        measured = self.block.cycle(overtaken=self._overtaken)
        self._sender.follow()
        self._heed_front_end()
        if measured:
            self._sent.write_check()
        if self._temperature.value > self._temperature_max.value:
            self._protect(FaultCode.TEMPERATURE)
        elif self.block.state is StageState.TRIPPED and not self._protecting:
            self._protect(FaultCode.DRIVE_LOST)
        return measured

    def on_rpdo(self, number: int) -> None:
        """Hear hardware that watches the stage."""
        if number in self._hardware.sources:
            self._hardware.hear(number, self.block.commanded)
            self._heed_hardware()

    def on_loop_rpdo(self, _number: int, data: bytes) -> None:
        """Take a drive if it is sound, its voltage below the limit, the plate cool and alone.

        A corrupt one, and a stranger's, is a drive that did not come; several of them bar. What
        hardware keeps from a voltage is reported for each time that one is asked for.
        """
        self._driven.keep(self._driven.unpack(data))
        hardware, sender = self._hardware, self._sender
        if not sender.sound(data, self.block.session, off=not self._voltage.value):
            if sender.disturbed:
                self.block.inhibit()
            return
        if self._voltage.value > self._voltage_max.value:
            self._protect(FaultCode.VOLTAGE)
            return
        cause = hardware.cause or self.block.backend.cause
        if not self._voltage.value:
            self._reported = False
        elif cause is not None and not self._reported:
            self._protecting.discard(cause)
            self.device.clear_emergency(cause)
            self._protect(cause)
        hot = self._temperature.value > self._temperature_max.value
        if (hot or self.device.collision or sender.disturbed) and self._voltage.value:
            return
        taken = self.block.take_drive(latched=sender.latched or cause is not None)
        self._count_late(taken)
        if taken is Taken.IN_TIME:
            self._unanswered.start(self._deadline.value * TICK_US)
        elif taken is Taken.DISOBEYED:
            self._protect(FaultCode.STAGE)
        if self._protecting and not (self.block.inhibited or hot or self.device.collision):
            for code in sorted(self._protecting):
                self.device.clear_emergency(code)
            self._protecting.clear()

    def _count_late(self, taken: Taken) -> None:
        """Count a drive that came after the instant of a tick at which it should be in force."""
        instant = self.block.instant_us
        if not (instant and self._ticks.value):
            return
        overdue = taken is Taken.IN_TIME and self.clock.now - self._ticked > instant
        if overdue or taken is Taken.LATE:
            self._late.count()

    def on_rpdo_timeout(self, number: int, late: bool) -> None:
        """Go to 0 V when the hardware that watches the stage falls silent."""
        if number in self._hardware.sources:
            self._hardware.look()
            self._heed_hardware()

    def on_parameters(self) -> None:
        """Follow another mapping, COB-ID or event timer of the hardware's inputs."""
        self._hardware.configure()
        self._heed_hardware()

    def on_error_control(self, node_id: int, lost: bool) -> None:
        """Go to 0 V when a watched node falls silent, whatever the error behaviour says."""
        if lost:
            self.block.inhibit()

    def on_collision(self, heard: bool) -> None:
        """Go to 0 V, and stay there, while another node sends with an identifier of the plate."""
        if heard:
            self._protect(FaultCode.DOUBLE)

    def _on_unanswered(self) -> None:
        """Go to 0 V, as no drive was taken for the time of the deadline.

        The deadline of the RPDO begins anew with any values within their limits; this one with a
        drive that was taken.
        """
        self.block.inhibit()

    def _protect(self, code: FaultCode) -> None:
        """Go to 0 V, report it once, and stay there until the controller asks for 0 V."""
        self.block.inhibit()
        if code not in self._protecting:
            self._reported = True
            self._protecting.add(code)
            self.device.emergency(code, WATCHDOGS[REPORTED_BY_PLATE[code]].register)

    def _heed_hardware(self) -> None:
        """Go to 0 V if hardware does not let the stage drive; report it if it was in use."""
        cause = self._hardware.cause
        if cause is None:
            return
        if self.block.state is StageState.IN_USE:
            self._protect(cause)
        else:
            self.block.inhibit()

    def _heed_front_end(self) -> None:
        """Go to 0 V if a front end gives reason to; report it if the stage was, or is, live."""
        cause = self.block.backend.cause
        if cause is FaultCode.STAGE or (cause and self.block.state is StageState.IN_USE):
            self._protect(cause)
        elif cause:
            self.block.inhibit()

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
