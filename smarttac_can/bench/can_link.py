"""The link over CAN: SDO by python-canopen, recordings from the stimulator's TPDOs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from difflib import get_close_matches
from operator import itemgetter
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event
from time import monotonic, sleep
from typing import Any, Final

import can

from smarttac_can.bench.errors import NotRunningError
from smarttac_can.bench.link import (
    HELD,
    RECORDED,
    FrameSource,
    Hear,
    Link,
    OneRun,
    PublishedPdo,
    Row,
    Snapshot,
    commanded_pdos,
    never,
    published_pdos,
)
from smarttac_can.bench.named_objects import truth
from smarttac_can.bench.network import TappedNetwork, raw_log
from smarttac_can.bench.remote_device import BenchHeartbeat, RemoteDevice, bench_id, drives
from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.host.drivers import opening, unknown_options
from smarttac_can.host.kernel_filter import hear_only, hold_more
from smarttac_can.master.errors import BenchError, BusLostError
from smarttac_can.master.requests import asked, download, takes, written
from smarttac_can.od.cia import (
    BOOT_UP,
    EMCY_ID,
    EVENT_MANUFACTURER,
    HEARTBEAT_ID,
    PDO_TRANSMISSION,
    SDO_RX_ID,
    SDO_TX_ID,
    SYNC_ID,
    TPDO_COMMUNICATION,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.meanings import SIMULATION
from smarttac_can.vocabulary.states import Mode

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
_TICK: Final = RECORDED.index("Contact.Tick")
Receiver = Callable[[int, bytearray, float], None]
_ANSWERED_S: Final = 0.25
"""By then another bench has answered, if there is one."""
_EVERY_CYCLE: Final = bytes((EVENT_MANUFACTURER,))
_SETTLE_S: Final = 0.1
"""What still comes of the last SYNC has come by then."""
_EVENT_S: Final = 0.25
"""In real time the event timers of the TPDOs, 0.1 s by default, send within it."""
_HEARTBEATS: Final = 3
_CLOSING_S: Final = 0.02
_OWN_ARGUMENTS: Final = ("node_id", "plate_node_id", "lockstep")
_NEAR: Final = 0.7
"""Likeness of a misspelt argument to what was meant, at least; 1 is the same."""


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
        The nodes have been started.
    od : ObjectDictionary
        EDS of the stimulator.

    Raises
    ------
    BenchError
        If the bus cannot be opened, no node answers, or it is another device.
    ValueError
        If `lockstep` is neither True nor False, `interface` no name, or a node-ID outside 1..127.
    TypeError
        If an option is a misspelt argument, or one that the interface would ignore.
    """
    truth("lockstep", lockstep)
    if not isinstance(interface, str | None):
        raise ValueError(f"interface {interface!r} is no name")
    _refuse_misspelt(interface, options)
    where = f"{interface or 'the configured bus'}:{channel or 'default'}"
    if "port" in options:
        where += f" port {options['port']}"
    network = TappedNetwork()
    # How long closing the bus may take; python-canopen waits for up to 1 s.
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
    """Make a link of a connected network, which is closed if that fails."""
    try:
        od = stimulator_od(node_id)
        plate = None if plate_node_id is None else plate_od(plate_node_id)
        link = CanLink(network, od, plate, where=where, lockstep=lockstep, timeout=timeout)
    except BaseException:
        network.disconnect()
        raise
    return link, od


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
        self._threaded = network.threaded
        self._clock = network.now
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
        self._heard: tuple[frozenset[int], ...] = ()
        self._alone = OneRun()
        self._time_is_right = not lockstep
        self._services = {
            service + device.od.node_id
            for service in (EMCY_ID, SDO_TX_ID, SDO_RX_ID, HEARTBEAT_ID)
            for device in self._devices
        }
        self._listen()

    def drive(self) -> None:
        """Start the heartbeat of this bench, in real time; refused while another one drives."""
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
        """Write a raw value to an object over SDO; one that drives starts the bench heartbeat."""
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
        """Return what the PDOs of the stimulator carry, by its mapping."""
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
        """Pass on the frames of these nodes, and those that command them."""
        network = self._network
        commanded = commanded_pdos(self._stimulator.od, self._stimulator.read)
        can_ids = {pdo.can_id for pdo in (*self._pdos, *commanded)} | self._services
        tap = (can_ids, hear)
        if self._threaded:
            hold_more(network.bus)
        types = self._every_cycle.held() if every_cycle else nullcontext()
        # Before all types are set there is no whole cycle, and after the first is put back none.
        with self._hearing(can_ids), types:
            network.taps += (tap,)
            try:
                yield
            finally:
                network.taps = tuple(other for other in network.taps if other is not tap)

    def raw(self, path: Path) -> AbstractContextManager[str]:
        """Log all frames on the bus, those of this bench too, in a format of python-can."""
        return raw_log(self._network, path)

    def silent(self) -> list[int]:
        """Return the node-IDs whose heartbeats came and have stopped; in lockstep none."""
        # In lockstep the nodes' time, and so their heartbeat, stands still between the cycles.
        return [d.od.node_id for d in self._devices if not self._lockstep and d.silence]

    def wrong_time(self) -> str:
        """Return what is wrong if the stimulator keeps another time than the link; else nothing."""
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
        """Add frames to those that the kernel lets pass, while a block lasts."""
        heard = frozenset(can_ids)
        self._heard += (heard,)
        self._listen()
        try:
            yield
        finally:
            # Blocks of several threads end in any order.
            self._heard = tuple(other for other in self._heard if other is not heard)
            self._listen()

    def _listen(self) -> None:
        """Set the filter of the kernel to the frames that are listened to here."""
        if self._threaded:
            heartbeat = HEARTBEAT_ID + bench_id(self._stimulator.od.node_id)
            hear_only(
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
        has answered a request sent after the SYNC, all that the cycle may still bring has come. How
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


class CycleRows:
    """Rows of `RECORDED` from the TPDOs of a stimulator.

    Parameters
    ----------
    device
        The stimulator.
    pdos
        Its public TPDOs by number.
    clock
        Returns the time in s.

    Attributes
    ----------
    rows
        Where the rows go; None for nowhere.
    complete
        Has something whenever a cycle is complete, with a row or without.
    whole
        Whether the TPDOs map all of `RECORDED`.
    wanted
        Numbers of the TPDOs that make a row; the others hold what changes seldom.
    """

    def __init__(
        self, device: RemoteDevice, pdos: list[PublishedPdo], clock: Callable[[], float]
    ) -> None:
        self._device = device
        self._clock = clock
        self.rows: list[Row] | None = None
        # At a tenth of what an event takes.
        self.complete: SimpleQueue[None] = SimpleQueue()
        self._come: set[int] = set()
        columns = [_place(pdos, name) for name in RECORDED]
        self._columns = [column for column in columns if column is not None]
        self.whole = len(self._columns) == len(RECORDED)
        self.wanted = {
            column[0].number
            for column, name in zip(columns, RECORDED, strict=True)
            if self.whole and column is not None and name not in HELD
        }

    def learn_held(self, read: Callable[[str], int]) -> None:
        """Read what is published when it changes, and did not come yet."""
        for pdo, _ in self._columns:
            if pdo.number not in self.wanted and pdo.received is None:
                pdo.values = tuple(read(name) for name in pdo.names)

    def receiver(self, pdo: PublishedPdo) -> Receiver:
        """Make the callback of a TPDO; that of the cycle's last one completes a row."""
        wanted, number = self.wanted, pdo.number
        parts, row_of = self._row_maker()
        completes = number == max(wanted, default=0)
        come, complete = self._come, self.complete
        clock, device = self._clock, self._device
        operational = NMTState.OPERATIONAL

        def on_pdo(_can_id: int, data: bytearray, _timestamp: float) -> None:
            if not pdo.take(data, clock()):
                return
            # PDOs are OPERATIONAL's alone; the next heartbeat may be a second away.
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
        """Return the TPDOs of a row, and what picks it from their values one after another."""
        columns = self._columns if self.whole else []
        parts = list(dict.fromkeys(pdo for pdo, _ in columns))
        places = [(pdo, at) for pdo in parts for at in range(len(pdo.names))]
        return parts, itemgetter(*map(places.index, columns)) if columns else tuple


def _record(rows: list[Row], row: Row) -> None:
    # When a cycle comes late, the event timers of the TPDOs repeat the one before.
    if not rows or row[_TICK] != rows[-1][_TICK]:
        rows.append(row)


def _place(pdos: list[PublishedPdo], name: str) -> tuple[PublishedPdo, int] | None:
    """Find the TPDO that carries an object, and its place there."""
    found = ((pdo, pdo.names.index(name)) for pdo in pdos if name in pdo.names)
    return next(found, None)


class EveryCycle:
    """Sets TPDOs to every cycle, and puts their types back when no bench needs it any more.

    Several benches may need it at once, and only the last of them may put the types back: until
    another one asks anew, the cycles are lost. A bench that ends asks whether another one needs
    them. The question is the SDO request that reads a type, the answer one that writes 254 to it
    again.

    Parameters
    ----------
    network
        Network of the stimulator.
    device
        The stimulator.
    numbers
        Numbers of the TPDOs.

    Attributes
    ----------
    numbers
        The same.
    """

    def __init__(self, network: TappedNetwork, device: RemoteDevice, numbers: list[int]) -> None:
        self._network = network
        self._device = device
        self.numbers = numbers
        self._types = [
            device.od.entry(TPDO_COMMUNICATION + number - 1, PDO_TRANSMISSION) for number in numbers
        ]
        self._at = {(entry.index, entry.subindex): entry for entry in self._types}
        self._undone: set[Entry] = set()
        services = (HEARTBEAT_ID, SDO_RX_ID, SDO_TX_ID)
        self._tap = ({service + device.od.node_id for service in services}, self._keep)
        self._before: list[int] = []
        self._users = 0
        self._ends = False
        self._others = Event()

    @contextmanager
    def held(self) -> Iterator[None]:
        """Send them in every cycle while a block lasts; blocks may be nested.

        They are sent so again at once when a reset, or a tool that does not ask, puts them back.
        """
        if not self._users:
            self._ends = False
            self._others.clear()
            self._before = [self._take(entry) for entry in self._types]
            self._undone.clear()
            self._network.taps += (self._tap,)
        self._users += 1
        try:
            yield
        except BaseException:
            # The first failure is the one to report.
            with suppress(BenchError):
                self._release()
            raise
        self._release()

    def _take(self, entry: Entry) -> int:
        kind = int(self._device.read(entry))
        self._device.write(entry, EVENT_MANUFACTURER)
        if kind != EVENT_MANUFACTURER:
            return kind
        # Another bench needs it, or one that was killed has left it so.
        self._others.set()
        return int(entry.default)

    def _release(self) -> None:
        self._users -= 1
        if self._users:
            return
        try:
            needed = self._others_need_it()
        finally:
            network = self._network
            network.taps = tuple(tap for tap in network.taps if tap is not self._tap)
        if not needed:
            for entry, kind in zip(self._types, self._before, strict=True):
                self._device.write(entry, kind)

    def _others_need_it(self) -> bool:
        """Ask the benches that there may be besides this one."""
        self._ends = True
        if not self._others.is_set():
            return False
        self._others.clear()
        self._device.read(self._types[0])
        return self._others.wait(_ANSWERED_S)

    def _keep(self, can_id: int, data: bytes) -> None:
        """Answer other benches that ask, and set again what others have put back."""
        node_id, undone = self._device.od.node_id, self._undone
        frame = Frame(can_id, data)
        if can_id == HEARTBEAT_ID + node_id and data == BOOT_UP:
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
            ended = [entry for entry in undone if takes(frame, node_id, entry)]
            undone.difference_update(ended)
            self._ask_for(ended)

    def _ask_for(self, entries: Iterable[Entry]) -> None:
        """Write the types without waiting for an answer, as this runs in the receiving thread."""
        if self._ends:
            return
        for entry in entries:
            frame = download(self._device.od.node_id, entry, EVENT_MANUFACTURER)
            # Of a bus that has failed the bench hears by its next transfer.
            with suppress(can.CanError):
                self._network.send_message(frame.can_id, frame.data)
