"""The stimulator node: a CANopen device around the function block of the stimulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.device.port import Clock, Identifiers
from smarttac_can.device.service import Application
from smarttac_can.device.storage import Storage
from smarttac_can.nodes.bus_loop import BusLoop
from smarttac_can.nodes.commander import SETPOINT_RPDOS, Commander
from smarttac_can.nodes.loop_frames import DRIVE_TPDO, MEASUREMENT_RPDOS
from smarttac_can.nodes.loop_time import TICKS, LoopPeriod, MissedTime
from smarttac_can.nodes.plans import mend_settings
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.plate_link import expect_plate, links_to_plate
from smarttac_can.nodes.publishing import Publishing
from smarttac_can.nodes.stimulator_block import StimulatorBlock
from smarttac_can.nodes.watches import levels
from smarttac_can.od.cia import HEARTBEAT_CONSUMER, Abort, AbortCode, EmergencyCode, ErrorRegister
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.objects import START_RUN
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import (
    COUNTED,
    OF_LATE_DRIVES,
    REPORTED_BY_PLATE,
    Watchdog,
)

_PERCENT: Final = 100
_LINKING: Final = (NMTState.RESET_COMMUNICATION, NMTState.OPERATIONAL)
"""After a reset the links can be read; what a master has written since is mended at the start."""
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
        if plate_node_id:
            expect_plate(od, plate_node_id, deadline_ms)
        self.clock = clock = Clock()
        self._supervisor = self.block.supervisor
        self._loop = BusLoop(od, clock, self.block.deadline, self._observe, self._on_unanswered)
        self._missed_time = MissedTime(clock)
        self._ticker = clock.timer(self._tick)
        self.device = Device(
            od, self, storage=storage, node_id=node_id, clock=clock, loop_tpdos=(DRIVE_TPDO,),
            loop_rpdos=MEASUREMENT_RPDOS, emergencies_of=plate_node_id,
        )  # fmt: skip
        self._period = LoopPeriod(self.device)
        self._commander = Commander(self.device, plate_node_id, self._observe, lockstep=lockstep)
        self._supervisor.advice = self._commander.advice
        self._supervisor.details = self._details
        self._publishing = Publishing(self.device, self._supervisor)
        self._report = self._publishing.report
        self._publish = self._publishing.cycle
        self._unfit = False
        self._missed = od["Cycle.Missed deadlines"]
        self._missed_max = od["Limit.Missed ticks"]
        self._temperature = od["Plate input.Temperature"]
        self._mode = od["Mode"]
        self._controlword = od["Controlword"]
        self.start = self.device.start
        self.receive = self.overtaken = self.device.receive
        self.advance = self.device.advance
        self.segments = self.device.segments

    @property
    def ids(self) -> Identifiers:
        """CAN-IDs that the node listens to, and those of its urgent frames, now."""
        return self.device.ids

    def overdue(self) -> list[Frame]:
        """Trip if the plate was not answered in time, before frames are heard that waited."""
        self._loop.overdue()
        return self.device.take()

    def bus_off(self) -> list[Frame]:
        """Take note that the CAN controller went bus-off."""
        self._observe(Watchdog.BUS_OFF, True)
        return self.device.bus_off()

    def bus_recovered(self) -> list[Frame]:
        """Take note that the bus is there again."""
        self._observe(Watchdog.BUS_OFF, False)
        return self.device.bus_recovered()

    def transmit_failed(self) -> list[Frame]:
        """Take note that a frame could not be sent, the transmit queue being full."""
        self._observe(Watchdog.TRANSMIT_QUEUE, True)
        return self.device.take()

    def levels(self) -> tuple[float, ...]:
        """How near each watchdog of `COUNTED` is to a fault, 1.0, at the end of this tick.

        It costs nothing unless asked, after a cycle: no cycle works for it.
        """
        s = self._supervisor
        temperature = self._temperature.value * self._temperature.si
        missed = self._missed_time.missed * _PERCENT / (self._missed_max.value * TICKS)
        shares = levels(s.plan, s.watch, s.in_force, self.block.cascade.contact, temperature)
        shares |= self._loop.levels()
        shares[Watchdog.HEARTBEAT] = max(self.device.silence(TICK_US), self._commander.level())
        shares[Watchdog.SETPOINT] = self.device.lateness(SETPOINT_RPDOS, TICK_US)
        shares[Watchdog.MISSED_TIME] = missed
        return tuple([shares[watchdog] for watchdog in COUNTED])

    def shutdown(self) -> list[Frame]:
        """Leave the plate at 0 V, and tell the bus."""
        self.block.disarm()
        self._publishing.drive(self._loop.session)
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
            self._commander.leave()
        if state in _RESETS:
            self._commander.restart()
            self._loop.source.forget()
            self._publishing.hold()
        else:
            if self._unfit:
                self.device.emergency(EmergencyCode.DATA_STORAGE, ErrorRegister.GENERIC)
            self._publishing.report_all()

    def on_sync(self) -> bool:
        """Look at when the SYNC comes, at its counter, and whose it is."""
        if self._plate_node_id:
            self._missed_time.awake()
            self._loop.sync(self.device)
        return True

    def on_collision(self, heard: bool) -> None:
        """Stop when another node has an identifier of this one."""
        self._loop.source.collide(heard)

    def on_error_control(self, node_id: int, lost: bool) -> None:
        """Stop when a watched node falls silent."""
        self._commander.silent(node_id, lost)

    def on_heartbeat(self, node_id: int, state: int) -> None:
        """Stop when a watched node starts anew, or is OPERATIONAL no more."""
        self._commander.heard(node_id, state)

    def on_emergency(self, code: int) -> None:
        """Stop when the plate has gone to 0 V without being told, or is not alone."""
        watchdog = REPORTED_BY_PLATE.get(code)
        if watchdog is Watchdog.DOUBLE:
            self._loop.source.plate_reports_another()
        elif watchdog is not None:
            self._observe(watchdog, True)

    def on_rpdo_timeout(self, number: int, late: bool) -> None:
        """Stop when the master's set-points stay away; measurements have a watch of their own."""
        if number not in MEASUREMENT_RPDOS:
            self._commander.late(number, late)

    def on_rpdo(self, number: int) -> None:
        """Obey a controlword."""
        if self.device.carries(number, self._controlword):
            before = self.block.state
            self.block.note_supervision(self._commander.kept)
            self.block.take_controlword()
            self._report()
            self._show_change(before)

    def on_loop_rpdo(self, number: int, data: bytes) -> None:
        """Answer a measurement that is complete."""
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
        """Refuse to store while armed or running: a file may take longer than a cycle.

        Raises
        ------
        Abort
            STATE in these states.
        """
        if self._supervisor.armed:
            raise Abort(
                AbortCode.STATE, "parameters are not stored or restored while armed: disarm first"
            )

    def on_write(self, entry: Entry, value: Any) -> None:
        """Refuse a mode that drives outside OPERATIONAL, and what the block refuses."""
        if entry is self._mode and value and self.device.nmt_state is not NMTState.OPERATIONAL:
            raise Abort(
                AbortCode.STATE,
                f"Mode {value} needs NMT OPERATIONAL: start the node, it goes on with Mode 0",
            )
        before = self.block.state
        if entry is self._controlword:
            self.block.note_supervision(self._commander.kept)
        self.block.on_write(entry, value)
        self._loop.on_write(entry, value)
        if entry.index == HEARTBEAT_CONSUMER:
            self._commander.rewatch(entry.value, value)
        self._report()
        self._show_change(before)
        if entry.name == START_RUN:
            self._loop.start_run()

    def on_parameters(self) -> None:
        """Follow another deadline of the loop."""
        if self._plate_node_id:
            self.block.follow_deadline()

    def on_refused(self, name: str, reason: str) -> None:
        """Have the Message say why."""
        self._supervisor.refuse(name, reason)

    def _judge_time(self) -> None:
        """Stop if too much of a second of the run had no cycle."""
        missed = self._missed_time.cycle()
        if self._plate_node_id and not self.device.sync_own:
            self._missed.count(missed)
        running = self.block.state is State.RUNNING
        if running and missed * _PERCENT > self._missed_max.value * TICKS:
            self.block.observe(Watchdog.MISSED_TIME, True)

    def _details(self, watchdog: Watchdog) -> str:
        """Say what the text of a fault leaves open."""
        if watchdog is Watchdog.MISSED_TIME:
            return self._missed_time.summary()
        return self._loop.late_answers.summary() if watchdog in OF_LATE_DRIVES else ""

    def _on_unanswered(self) -> None:
        self.block.mark_stale()
        if self._supervisor.live:
            self._observe(Watchdog.MEASUREMENT, True)

    def _tick(self) -> None:
        """Have a cycle with the plate inside; those that were slept through are counted."""
        self._missed.count(self._ticker.missed)
        self.block.tick()
        self._judge_time()
        self._report()
        self._publish()

    def _show_change(self, before: State) -> None:
        """Publish another state at once, and 0 V for a plate that drives or awaits the reset."""
        if self.block.state is before:
            return
        if self.block.state is State.RUNNING:
            self._missed_time.restart()
        self._publishing.status()
        if before in (State.RUNNING, State.FAULT) and self._plate_node_id:
            self._publishing.drive(self._loop.session)

    def _observe(self, watchdog: Watchdog, present: bool) -> None:
        """Take a fault that comes, or goes, between two cycles: the plate node is told at once."""
        if not (present or self._supervisor.present >> watchdog & 1):
            return
        before = self.block.state
        self.block.observe(watchdog, present)
        self._report()
        self._show_change(before)
