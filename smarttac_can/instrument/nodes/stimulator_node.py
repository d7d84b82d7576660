"""The stimulator node: a device around its function block, its commander, and its messages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.error_control import supervised_node
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.device.port import Clock
from smarttac_can.canopen.device.storage import Storage
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, EmergencyCode, ErrorRegister
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.bus_loop import BusLoop, Observe
from smarttac_can.instrument.nodes.device_node import DeviceNode
from smarttac_can.instrument.nodes.loop_frames import (
    LATCHED,
    expect_plate,
    links_to_plate,
    sent_drive,
)
from smarttac_can.instrument.nodes.loop_time import TICKS, LoopPeriod, MissedTime, deadlines
from smarttac_can.instrument.nodes.parameters import mend_settings
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.instrument.nodes.supervisor import Supervisor
from smarttac_can.instrument.nodes.watches import levels
from smarttac_can.vocabulary.meanings import START_RUN
from smarttac_can.vocabulary.signals import DRIVE_TPDO, MEASUREMENT_RPDOS, TICK_US
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import (
    COUNTED,
    OF_LATE_DRIVES,
    REPORTED_BY_PLATE,
    WATCHDOGS,
    Watchdog,
    watchdogs_in,
)

NOT_OPERATIONAL_US: Final = 1_000_000
"""Longest time in us that a master may be outside OPERATIONAL. A master that sets up its own stack
passes through PRE-OPERATIONAL in less, and a killed bench is detected as late."""

_UP: Final = -1
SETPOINT_RPDOS: Final = (1, 2, 3, 4)
_TABLE: Final = "Consumer heartbeat time"


class Commander:
    """The watchdogs of heartbeats and set-points, and whether one of them is active.

    A supervised node counts as lost when its heartbeat is late, immediately when it boots again,
    and when it was OPERATIONAL and then is in another state for `NOT_OPERATIONAL_US`. A node that
    never was OPERATIONAL is accepted, as some masters announce PRE-OPERATIONAL all the time.

    Parameters
    ----------
    device
        Device of the stimulator.
    plate
        Node-ID of the plate node, 0 for none. The plate is no master and has watchdogs of its own,
        so of its heartbeat only the loss counts.
    observe
        Function that is called when the fault of a watchdog comes or goes.
    lockstep
        Whether the master's SYNC is the only clock; nothing then happens without the master.
    """

    def __init__(
        self,
        device: Device,
        plate: int,
        observe: Observe,
        *,
        lockstep: bool,
    ) -> None:
        self._device = device
        self._clock = device.clock
        self._plate = plate
        self._observe = observe
        self._lockstep = lockstep
        self._late: set[int] = set()
        self._gone: set[int] = set()
        self._seen: set[int] = set()
        self._resting: dict[int, int] = {}
        """Time since which a node is no longer OPERATIONAL; `_UP` while it is OPERATIONAL."""
        od = device.od
        self._watches = [e for s, e in od.objects[cia.HEARTBEAT_CONSUMER].entries.items() if s]
        self._deadlines = deadlines(od, SETPOINT_RPDOS)
        self._guarding = od.entry(cia.GUARD_TIME), od.entry(cia.LIFE_TIME_FACTOR)
        self._heartbeat = od.entry(cia.HEARTBEAT_PRODUCER)

    def restart(self) -> None:
        """Clear the record of all supervised nodes."""
        self._gone.clear()
        self._seen.clear()
        self._resting.clear()
        self._observe(Watchdog.HEARTBEAT, False)

    def consumer_changed(self, before: int, after: int) -> None:
        """Apply a write to the heartbeat consumer: another node is a new one."""
        node_id = supervised_node(before)
        if node_id and node_id != supervised_node(after):
            self._seen.discard(node_id)
            self._resting.pop(node_id, None)
            self._back(node_id)

    def silent(self, node_id: int, lost: bool) -> None:
        """Record that a node is silent, or is received again; node-ID 0 is life guarding."""
        if lost:
            self._lose(node_id)
        else:
            self._back(node_id)

    def heard(self, node_id: int, state: int) -> None:
        """Take a heartbeat or the boot-up message of a supervised node."""
        if node_id == self._plate:
            return
        if state == NMTState.INITIALISING:
            self._resting.pop(node_id, None)
            if node_id in self._seen:
                self._lose(node_id)
            return
        self._seen.add(node_id)
        if state == NMTState.OPERATIONAL:
            self._resting[node_id] = _UP
        elif node_id in self._resting:
            since = self._resting[node_id]
            if since == _UP:
                self._resting[node_id] = self._clock.now
            elif self._clock.now - since >= NOT_OPERATIONAL_US:
                self._lose(node_id)
            return
        self._back(node_id)

    def level(self) -> float:
        """Return the longest time for which a node has left OPERATIONAL, as a fraction, 0..1."""
        now = self._clock.now
        since = [at for at in self._resting.values() if at != _UP]
        return (now - min(since)) / NOT_OPERATIONAL_US if since else 0.0

    def late(self, rpdo: int, late: bool) -> None:
        """Record that the set-points of an RPDO are late, or are received again."""
        if late:
            self._late.add(rpdo)
            self._observe(Watchdog.SETPOINT, True)
            return
        self._late.discard(rpdo)
        if not self._late:
            self._observe(Watchdog.SETPOINT, False)

    def _lose(self, node_id: int) -> None:
        if node_id not in self._gone:
            self._gone.add(node_id)
            self._observe(Watchdog.HEARTBEAT, True)

    def _back(self, node_id: int) -> None:
        self._gone.discard(node_id)
        if not self._gone:
            self._observe(Watchdog.HEARTBEAT, False)

    @property
    def supervised(self) -> bool:
        """Whether a loss of the commander would be detected."""
        device = self._device
        return (
            self._lockstep
            or device.guarded
            or bool(device.supervised_in_time - {self._plate})
            or any(device.in_time(number) for number in SETPOINT_RPDOS)
        )

    def advice(self) -> str:
        """Return how the supervision that is configured becomes active, or how to configure one."""
        return ", or ".join(self._set_but_silent()) or (
            f"enter your heartbeat in {_TABLE} and send it, or set Drive unwatched to 1"
        )

    def _set_but_silent(self) -> Iterator[str]:
        """Yield for each configured supervision the frame that it waits for."""
        nodes = [supervised_node(entry.value) for entry in self._watches]
        if masters := [f"{node}" for node in nodes if node not in (0, self._plate)]:
            which = " or ".join(masters)
            full = all(entry.value for entry in self._watches)
            taken = "; its entries are all taken: write 0 to one for another" if full else ""
            silent = f"entered in {_TABLE} but not heard yet{taken}"
            yield f"send the heartbeat of node {which}, {silent}"
        for number, deadline in zip(SETPOINT_RPDOS, self._deadlines, strict=True):
            if deadline.value:
                yield f"send RPDO {number}, which has a deadline but has not come yet"
        if all(entry.value for entry in self._guarding):
            if self._heartbeat.value:
                yield "set Producer heartbeat time to 0: life guarding rests beside a heartbeat"
            else:
                yield "guard this node: its life time is set, but no remote frame has come yet"


_STATUS_TPDO: Final = 1
_MEASURED_TPDOS: Final = (2, 3, 4)


class Publishing:
    """Send the drive, the public TPDOs, and the latched faults as emergency messages.

    TPDO 1 is sent when status or mode change. TPDO 2 to 4 are sent in every cycle if their
    transmission type is 254, else by their type.

    Parameters
    ----------
    device
        Device of the stimulator.
    supervisor
        Supervisor that latches the faults.
    """

    def __init__(self, device: Device, supervisor: Supervisor) -> None:
        self._device = device
        self._supervisor = supervisor
        self._reported = 0
        self._drive = sent_drive(device.od)
        self._types = [
            (number, device.od.entry(cia.TPDO_COMMUNICATION + number - 1, cia.PDO_TRANSMISSION))
            for number in _MEASURED_TPDOS
        ]

    def cycle(self) -> None:
        """Send the TPDOs that a cycle has changed."""
        trigger = self._device.trigger
        trigger(_STATUS_TPDO)
        for number, transmission in self._types:
            if transmission.value == cia.EVENT_MANUFACTURER:
                trigger(number)

    def status(self) -> None:
        """Send TPDO 1 immediately after a change of state."""
        self._device.trigger(_STATUS_TPDO)

    def drive(self, session: int) -> None:
        """Send the drive; its check sum also covers the sender's node-ID and FAULT state."""
        latched = LATCHED if self._supervisor.state is State.FAULT else 0
        self._drive.write_check(bytes((session, self._device.od.node_id | latched)))
        self._device.trigger(DRIVE_TPDO)

    def all(self) -> None:
        """Send all public TPDOs for the last time."""
        for number in (_STATUS_TPDO, *_MEASURED_TPDOS):
            self._device.trigger(number)

    def report(self) -> None:
        """Send emergency messages for faults latched or reset since the last call."""
        before, self._reported = self._reported, self._supervisor.latched
        if before == self._reported:
            return
        for watchdog in watchdogs_in(before & ~self._reported):
            self._device.clear_emergency(WATCHDOGS[watchdog].code)
        for watchdog in watchdogs_in(self._reported & ~before):
            row = WATCHDOGS[watchdog]
            self._device.emergency(row.code, row.register, bytes((watchdog,)))
            self._device.trigger(_STATUS_TPDO)

    def mark_reported(self) -> None:
        """Mark the latched faults as reported, as during a reset no message can be sent."""
        self._reported = self._supervisor.latched

    def report_all(self) -> None:
        """Report all latched faults again, also those from before a reset."""
        self._reported = 0
        self.report()


_PERCENT: Final = 100
_LINKING: Final = (NMTState.RESET_COMMUNICATION, NMTState.OPERATIONAL)
"""States in which links are set: after a reset, so that they can be read; and at the start, for
those that a master has changed since."""
_RESETS: Final = (NMTState.RESET_APPLICATION, NMTState.RESET_COMMUNICATION)


class StimulatorNode(DeviceNode):
    """Nested controllers and tribometer, with the plate inside or as a node on the bus.

    With the plate inside, `advance` moves the loop. With a plate node, a cycle is computed as soon
    as the last measurement PDO of its tick is received, and the drive is sent immediately.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    plate
        Function block of the plate inside; None with a plate node.
    plate_node_id
        Node-ID of the plate node, 1..127, to whose default COB-IDs the stimulator links; 0 with
        the plate inside.
    produce_sync
        Whether this node produces the SYNC that is the tick of the plate node.
    lockstep
        Whether SYNC is the only clock. As no time then passes without the master, the master need
        not be supervised.
    deadline_ms
        Default of the event timers of the measurements in ms; None for the default of the EDS.
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
        if plate_node_id:
            expect_plate(od, plate_node_id, deadline_ms)
        clock = Clock()
        self._supervisor = self.block.supervisor
        self._loop = BusLoop(od, clock, self.block.deadline, self._observe, self._on_unanswered)
        self._missed_time = MissedTime(clock)
        self._ticker = clock.timer(self._tick)
        device = Device(
            od, self, storage=storage, node_id=node_id, clock=clock, loop_tpdos=(DRIVE_TPDO,),
            loop_rpdos=MEASUREMENT_RPDOS, emergencies_of=plate_node_id,
        )  # fmt: skip
        super().__init__(device)
        self._period = LoopPeriod(device)
        self._commander = Commander(device, plate_node_id, self._observe, lockstep=lockstep)
        self._supervisor.advice = self._commander.advice
        self._supervisor.details = self._details
        self._publishing = Publishing(device, self._supervisor)
        self._report = self._publishing.report
        self._publish = self._publishing.cycle
        self._unfit = False
        self._missed = od["Cycle.Missed deadlines"]
        self._missed_max = od["Limit.Missed ticks"]
        self._temperature = od["Plate input.Temperature"]
        self._mode = od["Mode"]
        self._controlword = od["Controlword"]

    def overdue(self) -> list[Frame]:
        """Trip if the plate was not answered in time, before waiting frames are processed."""
        self._loop.overdue()
        return self.device.take()

    def bus_off(self) -> list[Frame]:
        """Record that the CAN controller went bus-off."""
        self._observe(Watchdog.BUS_OFF, True)
        return self.device.bus_off()

    def bus_recovered(self) -> list[Frame]:
        """Record that the CAN controller is on the bus again."""
        self._observe(Watchdog.BUS_OFF, False)
        return self.device.bus_recovered()

    def transmit_failed(self) -> list[Frame]:
        """Record that a frame could not be sent because the transmit queue is full."""
        self._observe(Watchdog.TRANSMIT_QUEUE, True)
        return self.device.take()

    def levels(self) -> tuple[float, ...]:
        """Return the level of each watchdog of `COUNTED` at the end of this tick; 1.0 is a fault.

        It is computed only on request, after a cycle; no cycle takes time for it.
        """
        s = self._supervisor
        temperature = self._temperature.value * self._temperature.si
        missed = self._missed_time.missed * _PERCENT / (self._missed_max.value * TICKS)
        found = levels(s.plan, s.watch, s.in_force, self.block.cascade.contact, temperature)
        found |= self._loop.levels()
        found[Watchdog.HEARTBEAT] = max(
            self.device.heartbeat_level(TICK_US), self._commander.level()
        )
        found[Watchdog.SETPOINT] = self.device.rpdo_level(SETPOINT_RPDOS, TICK_US)
        found[Watchdog.MISSED_TIME] = missed
        return tuple([found[watchdog] for watchdog in COUNTED])

    def shutdown(self) -> list[Frame]:
        """Set the plate to 0 V, and publish the state."""
        self.block.disarm()
        self._publishing.drive(self._loop.session)
        self._publishing.all()
        return self.device.take()

    def on_state(self, state: NMTState) -> None:
        """Start from rest at power-on, link to the plate node; drive only in OPERATIONAL."""
        if state is NMTState.RESET_APPLICATION:
            self._unfit = mend_settings(self.od)
            self.block.power_on()
            for name, raw in self._presets.items():
                self.block.write(name, raw)
            self.od["Plate node-ID"].value = self._plate_node_id
            self.block.start_run()
            if not self._plate_node_id:
                self._ticker.start(TICK_US, periodic=True)
        elif state in _LINKING and self._plate_node_id:
            for entry, value in links_to_plate(self.od, self._plate_node_id, self._produce_sync):
                self.device.put(entry, value)
        self.on_parameters()
        block = self.block
        if state is NMTState.OPERATIONAL:
            block.enter()
        else:
            block.leave()
            self._loop.leave()
        if state in _RESETS:
            self._commander.restart()
            self._loop.source.forget()
            self._publishing.mark_reported()
        else:
            if self._unfit:
                self.device.emergency(EmergencyCode.DATA_STORAGE, ErrorRegister.GENERIC)
            self._publishing.report_all()

    def on_sync(self) -> bool:
        """Check the time, the counter and the sender of a SYNC."""
        if self._plate_node_id:
            self._missed_time.awake()
            self._loop.sync(self.device)
        return True

    def on_collision(self, heard: bool) -> None:
        """Trip when another node uses an identifier of this node."""
        self._loop.source.collide(heard)

    def on_error_control(self, node_id: int, lost: bool) -> None:
        """Trip when a supervised node is silent."""
        self._commander.silent(node_id, lost)

    def on_heartbeat(self, node_id: int, state: int) -> None:
        """Trip when a supervised node boots again, or has left OPERATIONAL for too long."""
        self._commander.heard(node_id, state)

    def on_emergency(self, code: int) -> None:
        """Trip when the plate reports that it went to 0 V, or another sender of its frames."""
        watchdog = REPORTED_BY_PLATE.get(code)
        if watchdog is Watchdog.DOUBLE:
            self._loop.source.plate_reports_another()
        elif watchdog is not None:
            self._observe(watchdog, True)

    def on_rpdo_timeout(self, number: int, late: bool) -> None:
        """Trip when the master's set-points are late; measurements have a watchdog of their own."""
        if number not in MEASUREMENT_RPDOS:
            self._commander.late(number, late)

    def on_rpdo(self, number: int) -> None:
        """Obey a controlword received in an RPDO."""
        if self.device.carries(number, self._controlword):
            before = self.block.state
            self.block.note_supervision(self._commander.supervised)
            self.block.take_controlword()
            self._report()
            self._show_change(before)

    def on_loop_rpdo(self, number: int, data: bytes) -> None:
        """Answer a measurement if this PDO completes it."""
        loop = self._loop
        if self._plate_node_id and loop.take(number, data):
            if not self._period.agrees():
                self._observe(Watchdog.MEASUREMENT, True)
                return
            self.block.cycle(loop.measurement, late=loop.answer())
            self._judge_time()
            self._report()
            self._publishing.drive(loop.session)
            self._publish()

    def on_store(self) -> None:
        """Refuse to store while armed or running: writing a file may take longer than a cycle.

        Raises
        ------
        Abort
            STATE while armed or running.
        """
        if self._supervisor.armed:
            raise Abort(
                AbortCode.STATE, "parameters are not stored or restored while armed: disarm first"
            )

    def on_write(self, entry: Entry, value: Any) -> None:
        """Apply a write; raise `Abort` as the block does, and for a Mode outside OPERATIONAL."""
        if entry is self._mode and value and self.device.nmt_state is not NMTState.OPERATIONAL:
            raise Abort(
                AbortCode.STATE,
                f"Mode {value} needs NMT OPERATIONAL: start the node, then write Mode again",
            )
        before = self.block.state
        if entry is self._controlword:
            self.block.note_supervision(self._commander.supervised)
        self.block.on_write(entry, value)
        self._loop.on_write(entry, value)
        if entry.index == cia.HEARTBEAT_CONSUMER:
            self._commander.consumer_changed(entry.value, value)
        self._report()
        self._show_change(before)
        if entry.name == START_RUN:
            self._loop.start_run()

    def on_parameters(self) -> None:
        """Apply a new deadline of the loop."""
        if self._plate_node_id:
            self.block.follow_deadline()

    def on_refused(self, name: str, reason: str) -> None:
        """Set the Message to the reason of a refused write."""
        self._supervisor.refuse(name, reason)

    def _judge_time(self) -> None:
        """Trip if too many ticks of a second of the run had no cycle."""
        missed = self._missed_time.cycle()
        if self._plate_node_id and not self.device.sync.own:
            self._missed.count(missed)
        running = self.block.state is State.RUNNING
        if running and missed * _PERCENT > self._missed_max.value * TICKS:
            self.block.observe(Watchdog.MISSED_TIME, True)

    def _details(self, watchdog: Watchdog) -> str:
        if watchdog is Watchdog.MISSED_TIME:
            return self._missed_time.summary()
        return self._loop.late_answers.summary() if watchdog in OF_LATE_DRIVES else ""

    def _on_unanswered(self) -> None:
        self.block.mark_stale()
        if self._supervisor.live:
            self._observe(Watchdog.MEASUREMENT, True)

    def _tick(self) -> None:
        """Run a cycle with the plate inside, and count the missed ticks."""
        self._missed.count(self._ticker.missed)
        self.block.tick()
        self._judge_time()
        self._report()
        self._publish()

    def _show_change(self, before: State) -> None:
        """Publish a change of state immediately, with a drive of 0 V after RUNNING and FAULT."""
        if self.block.state is before:
            return
        if self.block.state is State.RUNNING:
            self._missed_time.restart()
        self._publishing.status()
        if before in (State.RUNNING, State.FAULT) and self._plate_node_id:
            self._publishing.drive(self._loop.session)

    def _observe(self, watchdog: Watchdog, present: bool) -> None:
        """Take a fault that comes or goes between two cycles; a trip sends 0 V immediately."""
        if not (present or self._supervisor.present >> watchdog & 1):
            return
        before = self.block.state
        self.block.observe(watchdog, present)
        self._report()
        self._show_change(before)
