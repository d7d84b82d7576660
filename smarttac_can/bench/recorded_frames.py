"""Decode the frames of a recording piece by piece to rows, gaps and events; no clock, no file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import Enum, auto
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.traces import Integers
from smarttac_can.device.frame import Frame
from smarttac_can.host.frame_log import FRAME, MARK, MARK_END, RECORD, Records
from smarttac_can.master.requests import Downloads, Written
from smarttac_can.od.cia import BOOT_UP, EMCY_ID, HEARTBEAT_ID, MANUFACTURER_FIRST
from smarttac_can.od.data_types import unpack
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.eds import load_eds
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.meanings import START_RUN
from smarttac_can.vocabulary.textures import TABLE_NAMES
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

_MOST_WAITING: Final = 1 << 18
"""Most records that wait for the end of their cycle, which may never come."""
_WRAP: Final = 1 << 16
_FEW: Final = 100
"""After a reported restart the run goes on if the tick has advanced by 1 to this number."""
_AHEAD_MS: Final = 1000
"""Most ms that ticks may be ahead of the clock if they follow it."""
_AMBIGUOUS_MS: Final = 60_000
"""Silence in ms after which the clock counts the overflows of the 16-bit tick, one per 65.5 s."""
Flags = npt.NDArray[np.bool_]
TICK: Final = "Contact.Tick"
Places = npt.NDArray[np.intp]
_EMCY_BYTES: Final = 8
_MOST_MARKER_BYTES: Final = 4000
"""Bytes of a text of 1000 characters; a damaged log may hold a longer one."""


class Dated(NamedTuple):
    """An event, with run and tick of the row before it."""

    event: Event
    run: int
    tick: int
    """-1 before the first row."""


class RecordedFrames:
    """Decodes the records of a log to rows and events.

    Parameters
    ----------
    head
        Head of the log.

    Attributes
    ----------
    ods
        Object dictionary of each node by node-ID.
    tpdos
        TPDOs that the stimulator published.
    events
        Events decoded so far, in order, without restarts.

    Raises
    ------
    KeyError, ValueError, TypeError, AttributeError, OverflowError
        If the head is not that of a recording.
    """

    def __init__(self, head: Mapping[str, Any]) -> None:
        self.ods = {int(n["node_id"]): load_eds(n["eds"], int(n["node_id"])) for n in head["nodes"]}
        node_id = int(head["node_id"])
        own = self.ods[node_id]
        self.tpdos = [RecordedPdo(own, pdo) for pdo in head["published"]]
        commanded = [RecordedPdo(own, pdo) for pdo in head["commanded"]]
        known = head["settings"]
        self._rows = RowReader(self.tpdos, head["held"], bool(head["clocked"]))
        self._events = EventReader(self.ods, node_id, self.tpdos, commanded, known)
        self._rest = np.empty(0, RECORD)
        self._last = (0, -1)
        self.events: list[Dated] = []

    @property
    def gaps(self) -> list[Gap]:
        """Ticks missing between the rows so far."""
        return self._rows.gaps

    @property
    def channels(self) -> dict[str, bool]:
        """Objects of the channels by name, and whether each is sent in every cycle."""
        return {
            entry.name: pdo.every_cycle
            for pdo in self.tpdos
            for entry in pdo.entries
            if entry.name != TICK
        }

    def take(self, records: Records, last: bool = False) -> Rows:
        """Decode the next records, and return the rows that they complete.

        Parameters
        ----------
        records
            Records in order.
        last
            Whether these are the last records: then also decode events after the last row.
        """
        records = np.concatenate((self._rest, records))
        ends = self._rows.ends(records)
        used = int(ends[-1]) + 1 if len(ends) else 0
        if last or len(records) - used > _MOST_WAITING:
            used = len(records)
        records, self._rest = records[:used], records[used:]
        events = self._events.take(records)
        restarts = np.array([e.at for e in events if e.kind is Kind.RESTART], np.intp)
        rows = self._rows.take(records, restarts, last)
        self._date([event for event in events if event.kind is not Kind.RESTART], rows)
        return rows

    def _date(self, events: list[Event], rows: Rows) -> None:
        for event in events:
            before = int(np.searchsorted(rows.at, event.at)) - 1
            run, tick = self._last if before < 0 else (rows.run[before], rows.tick[before])
            self.events.append(Dated(event, int(run), int(tick)))
        if len(rows.tick):
            self._last = int(rows.run[-1]), int(rows.tick[-1])


class Counted(NamedTuple):
    """Ticks of rows, as arrays of equal length."""

    run: Integers
    """Number of the run of ticks, from 0."""
    tick: Integers
    """Tick in ms; increases within a run."""
    origin: Integers
    """Tick with which the run began."""
    follows: Flags
    """Whether no tick is missing before the row."""
    new: Flags
    """Whether the tick differs from that of the row before."""


class TickCount:
    """Counts the ticks of rows that arrive piece by piece.

    Parameters
    ----------
    clocked
        Whether ticks follow the clock.
    """

    def __init__(self, clocked: bool) -> None:
        self._clocked = clocked
        # Last row: tick on the bus, time in ns, run, tick, and the first tick of the run.
        self._last = (0, 0, -1, -1, -1)

    def count(self, wire: Integers, time_ns: Integers, restarted: Flags) -> Counted:
        """Count the ticks of the next rows.

        Parameters
        ----------
        wire
            Ticks of the rows, modulo 2^16.
        time_ns
            Times in ns when they were received.
        restarted
            Whether a node, or the simulation, has reported a restart before each row.
        """
        delta, anew = self._steps(wire, time_ns, restarted)
        steps = np.cumsum(np.where(anew, 0, delta))
        begun = np.maximum.accumulate(np.where(anew, np.arange(len(anew)), -1))
        # Until the first restart the run of the last piece goes on.
        _, _, run, tick, origin = self._last
        ticks = np.where(begun < 0, tick + steps, wire[begun] + steps - steps[begun])
        counted = Counted(
            run=run + np.cumsum(anew),
            tick=ticks,
            origin=np.where(begun < 0, origin, wire[begun]),
            follows=anew | (delta <= 1),
            new=anew | (delta > 0),
        )
        if len(wire):
            last = (wire, time_ns, counted.run, counted.tick, counted.origin)
            self._last = tuple(int(column[-1]) for column in last)  # type: ignore[assignment]
        return counted

    def _steps(self, wire: Integers, time_ns: Integers, restarted: Flags) -> tuple[Integers, Flags]:
        """Return the ticks from each row's predecessor to it, and whether a run begins with it."""
        delta = np.diff(wire, prepend=self._last[0]) % _WRAP
        elapsed = np.diff(time_ns, prepend=self._last[1]) // 1_000_000
        back = delta > _WRAP // 2
        if self._clocked:
            rounds = np.rint((elapsed - delta) / _WRAP).astype(np.int64)
            delta += _WRAP * np.where(elapsed > _AMBIGUOUS_MS, rounds.clip(0), 0)
            back &= delta - elapsed > _AHEAD_MS
        anew = back | restarted & ((delta == 0) | (delta > _FEW))
        if len(anew) and self._last[2] < 0:
            anew[0] = True
        return delta, anew


class Gap(NamedTuple):
    """Ticks of a run that were not recorded."""

    run: int
    first: int
    last: int
    time_ns: int
    """Time when the row after the gap was received."""


class Rows(NamedTuple):
    """Rows of a piece of a recording; all arrays have the same length."""

    at: Places
    """Index of the last frame of each row among the records."""
    time_ns: Integers
    run: Integers
    """Number of the run of ticks, from 0; a restart of node or simulation begins another."""
    tick: Integers
    """Tick in ms; increases within a run."""
    values: dict[str, Integers]
    """Raw values by name of the object."""


class RecordedPdo:
    """Layout of a PDO, from the head of a log.

    Parameters
    ----------
    od
        Object dictionary of the node.
    head
        Number and CAN-ID of the PDO, names of the mapped objects, whether it is sent every cycle.
    """

    def __init__(self, od: ObjectDictionary, head: Mapping[str, Any]) -> None:
        self.number, self.can_id = int(head["number"]), int(head["can_id"])
        self.every_cycle = bool(head["every_cycle"])
        self.entries = [od[name] for name in head["names"]]
        fields = [(e.name, f"<{'i' if e.low < 0 else 'u'}{e.size}") for e in self.entries]
        self._dtype = np.dtype(fields)

    def found(self, records: Records) -> npt.NDArray[np.bool_]:
        """Return which records are frames of this PDO."""
        found: npt.NDArray[np.bool_] = (
            (records["can_id"] == self.can_id)
            & (records["kind"] == FRAME)
            & (records["length"] == self._dtype.itemsize)
        )
        return found

    def values(self, records: Records) -> dict[str, Integers]:
        """Return the raw values of frames of this PDO, by name."""
        data = np.ascontiguousarray(records["data"][:, : self._dtype.itemsize])
        fields = data.view(self._dtype).reshape(len(records))
        return {entry.name: fields[entry.name].astype(np.int64) for entry in self.entries}


class RowReader:
    """Decodes records that arrive piece by piece to rows.

    Parameters
    ----------
    pdos
        TPDOs by number; one of those sent in every cycle carries the tick.
    held
        Initial raw values, by name, of the objects that are sent only on a change.
    clocked
        Whether ticks follow the clock.

    Attributes
    ----------
    gaps
        Gaps found so far.

    Raises
    ------
    ValueError
        If no TPDO that is sent in every cycle carries the tick.
    """

    def __init__(self, pdos: Sequence[RecordedPdo], held: Mapping[str, int], clocked: bool) -> None:
        self._cycle = [pdo for pdo in pdos if pdo.every_cycle]
        self._seldom = [pdo for pdo in pdos if not pdo.every_cycle]
        if not any(entry.name == TICK for pdo in self._cycle for entry in pdo.entries):
            raise ValueError(f"no TPDO that comes in every cycle carries {TICK}")
        self._held = {e.name: int(held[e.name]) for pdo in self._seldom for e in pdo.entries}
        self._ticks = TickCount(clocked)
        self._restarted = False
        self._waiting: _Candidates | None = None
        self._given = (-1, -1)
        """Run and tick of the last returned row."""
        self.gaps: list[Gap] = []

    def ends(self, records: Records) -> Places:
        """Return the index of the last frame of each cycle."""
        return np.flatnonzero(self._cycle[-1].found(records))

    def take(self, records: Records, restarts: Places, last: bool = False) -> Rows:
        """Return the rows of the next records.

        Parameters
        ----------
        records
            Records in order.
        restarts
            Indices of the records in which a node, or the simulation, reported a restart.
        last
            Whether these are the last records; otherwise the last row waits for its successor.
        """
        at, values = self._whole_cycles(records)
        for pdo in self._seldom:
            values |= self._last_known(pdo, records, at)
        time_ns = records["time_ns"][at].astype(np.int64)
        counted = self._ticks.count(values.pop(TICK), time_ns, self._since_restart(restarts, at))
        # When a cycle is late, the event timers of the TPDOs send the values of the last one again.
        rows = Rows(at, time_ns, counted.run, counted.tick, values)
        found = _Candidates(rows, counted.follows, counted.origin).chosen(counted.new)
        return self._sure(found, last)

    def _sure(self, found: _Candidates, last: bool) -> Rows:
        """Drop the rows on both sides of a loss, and record the gap.

        A loss may begin in one cycle and end in another; what is left of both looks like one cycle.
        """
        if self._waiting is not None:
            found = self._waiting.joined(found)
        sure = found.follows.copy()
        sure[:-1] &= found.follows[1:]
        self._waiting = None
        if len(sure) and not last:
            self._waiting = found.chosen(np.s_[-1:])
            sure[-1] = False
        found = found.chosen(sure)
        rows = found.rows
        run, tick = np.append(self._given[0], rows.run), np.append(self._given[1], rows.tick)
        before = np.where(run[1:] == run[:-1], tick[:-1], found.origin - 1)
        for i in np.flatnonzero(rows.tick - before > 1).tolist():
            gap = (rows.run[i], before[i] + 1, rows.tick[i] - 1, rows.time_ns[i])
            self.gaps.append(Gap(*map(int, gap)))
        self._given = int(run[-1]), int(tick[-1])
        return rows

    def _whole_cycles(self, records: Records) -> tuple[Places, dict[str, Integers]]:
        """Return the last frame of each complete cycle, and the values of its frames.

        The frames come in the order of their numbers, after those of the cycle before.
        """
        ends = self.ends(records)
        after = np.append(-1, ends[:-1])[: len(ends)]
        whole = np.ones(len(ends), np.bool_)
        places = []
        for pdo in self._cycle:
            found = np.append(-1, np.flatnonzero(pdo.found(records)))
            at = found[np.searchsorted(found, ends, side="right") - 1]
            whole &= at > after
            after = at
            places.append(at)
        values: dict[str, Integers] = {}
        for pdo, at in zip(self._cycle, places, strict=True):
            values |= pdo.values(records[at[whole]])
        return ends[whole], values

    def _last_known(self, pdo: RecordedPdo, records: Records, at: Places) -> dict[str, Integers]:
        """Return for each row the last values of a TPDO that is sent only on a change."""
        found = np.flatnonzero(pdo.found(records))
        count = np.searchsorted(found, at, side="right")
        columns = {}
        for name, values in pdo.values(records[found]).items():
            known = np.append(self._held[name], values)
            columns[name] = known[count]
            self._held[name] = int(known[-1])
        return columns

    def _since_restart(self, restarts: Places, at: Places) -> Flags:
        """Return for each row whether there was a restart since the row before."""
        before = np.searchsorted(restarts, at)
        since: Flags = np.diff(before, prepend=0) > 0
        if len(since):
            since[0] |= self._restarted
            self._restarted = len(restarts) > before[-1]
        else:
            self._restarted |= len(restarts) > 0
        return since


class _Candidates(NamedTuple):
    """Rows, some of which may mix frames of two cycles."""

    rows: Rows
    follows: Flags
    """Whether no tick is missing before the row."""
    origin: Integers
    """First tick of the run of the row."""

    def chosen(self, which: Flags | slice) -> _Candidates:
        """Return the rows selected by `which`."""
        at, time_ns, run, tick, values = self.rows
        some = {name: column[which] for name, column in values.items()}
        rows = Rows(at[which], time_ns[which], run[which], tick[which], some)
        return _Candidates(rows, self.follows[which], self.origin[which])

    def joined(self, others: _Candidates) -> _Candidates:
        """Return these rows, from earlier records, followed by `others`."""
        mine, other = self.rows, others.rows
        values = {n: np.append(column, other.values[n]) for n, column in mine.values.items()}
        gone = np.full(len(mine.at), -1, other.at.dtype)
        rows = Rows(
            np.append(gone, other.at),
            np.append(mine.time_ns, other.time_ns),
            np.append(mine.run, other.run),
            np.append(mine.tick, other.tick),
            values,
        )
        follows = np.append(self.follows, others.follows)
        return _Candidates(rows, follows, np.append(self.origin, others.origin))


class Kind(Enum):
    """Kinds of events."""

    MARKER = auto()
    SET_POINT = auto()
    TEXTURE = auto()
    EMERGENCY = auto()
    RESTART = auto()


class Event(NamedTuple):
    """An event of a recording."""

    kind: Kind
    at: int
    """Index among the records."""
    time_ns: int
    text: str = ""
    """Text of a marker or an emergency; name of the object whose value changed."""
    node_id: int = 0
    raw: int = 0
    """Raw value of the object, emergency error code, or slot of a texture."""
    table: bytes = b""
    """Texture as written; empty if the slot was emptied."""


class EventReader:
    """Decodes records that arrive piece by piece to events.

    Parameters
    ----------
    ods
        Object dictionary of each node by node-ID.
    node_id
        Node-ID of the stimulator.
    tpdos
        TPDOs of the stimulator, which are no events.
    commanded
        RPDOs of the stimulator.
    known
        Raw values by name before the first record.
    """

    def __init__(
        self,
        ods: Mapping[int, ObjectDictionary],
        node_id: int,
        tpdos: Sequence[RecordedPdo],
        commanded: Sequence[RecordedPdo],
        known: Mapping[str, int],
    ) -> None:
        self._ods = ods
        self._node_id = node_id
        self._tpdos = [pdo.can_id for pdo in tpdos]
        self._commanded = {pdo.can_id: pdo for pdo in commanded}
        self._known = dict(known)
        self._downloads = {number: Downloads(number) for number in ods}
        self._text = b""

    def take(self, records: Records) -> list[Event]:
        """Return the events of the next records, in order."""
        kinds = records["kind"]
        others = ~np.isin(records["can_id"], self._tpdos) | (kinds != FRAME)
        events: list[Event] = []
        for at in np.flatnonzero(others).tolist():
            record = records[at]
            time_ns, data = int(record["time_ns"]), bytes(record["data"][: record["length"]])
            if kinds[at] == MARK:
                self._text += data if len(self._text) < _MOST_MARKER_BYTES else b""
            elif kinds[at] == MARK_END:
                text, self._text = (self._text + data).decode(errors="replace"), b""
                events.append(Event(Kind.MARKER, at, time_ns, text))
            elif record["can_id"] in self._commanded:
                events += self._commands(at, record)
            else:
                frame = Frame(int(record["can_id"]), data)
                for node_id, od in self._ods.items():
                    events += self._read(at, time_ns, frame, node_id, od)
        return events

    def _commands(self, at: int, record: np.void) -> Iterable[Event]:
        pdo = self._commanded[int(record["can_id"])]
        rows = np.array([record])
        if pdo.found(rows)[0]:
            for name, values in pdo.values(rows).items():
                raw = int(values[0])
                if self._known.get(name) != raw:
                    self._known[name] = raw
                    time_ns = int(record["time_ns"])
                    yield Event(Kind.SET_POINT, at, time_ns, name, self._node_id, raw)

    def _read(
        self, at: int, time_ns: int, frame: Frame, node_id: int, od: ObjectDictionary
    ) -> Iterable[Event]:
        """Yield the events of a frame from or to a node that is not a PDO."""
        if frame == (HEARTBEAT_ID + node_id, BOOT_UP, False):
            yield Event(Kind.RESTART, at, time_ns, node_id=node_id)
        elif frame.can_id == EMCY_ID + node_id and len(frame.data) == _EMCY_BYTES:
            code = int.from_bytes(frame.data[:2], "little")
            yield Event(Kind.EMERGENCY, at, time_ns, _emergency(code, frame.data), node_id, code)
        elif taken := self._downloads[node_id].hear(frame):
            entry = od.get(*taken.address)
            if entry is not None:
                yield from self._taken(at, time_ns, node_id, entry, taken)

    def _taken(
        self, at: int, time_ns: int, node_id: int, entry: Entry, taken: Written
    ) -> Iterable[Event]:
        if entry.name in TABLE_NAMES:
            slot = TABLE_NAMES.index(entry.name) + 1
            yield Event(Kind.TEXTURE, at, time_ns, entry.name, node_id, slot, taken.data)
        elif entry.size == len(taken.data):
            raw = unpack(entry.data_type, taken.data)
            if isinstance(raw, int) and entry.index >= MANUFACTURER_FIRST:
                self._known[entry.name] = raw
                yield Event(Kind.SET_POINT, at, time_ns, entry.name, node_id, raw)
            if entry.name == START_RUN:
                yield Event(Kind.RESTART, at, time_ns, node_id=node_id)


def _emergency(code: int, data: bytes) -> str:
    watchdog = data[3]
    if code and watchdog < len(Watchdog) and WATCHDOGS[Watchdog(watchdog)].code == code:
        return WATCHDOGS[Watchdog(watchdog)].text
    return "" if code else "reset"
