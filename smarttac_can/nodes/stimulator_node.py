"""The stimulator node: a CANopen device around the function block of the stimulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from smarttac_can.device.application import Application
from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.device.port import Identifiers
from smarttac_can.device.storage import Storage
from smarttac_can.device.timer import Clock
from smarttac_can.nodes.arming_watch import SETPOINT_RPDOS, ArmingWatch
from smarttac_can.nodes.frame_check import FrameCheck
from smarttac_can.nodes.loop_frames import (
    DRIVE_TPDO,
    LATCHED,
    MEASUREMENT_RPDOS,
    sent_drive,
)
from smarttac_can.nodes.loop_period import LoopPeriod, deadlines, set_deadline
from smarttac_can.nodes.master_watch import MasterWatch
from smarttac_can.nodes.missed_time import TICKS, MissedTime
from smarttac_can.nodes.pairing import Pairing
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.plate_link import link_to_plate, plate_serial
from smarttac_can.nodes.publishing import Publishing
from smarttac_can.nodes.settings import mend_settings
from smarttac_can.nodes.source_watch import SourceWatch
from smarttac_can.nodes.stimulator_block import StimulatorBlock
from smarttac_can.nodes.sync_watch import SyncWatch
from smarttac_can.nodes.watching import Watching
from smarttac_can.od.cia import (
    HEARTBEAT_CONSUMER,
    Abort,
    AbortCode,
    EmergencyCode,
    ErrorRegister,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.objects import START_RUN
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import REPORTED_BY_PLATE, Watchdog

_PERCENT: Final = 100
_RESETS: Final = (NMTState.RESET_APPLICATION, NMTState.RESET_COMMUNICATION)


class StimulatorNode(Application):
    """Nested controllers and tribometer, with the plate inside or as a node on the bus.

    With the plate inside, the loop ticks by `advance`. With a plate node, a cycle is computed when
    the last measurement of its tick has come, and the drive goes out at once.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    plate
        Function block of the plate inside; None with a plate node.
    plate_node_id
        Node-ID of the plate node, 1..127, whose default COB-IDs the stimulator links to; 0 with
        the plate inside.
    produce_sync
        Whether this node produces the SYNC that is the tick of the plate node.
    lockstep
        Whether SYNC is the only clock: no time passes without the master then, who need not be
        watched.
    deadline_ms
        Default of the event timers of the measurements; None for that of the EDS.
    presets
        Raw values by name that replace defaults of the EDS at power-on.
    storage, node_id
        As for `Device`.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        plate: PlateBlock | None = None,
        *,
        plate_node_id: int = 0,
        produce_sync: bool = False,
        lockstep: bool = False,
        deadline_ms: int | None = None,
        presets: Mapping[str, int | bytes] | None = None,
        storage: Storage | None = None,
        node_id: int | None = None,
    ) -> None:
        if (plate is None) == (plate_node_id == 0):
            raise ValueError("a stimulator has the plate either inside or at a node-ID")
        self.od = od
        self._plate_node_id = plate_node_id
        self._produce_sync = produce_sync
        self._presets = dict(presets or {})
        self.block = StimulatorBlock(od, plate)
        if plate_node_id and deadline_ms is not None:
            set_deadline(od, MEASUREMENT_RPDOS, deadline_ms)
        if plate_node_id:
            serial = od["Calibration.Plate serial number"]
            serial.default = serial.value = plate_serial(serial, plate_node_id)
        self._deadlines = deadlines(od, MEASUREMENT_RPDOS)
        self.clock = clock = Clock()
        watching = Watching(od, clock, self._deadline_ms, self._trip, self.block.settle)
        self._sync_watch = SyncWatch(watching)
        self._source = SourceWatch(watching)
        self._masters = MasterWatch(clock, plate_node_id, self._trip, self.block.settle)
        self._missed_time = MissedTime(clock)
        self._unanswered = clock.timer(self._on_unanswered)
        self._ticker = clock.timer(self._tick)
        self.device = Device(
            od, self, storage=storage, node_id=node_id, clock=clock, loop_tpdos=(DRIVE_TPDO,),
            emergencies_of=plate_node_id,
        )  # fmt: skip
        self._period = LoopPeriod(self.device)
        self._arming = ArmingWatch(self.device, plate_node_id, lockstep)
        self.block.supervisor.advice = self._arming.advice
        self._publishing = Publishing(self.device, self.block.supervisor)
        self._tell = self._publishing.tell
        self._publish = self._publishing.cycle
        self._unfit = False
        self._pairing = Pairing(od, lambda: self._trip(Watchdog.MEASUREMENT), self._source.strange)
        self._missed = od["Cycle.Missed deadlines"]
        self._missed_max = od["Limit.Missed ticks"]
        self._sent = FrameCheck(sent_drive(od))
        self._mode = od["Mode"]
        self._controlword = od["Controlword"]
        self.start = self.device.start
        self.receive = self.device.receive
        self.advance = self.device.advance
        self.segments = self.device.segments

    @property
    def ids(self) -> Identifiers:
        """CAN-IDs that the node listens to, and those of its urgent frames, now."""
        return self.device.ids

    def overdue(self) -> list[Frame]:
        """Trip if the plate was not answered in time, before frames are heard that waited."""
        if self._unanswered.due <= self.clock.now:
            self._unanswered.fire()
        return self.device.take()

    def bus_off(self) -> list[Frame]:
        """Take note that the CAN controller went bus-off."""
        self._trip(Watchdog.BUS_OFF)
        return self.device.bus_off()

    def bus_recovered(self) -> list[Frame]:
        """Take note that the bus is there again."""
        self.block.settle(Watchdog.BUS_OFF)
        return self.device.bus_recovered()

    def transmit_failed(self) -> list[Frame]:
        """Take note that a frame could not be sent, the transmit queue being full."""
        self._trip(Watchdog.TRANSMIT_QUEUE)
        return self.device.take()

    def levels(self) -> tuple[float, ...]:
        """How near each watchdog of `COUNTED` is to a fault, 1.0, at the end of this tick.

        It costs nothing unless asked, after a cycle: no cycle works for it.
        """
        loop = self.block.supervisor.watchdogs
        voltage, temperature, *forces_and_sensors = loop.levels(self.block.cascade)
        amplitude, pickup, resonance, unseen = loop.vibration.levels()
        missed = self._missed_time.missed * _PERCENT / (self._missed_max.value * TICKS)
        return (
            max(self.device.silence(TICK_US), self._masters.rest()),
            max(self.clock.share((self._unanswered,), TICK_US), self._pairing.level),
            self.device.lateness(SETPOINT_RPDOS, TICK_US),
            *self._sync_watch.levels(TICK_US),
            voltage,
            amplitude,
            temperature,
            *forces_and_sensors,
            pickup,
            resonance,
            self._source.level,
            unseen,
            missed,
        )

    def shutdown(self) -> list[Frame]:
        """Leave the plate at 0 V, and tell the bus."""
        self.block.disarm()
        self._send_drive()
        self._publishing.all()
        return self.device.take()

    def on_state(self, state: NMTState) -> None:
        """Start from rest at power-on, link to the plate node; only OPERATIONAL drives."""
        if state is NMTState.RESET_APPLICATION:
            self._unfit = mend_settings(self.od)
            self.block.power_on()
            for name, raw in self._presets.items():
                self.block.write(name, raw)
            self.od["Plate node-ID"].value = self._plate_node_id
            self.block.start_run()
            if not self._plate_node_id:
                self._ticker.start(TICK_US, periodic=True)
        elif state is NMTState.RESET_COMMUNICATION and self._plate_node_id:
            link_to_plate(self.od, self._plate_node_id, self._produce_sync)
        block = self.block
        if state is NMTState.OPERATIONAL:
            block.enter()
        else:
            block.leave()
            self._pairing.forget()
            self._sync_watch.restart()
            self._source.restart()
            self._masters.leave()
            block.settle(Watchdog.MEASUREMENT)
        if state in _RESETS:
            self._masters.restart()
            self._source.forget()
            self._publishing.hold()
        else:
            if self._unfit:
                self.device.emergency(EmergencyCode.DATA_STORAGE, ErrorRegister.GENERIC)
            self._publishing.tell_anew()

    def on_sync(self) -> bool:
        """Look at when the SYNC comes, at its counter, and whose it is."""
        if not self._plate_node_id:
            return True
        if self.device.sync_own:
            self._missed.count(self.device.sync_missed)
            self._sync_watch.produced()
        elif self.device.produces_sync:
            return True
        else:
            self._sync_watch.heard(self.device.sync_counter)
        self._source.sync()
        return True

    def on_collision(self, heard: bool) -> None:
        """Stop when another node has an identifier of this one."""
        self._source.collide(heard)

    def on_error_control(self, node_id: int, lost: bool) -> None:
        """Stop when a watched node falls silent."""
        self._masters.silent(node_id, lost)

    def on_heartbeat(self, node_id: int, state: int) -> None:
        """Stop when a watched node starts anew, or is OPERATIONAL no more."""
        self._masters.heard(node_id, state)

    def on_emergency(self, code: int) -> None:
        """Stop when the plate has gone to 0 V without being told, or is not alone."""
        watchdog = REPORTED_BY_PLATE.get(code)
        if watchdog is Watchdog.DOUBLE:
            self._source.told()
        elif watchdog is not None:
            self._trip(watchdog)

    def on_rpdo_timeout(self, number: int, late: bool) -> None:
        """Stop when the master's set-points stay away; measurements have a watch of their own."""
        if number not in MEASUREMENT_RPDOS:
            self._masters.late(number, late)

    def on_rpdo(self, number: int) -> None:
        """Obey a controlword; answer a measurement that is complete."""
        if number not in MEASUREMENT_RPDOS:
            if self.device.carries(number, self._controlword):
                before = self.block.state
                self.block.note_watch(self._arming.kept)
                self.block.take_controlword()
                self._tell()
                self._show_change(before)
            return
        if not self._plate_node_id:
            return
        if self._pairing.take(number) and self._source.may_answer():
            if not self._period.agrees():
                self._trip(Watchdog.MEASUREMENT)
                return
            self._pairing.answered()
            self._unanswered.start(self._deadline_ms() * TICK_US)
            self.block.settle(Watchdog.MEASUREMENT)
            self.block.cycle()
            self._judge_time()
            self._tell()
            self._send_drive()
            self._publish()

    def _send_drive(self) -> None:
        """Send the drive; who sends it, and whether in FAULT, is in its check alone."""
        latched = LATCHED if self.block.state is State.FAULT else 0
        self._sent.write(bytes((self._pairing.session, self.od.node_id | latched)))
        self.device.trigger(DRIVE_TPDO)

    def on_store(self) -> None:
        """Refuse to store while armed or running: a file may take longer than a cycle.

        Raises
        ------
        Abort
            STATE in these states.
        """
        if self.block.supervisor.sharp:
            raise Abort(AbortCode.STATE)

    def on_write(self, entry: Entry, value: Any) -> None:
        """Refuse a mode that drives outside OPERATIONAL, and what the block refuses."""
        if entry is self._mode and value and self.device.nmt_state is not NMTState.OPERATIONAL:
            raise Abort(AbortCode.STATE)
        before = self.block.state
        if entry is self._controlword:
            self.block.note_watch(self._arming.kept)
        self.block.on_write(entry, value)
        if entry in self._deadlines:
            shortest = min(value, *(e.value for e in self._deadlines if e is not entry))
            self._unanswered.follow(shortest * TICK_US)
        if entry.index == HEARTBEAT_CONSUMER:
            self._masters.rewatch(entry.value, value)
        self._tell()
        self._show_change(before)
        if entry.name == START_RUN:
            self._pairing.start_run()

    def _judge_time(self) -> None:
        """Stop if too much of a second of the run had no cycle."""
        missed = self._missed_time.cycle()
        if self._plate_node_id and not self.device.sync_own:
            self._missed.count(missed)
        running = self.block.state is State.RUNNING
        if running and missed * _PERCENT > self._missed_max.value * TICKS:
            self.block.trip(Watchdog.MISSED_TIME)

    def _deadline_ms(self) -> int:
        """Return the time in ms within which a plate node has to be answered.

        It is that of the shortest event timer of RPDO 5 to 7, and holds whatever becomes of these
        PDOs.
        """
        first, second, third = self._deadlines
        return int(min(first.value, second.value, third.value))

    def _on_unanswered(self) -> None:
        self.block.fall_silent()
        if self.block.supervisor.live:
            self._trip(Watchdog.MEASUREMENT)

    def _tick(self) -> None:
        """Have a cycle with the plate inside; those that were slept through are counted."""
        self._missed.count(self._ticker.missed)
        self.block.tick()
        self._judge_time()
        self._tell()
        self._publish()

    def _show_change(self, before: State) -> None:
        """Publish another state at once, and 0 V for a plate that drives or awaits the reset."""
        if self.block.state is before:
            return
        if self.block.state is State.RUNNING:
            self._missed_time.restart()
        self._publishing.status()
        if before in (State.RUNNING, State.FAULT) and self._plate_node_id:
            self._send_drive()

    def _trip(self, watchdog: Watchdog) -> None:
        """Trip a watchdog between two cycles: the plate node is told at once."""
        before = self.block.state
        self.block.trip(watchdog)
        self._tell()
        self._show_change(before)
