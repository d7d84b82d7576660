"""The link over CAN: SDO by python-canopen, recordings from the stimulator's TPDOs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from operator import itemgetter
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Final

import can
import canopen

from smarttac_can.bench.bench_heartbeat import BenchHeartbeat, bench_id
from smarttac_can.bench.errors import NotRunningError
from smarttac_can.bench.link import RECORDED, Row, Snapshot
from smarttac_can.bench.local_network import LocalNetwork
from smarttac_can.bench.node_time import wrong_time
from smarttac_can.bench.published import PublishedPdo, published_pdos
from smarttac_can.bench.remote_device import RemoteDevice
from smarttac_can.device.nmt import NMTState
from smarttac_can.host.kernel_filter import hear_only
from smarttac_can.master.errors import BenchError, BusLostError
from smarttac_can.od.cia import (
    EVENT_MANUFACTURER,
    HEARTBEAT_ID,
    PDO_TRANSMISSION,
    SYNC_ID,
    TPDO_COMMUNICATION,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.objects import SIMULATION
from smarttac_can.vocabulary.states import Control

LOST_CYCLE_S: Final = 1.0
"""How long a cycle in lockstep may take before it counts as lost."""
_PUBLIC_TPDOS: Final = range(1, 5)
_TICK: Final = RECORDED.index("Contact.Tick")
_LOST_IN_A_ROW: Final = 3


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
        Longest wait for an SDO answer in s.
    """

    def __init__(
        self,
        network: canopen.Network,
        stimulator: ObjectDictionary,
        plate: ObjectDictionary | None,
        *,
        where: str,
        lockstep: bool,
        timeout: float,
    ) -> None:
        self._network = network
        self.where = where
        self._lockstep = lockstep
        # On a local bus everything happens within the call that sends: there is no other thread
        # to wait for, and the time is the bus's.
        self._threaded = not isinstance(network, LocalNetwork)
        self._clock = monotonic if self._threaded else network.now
        self._stimulator = RemoteDevice(network, stimulator, where, timeout)
        self._plate = RemoteDevice(network, plate, where, timeout) if plate else None
        self._pdos = published_pdos(stimulator, _PUBLIC_TPDOS, self._stimulator.read)
        self._rows: list[Row] = []
        self._come: set[int] = set()
        # At a tenth of what an event takes.
        self._complete: SimpleQueue[None] = SimpleQueue()
        self._columns = self._find_columns()
        for pdo in self._pdos:
            network.subscribe(pdo.can_id, self._receiver(pdo))
        # The plate first, so that its measurements await nobody.
        for device in (self._plate, self._stimulator):
            if device is not None:
                device.start()
        # In lockstep the nodes' time stands still without the bench.
        self._heartbeat = None if lockstep else BenchHeartbeat(network, self._stimulator)
        if self._threaded:
            heartbeat = HEARTBEAT_ID + bench_id(stimulator.node_id)
            hear_only(network.bus, {*network.subscribers, heartbeat})

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
        if self.only_read and _drives(name, raw):
            self.drive()
        device = self._owner(name)
        device.write(device.od[name], raw)

    def snapshot(self) -> Snapshot:
        """Return what the public TPDOs carried last."""
        self._check()
        if not self._lockstep:
            self._stimulator.check_operational()
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

    def run(self, cycles: int) -> list[Row]:
        """Let the loop run and record it from the TPDOs, sent in every cycle meanwhile.

        Raises
        ------
        NotRunningError
            If not one cycle came, or the TPDOs do not carry what a recording holds.
        HeartbeatLostError
            If a node has fallen silent.
        """
        if self._columns is None:
            raise NotRunningError(
                f"the TPDOs of node {self._stimulator.od.node_id} do not map all of "
                f"{', '.join(RECORDED)}: restore their default mapping"
            )
        with self._every_cycle():
            self._rows = []
            if self._lockstep:
                self._produce_sync(cycles)
            else:
                self._wait_for(cycles)
            rows = self._rows[:cycles]
        if not rows and cycles:
            self._check()
            raise NotRunningError(
                self.wrong_time()
                or "the loop gives no cycles: are all nodes operational, and does one produce SYNC?"
            )
        return rows

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

    def _find_columns(self) -> list[tuple[PublishedPdo, int]] | None:
        """Find the TPDO and place of each recorded object; None if one is in no TPDO."""
        columns = []
        for name in RECORDED:
            places = [(pdo, pdo.names.index(name)) for pdo in self._pdos if name in pdo.names]
            if not places:
                return None
            columns.append(places[0])
        return columns

    @contextmanager
    def _every_cycle(self) -> Iterator[None]:
        """Have the recorded TPDOs sent in every cycle, and put their types back afterwards."""
        assert self._columns is not None
        device = self._stimulator
        before = []
        for number in sorted({pdo.number for pdo, _ in self._columns}):
            entry = device.od.entry(TPDO_COMMUNICATION + number - 1, PDO_TRANSMISSION)
            kind = device.read(entry)
            # A recording that was killed, or one that another bench makes, has left it so.
            before.append((entry, entry.default if kind == EVENT_MANUFACTURER else kind))
            device.write(entry, EVENT_MANUFACTURER)

        def restore() -> None:
            for entry, kind in before:
                device.write(entry, kind)

        try:
            yield
        except BaseException:
            # The first failure is the one to report.
            with suppress(BenchError):
                restore()
            raise
        restore()

    def _receiver(self, pdo: PublishedPdo) -> Callable[[int, bytearray, float], None]:
        """Make the callback of a TPDO; that of the cycle's last one completes a row."""
        columns = self._columns or []
        wanted = {place.number for place, _ in columns}
        parts, row_of = _row_maker(columns)
        number, completes = pdo.number, pdo.number == max(wanted, default=0)
        come, complete = self._come, self._complete
        clock, stimulator = self._clock, self._stimulator
        operational = NMTState.OPERATIONAL

        def on_pdo(_can_id: int, data: bytearray, _timestamp: float) -> None:
            if not pdo.take(data, clock()):
                return
            # PDOs are OPERATIONAL's alone; the next heartbeat may be a second away.
            stimulator.state = operational
            come.add(number)
            if completes:
                # A row with a lost frame would mix two cycles.
                if come >= wanted:
                    values: list[int] = []
                    for part in parts:
                        values += part.values
                    self._record(row_of(values))
                come.clear()
                if complete.empty():
                    complete.put(None)

        return on_pdo

    def _record(self, row: Row) -> None:
        rows = self._rows
        # When a cycle comes late, the event timers of the TPDOs repeat the one before.
        if not rows or row[_TICK] != rows[-1][_TICK]:
            rows.append(row)

    def _produce_sync(self, cycles: int) -> None:
        complete = self._complete
        lost = 0
        for _ in range(cycles):
            while not complete.empty():
                complete.get()
            try:
                self._network.send_message(SYNC_ID, b"")
            except can.CanError as error:
                raise BusLostError(f"cannot produce SYNC: the bus has failed: {error}") from error
            try:
                waits = complete.empty() and self._threaded and self._stimulator.operational
                complete.get(timeout=LOST_CYCLE_S if waits else 0.0)
                lost = 0
            except Empty:
                lost += 1
            if lost == _LOST_IN_A_ROW:
                raise NotRunningError(
                    f"{lost} cycles in a row were lost: is the plate there, and are all nodes "
                    "operational and started with --lockstep?"
                )

    def _wait_for(self, cycles: int) -> None:
        end = self._clock() + cycles * 1e-3 + LOST_CYCLE_S
        while len(self._rows) < cycles and self._clock() < end:
            with suppress(Empty):
                self._complete.get(timeout=LOST_CYCLE_S)


def _row_maker(
    columns: list[tuple[PublishedPdo, int]],
) -> tuple[list[PublishedPdo], Callable[[list[int]], Row]]:
    """Return the TPDOs of a row, and what picks the row from their values one after another."""
    parts = list(dict.fromkeys(pdo for pdo, _ in columns))
    places = [(pdo, at) for pdo in parts for at in range(len(pdo.names))]
    return parts, itemgetter(*map(places.index, columns)) if columns else tuple


def _drives(name: str, raw: int) -> bool:
    """Tell whether a write leads to a voltage; a quick stop does not: any bench may ask for it."""
    if name == "Controlword":
        return bool(raw & (Control.ARM | Control.FAULT_RESET))
    return name == "Mode" and raw != Mode.OFF
