"""Frames of a recording decoded piece by piece: rows, gaps and events; no clock, no file."""

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
"""Records that wait for the end of their cycle, which may never come."""
_WRAP: Final = 1 << 16
_FEW: Final = 100
"""Ticks that may be missing where a run goes on; one that begins anew is farther off."""
_AHEAD_MS: Final = 1000
"""Ticks follow the clock, and their frames are taken within this time."""
_AMBIGUOUS_MS: Final = 60_000
"""The 16 bits of the tick come round after 65.5 s."""
Flags = npt.NDArray[np.bool_]
TICK: Final = "Contact.Tick"
Places = npt.NDArray[np.intp]
_EMCY_BYTES: Final = 8
_MOST_MARKER_BYTES: Final = 4000
"""Of 1000 characters; a log that is damaged may go on and on."""


class Dated(NamedTuple):
    """An event, and the row before it."""

    event: Event
    run: int
    tick: int
    """-1 before the first row."""


class RecordedFrames:
    """Makes rows and events of the records of a log.

    Parameters
    ----------
    head
        Head of the log.

    Attributes
    ----------
    ods
        EDS of each node by node-ID.
    tpdos
        What the stimulator published.
    events
        Taken so far, in order; none of them is a restart.

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
        """Ticks that are missing between the rows so far."""
        return self._rows.gaps

    @property
    def channels(self) -> dict[str, bool]:
        """Objects of the channels by name, and whether they come in every cycle."""
        return {
            entry.name: pdo.every_cycle
            for pdo in self.tpdos
            for entry in pdo.entries
            if entry.name != TICK
        }

    def take(self, records: Records, last: bool = False) -> Rows:
        """Take the next records, and return the rows that are complete with them.

        Parameters
        ----------
        records
            In order.
        last
            Whether there are no more: the events after the last row are taken, too.
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
    """Ticks of rows; arrays of equal length."""

    run: Integers
    """Number of the run of ticks, from 0."""
    tick: Integers
    """Tick in ms; rises within a run."""
    origin: Integers
    """Tick with which the run began."""
    follows: Flags
    """Whether no tick is missing before it."""
    new: Flags
    """Whether it is not the tick of the row before once more."""


class TickCount:
    """Counts the ticks of rows that are given piece by piece.

    Parameters
    ----------
    clocked
        Whether ticks follow the clock.
    """

    def __init__(self, clocked: bool) -> None:
        self._clocked = clocked
        # Of the last row: tick on the bus, time in ns, run, tick, and where the run began.
        self._last = (0, 0, -1, -1, -1)

    def count(self, wire: Integers, time_ns: Integers, restarted: Flags) -> Counted:
        """Count the next rows.

        Parameters
        ----------
        wire
            Their ticks, modulo 2^16.
        time_ns
            When they came.
        restarted
            Whether a node, or the simulation, has reported before a row that it begins anew.
        """
        delta, anew = self._steps(wire, time_ns, restarted)
        steps = np.cumsum(np.where(anew, 0, delta))
        begun = np.maximum.accumulate(np.where(anew, np.arange(len(anew)), -1))
        # Before the first that begins anew the last run goes on.
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
        """Return by how many ticks each row is further than the one before, or begins anew."""
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
    """When the row after them came."""


class Rows(NamedTuple):
    """Rows of a piece of a recording; all arrays have the same length."""

    at: Places
    """Place of the last frame of each row among the records."""
    time_ns: Integers
    run: Integers
    """Number of the run of ticks, from 0; a restart of node or simulation begins another."""
    tick: Integers
    """Tick in ms; within a run it rises."""
    values: dict[str, Integers]
    """Raw values by name of the object."""


class RecordedPdo:
    """What a PDO carries, by the head of a log.

    Parameters
    ----------
    od
        EDS of the node.
    head
        Its number, CAN-ID, names of the mapped objects, and whether it comes in every cycle.
    """

    def __init__(self, od: ObjectDictionary, head: Mapping[str, Any]) -> None:
        self.number, self.can_id = int(head["number"]), int(head["can_id"])
        self.every_cycle = bool(head["every_cycle"])
        self.entries = [od[name] for name in head["names"]]
        fields = [(e.name, f"<{'i' if e.low < 0 else 'u'}{e.size}") for e in self.entries]
        self._dtype = np.dtype(fields)

    def found(self, records: Records) -> npt.NDArray[np.bool_]:
        """Return which records are frames of it."""
        found: npt.NDArray[np.bool_] = (
            (records["can_id"] == self.can_id)
            & (records["kind"] == FRAME)
            & (records["length"] == self._dtype.itemsize)
        )
        return found

    def values(self, records: Records) -> dict[str, Integers]:
        """Return the raw values that its frames carry, by name."""
        data = np.ascontiguousarray(records["data"][:, : self._dtype.itemsize])
        fields = data.view(self._dtype).reshape(len(records))
        return {entry.name: fields[entry.name].astype(np.int64) for entry in self.entries}


class RowReader:
    """Makes rows of records that are given piece by piece.

    Parameters
    ----------
    pdos
        TPDOs by number; one of those of every cycle carries the tick.
    held
        Raw values, by name, of what comes only when it changes, before it comes.
    clocked
        Whether ticks follow the clock.

    Attributes
    ----------
    gaps
        Found so far.

    Raises
    ------
    ValueError
        If no TPDO of every cycle carries the tick.
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
        """Run and tick of the last row that was given out."""
        self.gaps: list[Gap] = []

    def ends(self, records: Records) -> Places:
        """Find the last frame of each cycle."""
        return np.flatnonzero(self._cycle[-1].found(records))

    def take(self, records: Records, restarts: Places, last: bool = False) -> Rows:
        """Return rows of the next records.

        Parameters
        ----------
        records
            In order.
        restarts
            Places among them where a node, or the simulation, reported that it begins anew.
        last
            Whether there are no more; else the last row waits for the one after it.
        """
        at, values = self._whole_cycles(records)
        for pdo in self._seldom:
            values |= self._last_known(pdo, records, at)
        time_ns = records["time_ns"][at].astype(np.int64)
        counted = self._ticks.count(values.pop(TICK), time_ns, self._since_restart(restarts, at))
        # When a cycle comes late, the event timers of the TPDOs repeat the one before.
        rows = Rows(at, time_ns, counted.run, counted.tick, values)
        found = _Candidates(rows, counted.follows, counted.origin).chosen(counted.new)
        return self._sure(found, last)

    def _sure(self, found: _Candidates, last: bool) -> Rows:
        """Leave out the rows beside a loss, and name what is missing.

        A loss may begin in one cycle and end in another: what is left of both looks like one.
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
        """Find the last frame of each cycle that has all of its frames, and what these carry.

        They come in the order of their numbers, after those of the cycle before.
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
        """Return for each row what a TPDO that comes only on a change carried last."""
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
    """Rows of which some may be mixed of two cycles."""

    rows: Rows
    follows: Flags
    """Whether no tick is missing before it."""
    origin: Integers
    """Tick with which its run began."""

    def chosen(self, which: Flags | slice) -> _Candidates:
        """Return some of them."""
        at, time_ns, run, tick, values = self.rows
        some = {name: column[which] for name, column in values.items()}
        rows = Rows(at[which], time_ns[which], run[which], tick[which], some)
        return _Candidates(rows, self.follows[which], self.origin[which])

    def joined(self, others: _Candidates) -> _Candidates:
        """Return these, of records that are gone, and others after them."""
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
    """Something that happened."""

    kind: Kind
    at: int
    """Place among the records."""
    time_ns: int
    text: str = ""
    """Of a marker or an emergency; name of the object whose value changed."""
    node_id: int = 0
    raw: int = 0
    """Raw value of the object, emergency error code, or slot of a texture."""
    table: bytes = b""
    """Of a texture, as it was written; empty where the slot was emptied."""


class EventReader:
    """Reads events of records that are given piece by piece.

    Parameters
    ----------
    ods
        EDS of each node by node-ID.
    node_id
        That of the stimulator.
    tpdos
        TPDOs of the stimulator, which are no events.
    commanded
        Its RPDOs.
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
        """Read an RPDO: what it changes."""
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
        """Read a frame from or to a node that is no PDO."""
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
        """Read that a node has taken a value."""
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
    """Return what an emergency message means, as the nodes of this package send it."""
    watchdog = data[3]
    if code and watchdog < len(Watchdog) and WATCHDOGS[Watchdog(watchdog)].code == code:
        return WATCHDOGS[Watchdog(watchdog)].text
    return "" if code else "reset"
