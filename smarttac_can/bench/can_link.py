"""The link over CAN: SDO through python-canopen, recordings from the stimulator's TPDOs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from difflib import get_close_matches
from operator import itemgetter
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event
from time import monotonic, sleep
from typing import Any, Final

import can

from smarttac_can.bench.errors import NotRunningError
from smarttac_can.bench.given import integer, said, truth, within
from smarttac_can.bench.link import (
    ON_CHANGE,
    RECORDED,
    FrameSource,
    Hear,
    Link,
    OneRun,
    PublishedPdo,
    Row,
    Snapshot,
    Turns,
    commanded_pdos,
    never,
    published_pdos,
)
from smarttac_can.bench.network import TappedNetwork, raw_log
from smarttac_can.bench.remote_device import BenchHeartbeat, RemoteDevice, bench_id, drives
from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.master.errors import BenchError, BusLostError
from smarttac_can.canopen.master.requests import asked, download, downloaded, written
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.host.drivers import opening, unknown_options
from smarttac_can.host.kernel_filter import enlarge_buffer, receive_only
from smarttac_can.vocabulary.meanings import SIMULATION

GRACE_S: Final = 1.0
"""Time in s that a run in real time may take beyond its cycles."""
_CHECK_S: Final = 1.0
"""Time in s without a cycle in real time after which the heartbeats are checked."""
SILENT_S: Final = 5.0
"""Time in s without any answer after which a node in lockstep is regarded as dead."""
_ASK_AFTER_S: Final = 0.1
"""Time in s after which, in lockstep, an incomplete cycle is checked by requests to the nodes."""
_ANSWER_S: Final = 1.0
_STATUS_TPDO: Final = 1
_LOST_IN_A_ROW: Final = 3
_POLL_S: Final = 0.005
_TICK: Final = RECORDED.index("Contact.Tick")
Receiver = Callable[[int, bytearray, float], None]
_ANSWERED_S: Final = 0.25
"""Time in s in which another bench, if there is one, has answered."""
_EVERY_CYCLE: Final = bytes((cia.EVENT_MANUFACTURER,))
_SETTLE_S: Final = 0.1
"""Time in s in which all frames after the last SYNC have arrived."""
_EVENT_S: Final = 0.25
"""Time in s in which, in real time, the event timers of the TPDOs (0.1 s by default) send."""
_HEARTBEATS: Final = 3
_CLOSING_S: Final = 0.02
_MOST_WAIT_S: Final = 3600.0
_OWN_ARGUMENTS: Final = ("node_id", "plate_node_id", "lockstep")
_NEAR: Final = 0.7
"""Least similarity of a misspelt argument to a known one; 1 means equal."""


def open_can_link(
    *,
    interface: str | None,
    channel: str | None,
    node_id: int,
    plate_node_id: int | None,
    lockstep: bool,
    timeout: float | None,
    options: Mapping[str, Any],
) -> tuple[Link, ObjectDictionary]:
    """Open a link over a CAN bus; the arguments are those of `Stimulator.connect`.

    Returns
    -------
    link : Link
        Link to nodes that have been started.
    od : ObjectDictionary
        Object dictionary from the EDS of the stimulator.

    Raises
    ------
    BenchError
        If the bus cannot be opened, no node answers, or the node is another device.
    ValueError
        If `lockstep` is neither True nor False, `interface` is not a name, or a node-ID is outside
        1..127.
    TypeError
        If an option is a misspelt argument, or one that the interface would ignore.
    """
    truth("lockstep", lockstep)
    if not isinstance(interface, str | None):
        raise ValueError(f"interface {said(interface)} is no name")
    node_id = integer("node_id", node_id, 1, cia.LAST_NODE_ID)
    if plate_node_id is not None:
        plate_node_id = integer("plate_node_id", plate_node_id, 1, cia.LAST_NODE_ID)
    if timeout is not None:
        timeout = within("timeout", timeout, 0, _MOST_WAIT_S, "s")
    _refuse_misspelt(interface, options)
    where = f"{interface or 'the configured bus'}:{channel or 'default'}"
    if "port" in options:
        where += f" port {options['port']}"
    network = TappedNetwork()
    # Longest time for closing the bus; the default of python-canopen is 1 s.
    network.NOTIFIER_CYCLE = _CLOSING_S
    with opening(interface, channel, BenchError):
        network.connect(interface=interface, channel=channel, **options)
    return over_can(
        network, node_id, plate_node_id, where=where, lockstep=lockstep, timeout=timeout
    )


def _refuse_misspelt(interface: str | None, options: Iterable[str]) -> None:
    for option in options:
        if near := get_close_matches(option, _OWN_ARGUMENTS, 1, _NEAR):
            raise TypeError(f"connect has no argument {option!r}, perhaps {near[0]!r}")
    for text in unknown_options(interface, [name for name in options if name != "bitrate"]):
        raise TypeError(text)


def over_can(
    network: TappedNetwork,
    node_id: int,
    plate_node_id: int | None,
    *,
    where: str,
    lockstep: bool,
    timeout: float | None,
) -> tuple[Link, ObjectDictionary]:
    """Make a link from a connected network, and close the network if that fails."""
    try:
        od = stimulator_od(node_id)
        plate = None if plate_node_id is None else plate_od(plate_node_id)
        link = CanLink(network, od, plate, where=where, lockstep=lockstep, timeout=timeout)
    except BaseException:
        network.disconnect()
        raise
    return link, od


class CanLink:
    """A stimulator on a CAN bus, with the plate inside or as a separate node.

    Parameters
    ----------
    network
        Connected network of python-canopen; closed with the link.
    stimulator
        Object dictionary of the stimulator, loaded for its node-ID.
    plate
        Object dictionary of the plate node, loaded for its node-ID; None if the plate is inside the
        stimulator.
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
        # On a local bus everything happens within the call that sends. There is no other thread to
        # wait for, and the bus defines the time.
        self._threaded = network.threaded
        self._clock = network.now
        self.turn = Turns()
        self._stimulator = RemoteDevice(network, stimulator, where, timeout, self.turn)
        self._plate = RemoteDevice(network, plate, where, timeout, self.turn) if plate else None
        # Start the plate first, so that the stimulator does not miss its measurements.
        self._devices = [d for d in (self._plate, self._stimulator) if d is not None]
        self._pdos = published_pdos(stimulator, self._stimulator.read)
        self._cycles = CycleRows(self._stimulator, self._pdos, self._clock)
        wanted = {pdo.number for pdo in self._pdos} - {_STATUS_TPDO} | self._cycles.wanted
        self._every_cycle = EveryCycle(network, self._stimulator, sorted(wanted), self.turn)
        for pdo in self._pdos:
            network.subscribe(pdo.can_id, self._cycles.receiver(pdo))
        for device in self._devices:
            device.start()
        # In lockstep the time of the nodes stands still without the bench.
        self._heartbeat = None if lockstep else BenchHeartbeat(network, self._stimulator)
        self._heard: tuple[frozenset[int], ...] = ()
        self._alone = OneRun(where)
        self._time_is_right = not lockstep
        self._services = {
            service + device.od.node_id
            for service in (cia.EMCY_ID, cia.SDO_TX_ID, cia.SDO_RX_ID, cia.HEARTBEAT_ID)
            for device in self._devices
        }
        self._listen()

    def drive(self) -> None:
        """Start the heartbeat of this bench in real time; refused while another bench drives."""
        with self.turn:
            if self._heartbeat is not None:
                self._heartbeat.begin()

    def read(self, name: str) -> Any:
        """Read an object over SDO."""
        device = self._owner(name)
        return device.read(device.od[name])

    def write(self, name: str, raw: int | bytes) -> None:
        """Write an object over SDO; a write that commands starts the heartbeat of this bench."""
        with self.turn:
            if self.only_read and not isinstance(raw, bytes) and drives(name, raw):
                self.drive()
            device = self._owner(name)
            device.write(device.od[name], raw)

    def snapshot(self) -> Snapshot:
        """Return the last values of the public TPDOs; in real time wait for the first of each."""
        self._check()
        if not self._lockstep:
            self._stimulator.check_operational()
            self._await_first()
        values: dict[str, int] = {}
        with self.turn:
            oldest = now = self._clock()
            for pdo in self._pdos:
                if pdo.received is not None:
                    values.update(zip(pdo.names, pdo.values, strict=True))
                    oldest = min(oldest, pdo.received)
        return Snapshot(values, now - oldest)

    def start_run(self) -> None:
        """Restart the simulation: the plate at rest at tick 0, the controllers reset."""
        with self.turn:
            if self._plate is not None:
                self._plate.write(self._plate.od["Simulation.Start run"], 1)
            self._stimulator.write(self._stimulator.od["Simulation.Start run"], 1)

    def run(self, cycles: int, rows: list[Row], interrupted: Callable[[], bool] = never) -> None:
        """Run the loop and record it from the TPDOs, which are sent in every cycle meanwhile.

        Raises
        ------
        NotRunningError
            If not a single cycle came, the TPDOs do not map all recorded objects, or in lockstep
            the node runs in real time.
        HeartbeatLostError
            If the heartbeat of a node is lost.
        BusyError
            If another thread is running the loop.
        BenchError
            If the link is closed meanwhile.
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
        collected.read_on_change(self.read)
        # In lockstep the nodes send nothing before the first SYNC.
        if not self._time_is_right and (wrong_time := self.wrong_time()):
            raise NotRunningError(wrong_time)
        self._time_is_right = True
        # The bench must receive the SDO frames of another script that resets the types.
        with self._hearing(self._services), self._every_cycle.enabled():
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

    def require_idle(self) -> None:
        """Raise BusyError if another thread is running the loop."""
        with self._alone:
            pass

    def source(self) -> FrameSource:
        """Return what the PDOs of the stimulator carry, from its mapping."""
        device = self._stimulator
        return FrameSource(
            published=self._pdos,
            every_cycle=self._every_cycle.numbers,
            commanded=commanded_pdos(device.od, device.read),
            plate=None if self._plate is None else self._plate.od,
            clocked=not self._lockstep,
        )

    @contextmanager
    def frames(self, hear: Hear, *, every_cycle: bool = True) -> Iterator[None]:
        """Pass the frames of these nodes, and those of their masters, to `hear` during a block."""
        network = self._network
        commanded = commanded_pdos(self._stimulator.od, self._stimulator.read)
        can_ids = {pdo.can_id for pdo in (*self._pdos, *commanded)} | self._services
        if self._threaded:
            enlarge_buffer(network.bus)
        types = self._every_cycle.enabled() if every_cycle else nullcontext()
        # Before all types are set, and after the first one is reset, no cycle is complete.
        with self._hearing(can_ids), types, network.tapped(can_ids, hear):
            yield
            if self._threaded:
                # Frames may wait to be heard; the answer comes after all of them. Of a stimulator
                # that has gone there is none, and what was heard is kept.
                with suppress(BenchError):
                    self.read("Statusword")

    def raw(self, path: Path) -> AbstractContextManager[str]:
        """Log all frames on the bus, also those of this bench, in a format of python-can."""
        return raw_log(self._network, path)

    def silent(self) -> list[int]:
        """Return the node-IDs whose heartbeats were lost; an empty list in lockstep."""
        # In lockstep the time of the nodes, and so their heartbeat, stands still between the
        # cycles.
        self._alone.require_open()
        return [d.od.node_id for d in self._devices if not self._lockstep and d.silence]

    def wrong_time(self) -> str:
        """Return an error text if stimulator and link differ in lockstep or real time, else ""."""
        if not self._threaded:
            return ""
        device = self._stimulator
        node = f"node {device.od.node_id}"
        if self._lockstep:
            sleep(_SETTLE_S)
            if self._speaks(_EVENT_S):
                return (
                    f"{node} runs in real time: connect without lockstep=True, or start all nodes "
                    "with --lockstep"
                )
        elif device.heartbeat_s and not self._speaks(_HEARTBEATS * device.heartbeat_s):
            return (
                f"the time of {node} stands still without SYNC: connect with lockstep=True, or "
                "start all nodes without --lockstep"
            )
        return ""

    def _speaks(self, seconds: float) -> bool:
        """Return whether a heartbeat or TPDO comes within a time in s, without SYNC."""
        begun = monotonic()
        while monotonic() - begun < seconds:
            heard = [self._stimulator.heartbeat_at, *(pdo.received for pdo in self._pdos)]
            if any(at is not None and at > begun for at in heard):
                return True
            sleep(_POLL_S)
        return False

    @property
    def only_read(self) -> bool:
        """Whether another bench may be the commander, and this one is not; False in lockstep."""
        return self._heartbeat is not None and not self._heartbeat.begun

    def close(self) -> None:
        """Leave the bus; may be called twice."""
        self._alone.close()
        with self.turn:
            presence, self._heartbeat = self._heartbeat, None
        if presence is not None and presence.begun:
            with suppress(BenchError):
                presence.end()
        # After closing, python-canopen raises the error that ended its receiving.
        with suppress(can.CanError):
            self._network.disconnect()

    def _await_first(self) -> None:
        end = self._clock() + self._timeout
        while any(pdo.received is None for pdo in self._pdos) and self._clock() < end:
            sleep(_POLL_S)
        none = all(pdo.received is None for pdo in self._pdos)
        if none and (wrong_time := self.wrong_time()):
            raise NotRunningError(wrong_time)

    def _owner(self, name: str) -> RemoteDevice:
        simulated = name.partition(".")[0] in SIMULATION
        return self._plate if simulated and self._plate is not None else self._stimulator

    def _check(self) -> None:
        # In lockstep the time of the nodes, and so their heartbeat, stands still between the
        # cycles.
        if not self._lockstep:
            for device in (self._stimulator, self._plate):
                if device is not None:
                    device.check_heartbeat()

    @contextmanager
    def _hearing(self, can_ids: Iterable[int]) -> Iterator[None]:
        """Let the kernel pass additional frames during a block."""
        heard = frozenset(can_ids)
        with self.turn:
            self._heard += (heard,)
            self._listen()
        try:
            yield
        finally:
            # Blocks of several threads end in any order.
            with self.turn:
                self._heard = tuple(other for other in self._heard if other is not heard)
                self._listen()

    def _listen(self) -> None:
        """Set the filter of the kernel to the frames that are needed here."""
        if self._threaded:
            heartbeat = cia.HEARTBEAT_ID + bench_id(self._stimulator.od.node_id)
            receive_only(
                self._network.bus, {*self._network.subscribers, heartbeat}.union(*self._heard)
            )

    def _produce_sync(self, cycles: int, interrupted: Callable[[], bool]) -> None:
        complete = self._cycles.complete
        lost = 0
        for _ in range(cycles):
            while not complete.empty():
                complete.get()
            if interrupted():
                return
            self._alone.require_open()
            with self.turn:
                try:
                    self._network.send_message(cia.SYNC_ID, b"")
                except can.CanError as error:
                    text = f"cannot produce SYNC: the bus has failed: {error}"
                    raise BusLostError(text) from error
                lost = 0 if self._ends(interrupted) else lost + 1
            if lost == _LOST_IN_A_ROW:
                raise NotRunningError(
                    f"{lost} cycles in a row were lost: is the plate there, and are all nodes "
                    "operational and started with --lockstep?"
                )

    def _ends(self, interrupted: Callable[[], bool]) -> bool:
        """Wait for the end of a cycle in lockstep; return whether the cycle is complete.

        Nodes receive frames in the order in which they were sent. So each node, the plate first, is
        sent a request after the SYNC. Once all have answered, all frames of the cycle have arrived.
        The nodes may take any time for it.
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
            self._alone.require_open()
            try:
                self._cycles.complete.get(timeout=min(left, _CHECK_S))
            except Empty:
                self._check()


class CycleRows:
    """Makes rows of `RECORDED` from the TPDOs of a stimulator.

    Parameters
    ----------
    device
        Stimulator node.
    pdos
        Public TPDOs of the stimulator by number.
    clock
        Function that returns the time in s.

    Attributes
    ----------
    rows
        List to which rows are appended; None if they are discarded.
    complete
        Queue with an element after each complete cycle, with or without a row.
    whole
        Whether the TPDOs map all of `RECORDED`.
    wanted
        Numbers of the TPDOs of every row; the other ones are sent only on a change.
    """

    def __init__(
        self, device: RemoteDevice, pdos: list[PublishedPdo], clock: Callable[[], float]
    ) -> None:
        self._device = device
        self._clock = clock
        self.rows: list[Row] | None = None
        # A queue costs a tenth of an event.
        self.complete: SimpleQueue[None] = SimpleQueue()
        self._come: set[int] = set()
        columns = [_place(pdos, name) for name in RECORDED]
        self._columns = [column for column in columns if column is not None]
        self.whole = len(self._columns) == len(RECORDED)
        self.wanted = {
            column[0].number
            for column, name in zip(columns, RECORDED, strict=True)
            if self.whole and column is not None and name not in ON_CHANGE
        }

    def read_on_change(self, read: Callable[[str], int]) -> None:
        """Read the objects that are published on a change and were not received yet."""
        for pdo, _ in self._columns:
            if pdo.number not in self.wanted and pdo.received is None:
                pdo.values = tuple(read(name) for name in pdo.names)

    def receiver(self, pdo: PublishedPdo) -> Receiver:
        """Return the callback of a TPDO; that of the last TPDO of a cycle completes a row."""
        wanted, number = self.wanted, pdo.number
        parts, row_of = self._row_maker()
        completes = number == max(wanted, default=0)
        come, complete = self._come, self.complete
        clock, device = self._clock, self._device
        operational = NMTState.OPERATIONAL

        def on_pdo(_can_id: int, data: bytearray, _timestamp: float) -> None:
            if not pdo.take(data, clock()):
                return
            # Only OPERATIONAL nodes send PDOs; the next heartbeat may be 1 s away.
            device.state = operational
            come.add(number)
            if completes:
                # A row with a lost frame would mix two cycles.
                if come >= wanted and self.rows is not None:
                    values: list[int] = []
                    for part in parts:
                        values += part.values
                    _record(self.rows, row_of(values))
                come.clear()
                if complete.empty():
                    complete.put(None)

        return on_pdo

    def _row_maker(self) -> tuple[list[PublishedPdo], Callable[[list[int]], Row]]:
        """Return the TPDOs of a row, and a function that picks the row from their joined values."""
        columns = self._columns if self.whole else []
        parts = list(dict.fromkeys(pdo for pdo, _ in columns))
        places = [(pdo, at) for pdo in parts for at in range(len(pdo.names))]
        return parts, itemgetter(*map(places.index, columns)) if columns else tuple


def _record(rows: list[Row], row: Row) -> None:
    # When a cycle is late, the event timers of the TPDOs send the last values again.
    if not rows or row[_TICK] != rows[-1][_TICK]:
        rows.append(row)


def _place(pdos: list[PublishedPdo], name: str) -> tuple[PublishedPdo, int] | None:
    """Return the TPDO that carries an object and the index there, None if there is none."""
    found = ((pdo, pdo.names.index(name)) for pdo in pdos if name in pdo.names)
    return next(found, None)


class EveryCycle:
    """Sets TPDOs to every cycle, and resets their types when no bench needs it any more.

    Several benches may need it at once, and only the last of them may reset the types; otherwise
    the others lose cycles until they have set the types again. So a bench that ends asks whether
    another one needs the cycles. The question is the SDO request that reads a type; the answer is
    one that writes 254 to it again.

    Parameters
    ----------
    network
        Network of the stimulator.
    device
        Stimulator node.
    numbers
        Numbers of the TPDOs.
    turn
        Entered while the types are set or reset.

    Attributes
    ----------
    numbers
        Numbers of the TPDOs.
    """

    def __init__(
        self, network: TappedNetwork, device: RemoteDevice, numbers: list[int], turn: Turns
    ) -> None:
        self._network = network
        self._turn = turn
        self._device = device
        self.numbers = numbers
        self._types = [
            device.od.entry(cia.TPDO_COMMUNICATION + number - 1, cia.PDO_TRANSMISSION)
            for number in numbers
        ]
        self._at = {(entry.index, entry.subindex): entry for entry in self._types}
        self._undone: set[Entry] = set()
        services = (cia.HEARTBEAT_ID, cia.SDO_RX_ID, cia.SDO_TX_ID)
        self._services = {service + device.od.node_id for service in services}
        self._tapped = ExitStack()
        self._before: list[int] = []
        self._users = 0
        self._ends = False
        self._others = Event()

    @contextmanager
    def enabled(self) -> Iterator[None]:
        """Set the TPDOs to every cycle during a block; blocks may be nested.

        If a reset, or a tool that does not ask, changes the types, they are set again at once.
        """
        with self._turn:
            if not self._users:
                self._begin()
            self._users += 1
        try:
            yield
        except BaseException:
            # Report the first failure, not the one that follows from it.
            with suppress(BenchError):
                self._release()
            raise
        self._release()

    def _begin(self) -> None:
        self._ends = False
        self._others.clear()
        self._before = [self._take(entry) for entry in self._types]
        self._undone.clear()
        self._tapped.enter_context(self._network.tapped(self._services, self._keep))

    def _take(self, entry: Entry) -> int:
        kind = int(self._device.read(entry))
        self._device.write(entry, cia.EVENT_MANUFACTURER)
        if kind != cia.EVENT_MANUFACTURER:
            return kind
        # Another bench needs it, or a killed bench has left it so.
        self._others.set()
        return int(entry.default)

    def _release(self) -> None:
        with self._turn:
            self._users -= 1
            if self._users:
                return
            try:
                needed = self._others_need_it()
            finally:
                self._tapped.close()
            if not needed:
                for entry, kind in zip(self._types, self._before, strict=True):
                    self._device.write(entry, kind)

    def _others_need_it(self) -> bool:
        self._ends = True
        if not self._others.is_set():
            return False
        self._others.clear()
        self._device.read(self._types[0])
        return self._others.wait(_ANSWERED_S)

    def _keep(self, can_id: int, data: bytes) -> None:
        """Answer other benches that ask, and set again the types that others have changed."""
        node_id, undone = self._device.od.node_id, self._undone
        frame = Frame(can_id, data)
        if can_id == cia.HEARTBEAT_ID + node_id and data == cia.BOOT_UP:
            self._ask_for(self._types)
        elif request := written(frame, node_id):
            entry = self._at.get(request.address)
            if entry is not None and request.data == _EVERY_CYCLE:
                self._others.set()
            elif entry is not None:
                undone.add(entry)
        elif entry := self._at.get(asked(frame, node_id) or (0, 0)):
            self._ask_for([entry])
        elif undone:
            ended = [entry for entry in undone if frame == downloaded(node_id, entry)]
            undone.difference_update(ended)
            self._ask_for(ended)

    def _ask_for(self, entries: Iterable[Entry]) -> None:
        """Write the types without waiting for an answer, as the receiving thread runs this."""
        if self._ends:
            return
        for entry in entries:
            frame = download(self._device.od.node_id, entry, cia.EVENT_MANUFACTURER)
            # The next transfer of the bench reports a failed bus.
            with suppress(can.CanError):
                self._network.send_message(frame.can_id, frame.data)
