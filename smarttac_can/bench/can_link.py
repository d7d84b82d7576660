"""The link over CAN: SDO by python-canopen, recordings from the stimulator's TPDOs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from queue import Empty
from time import monotonic, sleep
from typing import Final

import can

from smarttac_can.bench.bench_heartbeat import BenchHeartbeat, bench_id, drives
from smarttac_can.bench.cycle_rows import CycleRows
from smarttac_can.bench.errors import NotRunningError
from smarttac_can.bench.every_cycle import EveryCycle
from smarttac_can.bench.link import RECORDED, FrameSource, Hear, OneRun, Row, Snapshot, never
from smarttac_can.bench.local_network import LocalNetwork
from smarttac_can.bench.node_time import wrong_time
from smarttac_can.bench.published import commanded_pdos, published_pdos
from smarttac_can.bench.remote_device import RemoteDevice
from smarttac_can.bench.tapped_network import TappedNetwork
from smarttac_can.host.kernel_filter import hear_only, hold_more
from smarttac_can.master.errors import BenchError, BusLostError
from smarttac_can.od.cia import EMCY_ID, HEARTBEAT_ID, SDO_RX_ID, SDO_TX_ID, SYNC_ID
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.objects import SIMULATION

GRACE_S: Final = 1.0
"""How much longer than its cycles take a run in real time may take."""
_CHECK_S: Final = 1.0
"""How long there may be no cycle in real time before heartbeats are looked at."""
SILENT_S: Final = 5.0
"""How long a node in lockstep may answer nothing before it is taken for dead."""
_ASK_AFTER_S: Final = 0.1
"""How long a cycle in lockstep may take before the nodes are asked whether they have heard it."""
_ANSWER_S: Final = 1.0
_STATUS_TPDO: Final = 1
_LOST_IN_A_ROW: Final = 3
_POLL_S: Final = 0.005


class CanLink:
    """A stimulator on a CAN bus, with the plate inside or as a node of its own.

    Parameters
    ----------
    network
        Connected network of python-canopen; closed with the link.
    stimulator
        EDS of the stimulator, loaded for its node-ID.
    plate
        EDS of the plate node, loaded for its node-ID; None with the plate inside the stimulator.
    where
        Name of the bus for error messages.
    lockstep
        Whether the bench produces the SYNC and waits for every cycle.
    timeout
        Longest wait in s for an SDO answer, and for the first values; None for 1 s, and for
        `SILENT_S` in lockstep.
    """

    def __init__(
        self,
        network: TappedNetwork,
        stimulator: ObjectDictionary,
        plate: ObjectDictionary | None,
        *,
        where: str,
        lockstep: bool,
        timeout: float | None,
    ) -> None:
        if timeout is None:
            timeout = SILENT_S if lockstep else _ANSWER_S
        self._network = network
        self.where = where
        self._lockstep = lockstep
        self._timeout = timeout
        # On a local bus everything happens within the call that sends: there is no other thread
        # to wait for, and the time is the bus's.
        self._threaded = not isinstance(network, LocalNetwork)
        self._clock = monotonic if self._threaded else network.now
        self._stimulator = RemoteDevice(network, stimulator, where, timeout)
        self._plate = RemoteDevice(network, plate, where, timeout) if plate else None
        # The plate first, so that its measurements await nobody.
        self._devices = [d for d in (self._plate, self._stimulator) if d is not None]
        self._pdos = published_pdos(stimulator, self._stimulator.read)
        self._cycles = CycleRows(self._stimulator, self._pdos, self._clock)
        wanted = {pdo.number for pdo in self._pdos} - {_STATUS_TPDO} | self._cycles.wanted
        self._every_cycle = EveryCycle(network, self._stimulator, sorted(wanted))
        for pdo in self._pdos:
            network.subscribe(pdo.can_id, self._cycles.receiver(pdo))
        for device in self._devices:
            device.start()
        # In lockstep the nodes' time stands still without the bench.
        self._heartbeat = None if lockstep else BenchHeartbeat(network, self._stimulator)
        self._heard: frozenset[int] = frozenset()
        self._alone = OneRun()
        self._time_is_right = not lockstep
        self._services = {
            service + device.od.node_id
            for service in (EMCY_ID, SDO_TX_ID, SDO_RX_ID, HEARTBEAT_ID)
            for device in self._devices
        }
        self._listen()

    def drive(self) -> None:
        """Have this bench watched from now on, in real time; refused while another one drives."""
        if self._heartbeat is not None:
            self._heartbeat.begin()

    def read(self, name: str) -> int:
        """Read the raw value of an object over SDO."""
        device = self._owner(name)
        return int(device.read(device.od[name]))

    def text(self, name: str) -> str:
        """Read an object over SDO that is a string."""
        return str(self._stimulator.read(self._stimulator.od[name]))

    def write(self, name: str, raw: int) -> None:
        """Write a raw value to an object over SDO; a bench that drives is watched from then on."""
        if self.only_read and drives(name, raw):
            self.drive()
        device = self._owner(name)
        device.write(device.od[name], raw)

    def read_table(self, name: str) -> bytes:
        """Read an object over SDO that is a DOMAIN."""
        return bytes(self._stimulator.read(self._stimulator.od[name]))

    def write_table(self, name: str, data: bytes) -> None:
        """Write an object over SDO that is a DOMAIN, by block transfer."""
        self._stimulator.write_block(self._stimulator.od[name], data)

    def snapshot(self) -> Snapshot:
        """Return what the public TPDOs carried last; in real time wait for the first of each."""
        self._check()
        if not self._lockstep:
            self._stimulator.check_operational()
            self._await_first()
        values: dict[str, int] = {}
        oldest = now = self._clock()
        for pdo in self._pdos:
            if pdo.received is not None:
                values.update(zip(pdo.names, pdo.values, strict=True))
                oldest = min(oldest, pdo.received)
        return Snapshot(values, now - oldest)

    def start_run(self) -> None:
        """Put the simulated plate to rest at tick 0 and reset the controllers."""
        if self._plate is not None:
            self._plate.write(self._plate.od["Simulation.Start run"], 1)
        self._stimulator.write(self._stimulator.od["Simulation.Start run"], 1)

    def run(self, cycles: int, rows: list[Row], interrupted: Callable[[], bool] = never) -> None:
        """Let the loop run and record it from the TPDOs, sent in every cycle meanwhile.

        Raises
        ------
        NotRunningError
            If not one cycle came, the TPDOs do not carry what a recording holds, or in lockstep
            the node runs in real time.
        HeartbeatLostError
            If a node has fallen silent.
        BusyError
            While another thread runs the loop.
        """
        with self._alone:
            self._run(cycles, rows, interrupted)

    def _run(self, cycles: int, rows: list[Row], interrupted: Callable[[], bool]) -> None:
        collected = self._cycles
        if not collected.whole:
            raise NotRunningError(
                f"the TPDOs of node {self._stimulator.od.node_id} do not map all of "
                f"{', '.join(RECORDED)}: restore their default mapping"
            )
        collected.learn_held(self.read)
        # Before the first SYNC nothing comes from nodes in lockstep.
        if not self._time_is_right and (wrong_time := self.wrong_time()):
            raise NotRunningError(wrong_time)
        self._time_is_right = True
        # Of another script that puts the types back the bench has to hear.
        with self._hearing(self._services), self._every_cycle.held():
            collected.rows = rows
            try:
                if self._lockstep:
                    self._produce_sync(cycles, interrupted)
                else:
                    self._wait_for(cycles, rows, interrupted)
            finally:
                collected.rows = None
        if not rows and not interrupted():
            self._check()
            raise NotRunningError(
                self.wrong_time()
                or "the loop gives no cycles: are all nodes operational, and does one produce SYNC?"
            )

    def source(self) -> FrameSource:
        """Tell what the stimulator says its PDOs carry."""
        device = self._stimulator
        return FrameSource(
            published=self._pdos,
            every_cycle=self._every_cycle.numbers,
            commanded=commanded_pdos(device.od, device.read),
            plate=None if self._plate is None else self._plate.od,
            clocked=not self._lockstep,
        )

    @contextmanager
    def frames(self, hear: Hear) -> Iterator[None]:
        """Have the frames of these nodes told, and those that command them."""
        network = self._network
        commanded = commanded_pdos(self._stimulator.od, self._stimulator.read)
        told = {pdo.can_id for pdo in (*self._pdos, *commanded)} | self._services
        tap = (told, hear)
        if self._threaded:
            hold_more(network.bus)
        # Before all types are set there is no whole cycle, and after the first is put back none.
        with self._hearing(told), self._every_cycle.held():
            network.taps += (tap,)
            try:
                yield
            finally:
                network.taps = tuple(other for other in network.taps if other is not tap)

    def raw(self, path: Path) -> AbstractContextManager[str]:
        """Log all frames on the bus, those of this bench too, in a format of python-can."""
        from smarttac_can.bench.raw_log import raw_log  # noqa: PLC0415 - its formats take long

        return raw_log(self._network, path)

    def wrong_time(self) -> str:
        """Say that the stimulator keeps another time than the link believes; empty if not."""
        return wrong_time(self._stimulator, self._pdos, self._lockstep) if self._threaded else ""

    @property
    def only_read(self) -> bool:
        """Whether the stimulator may be driven by another bench, and is not by this one."""
        return self._heartbeat is not None and not self._heartbeat.begun

    def close(self) -> None:
        """Leave the bus; may be called twice."""
        presence, self._heartbeat = self._heartbeat, None
        if presence is not None and presence.begun:
            with suppress(BenchError):
                presence.end(self._at_rest())
        # python-canopen raises, when all is closed, what has ended its receiving.
        with suppress(can.CanError):
            self._network.disconnect()

    def _await_first(self) -> None:
        end = self._clock() + self._timeout
        while any(pdo.received is None for pdo in self._pdos) and self._clock() < end:
            sleep(_POLL_S)
        none = all(pdo.received is None for pdo in self._pdos)
        if none and (wrong_time := self.wrong_time()):
            raise NotRunningError(wrong_time)

    def _at_rest(self) -> bool:
        try:
            return self.read("Mode") == Mode.OFF
        except BenchError:
            return False

    def _owner(self, name: str) -> RemoteDevice:
        simulated = name.partition(".")[0] in SIMULATION
        return self._plate if simulated and self._plate is not None else self._stimulator

    def _check(self) -> None:
        # In lockstep the nodes' time, and so their heartbeat, stands still between the cycles.
        if not self._lockstep:
            for device in (self._stimulator, self._plate):
                if device is not None:
                    device.check_heartbeat()

    @contextmanager
    def _hearing(self, can_ids: Iterable[int]) -> Iterator[None]:
        """Have the kernel let more frames pass while a block lasts."""
        before, self._heard = self._heard, self._heard | frozenset(can_ids)
        self._listen()
        try:
            yield
        finally:
            self._heard = before
            self._listen()

    def _listen(self) -> None:
        """Have the kernel drop what nobody here listens to."""
        if self._threaded:
            heartbeat = HEARTBEAT_ID + bench_id(self._stimulator.od.node_id)
            hear_only(self._network.bus, {*self._network.subscribers, heartbeat, *self._heard})

    def _produce_sync(self, cycles: int, interrupted: Callable[[], bool]) -> None:
        complete = self._cycles.complete
        lost = 0
        for _ in range(cycles):
            while not complete.empty():
                complete.get()
            if interrupted():
                return
            try:
                self._network.send_message(SYNC_ID, b"")
            except can.CanError as error:
                raise BusLostError(f"cannot produce SYNC: the bus has failed: {error}") from error
            lost = 0 if self._ends(interrupted) else lost + 1
            if lost == _LOST_IN_A_ROW:
                raise NotRunningError(
                    f"{lost} cycles in a row were lost: is the plate there, and are all nodes "
                    "operational and started with --lockstep?"
                )

    def _ends(self, interrupted: Callable[[], bool]) -> bool:
        """Wait for the end of a cycle in lockstep; return whether it has one.

        Nodes hear frames in the order in which they were sent. Once each of them, the plate first,
        has answered a request behind the SYNC, all that the cycle may still bring has come. How
        long they take for it is up to them.
        """
        complete = self._cycles.complete
        if self._threaded and self._stimulator.operational:
            try:
                complete.get(timeout=_ASK_AFTER_S)
            except Empty:
                for device in self._devices:
                    device.await_answer(SILENT_S, interrupted)
            else:
                return True
        return not complete.empty()

    def _wait_for(self, cycles: int, rows: list[Row], interrupted: Callable[[], bool]) -> None:
        end = self._clock() + cycles * 1e-3 + GRACE_S
        while len(rows) < cycles and (left := end - self._clock()) > 0 and not interrupted():
            try:
                self._cycles.complete.get(timeout=min(left, _CHECK_S))
            except Empty:
                self._check()
