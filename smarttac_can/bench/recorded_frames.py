"""Decode the frames of a recording piece by piece to rows, gaps and events; no clock, no file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.named_objects import shown, shown_unit
from smarttac_can.bench.textures import Texture
from smarttac_can.bench.traces import Integers
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master.requests import Downloads, Written
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.data_types import unpack
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.host.frame_log import FRAME, MARK, MARK_END, RECORD, Records
from smarttac_can.vocabulary.meanings import START_RUN
from smarttac_can.vocabulary.textures import TABLE_NAMES, TextureTable
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


class Marker(NamedTuple):
    """A text of `Stimulator.mark`."""

    host_time_ns: int
    """Time in ns since 1970."""
    run: int
    tick: int
    """Tick of the last row before the marker; -1 before the first row."""
    text: str


class SetPoint(NamedTuple):
    """A value that a node has accepted from any writer."""

    host_time_ns: int
    run: int
    tick: int
    node_id: int
    name: str
    """Name of the object."""
    value: float
    units: str


class Emergency(NamedTuple):
    """An emergency message."""

    host_time_ns: int
    run: int
    tick: int
    node_id: int
    code: int
    text: str


class RecordedTexture(NamedTuple):
    """A texture that was in a slot as the recording began, or was written to it."""

    host_time_ns: int
    run: int
    tick: int
    slot: int
    """Slot, 1 to 4."""
    before: bool
    """Whether it was in the slot when the recording began."""
    complete: bool
    """Whether all of it was received; `texture` is None if not."""
    texture: Texture | None
    """None if the slot was emptied."""


Event = Marker | SetPoint | Emergency | RecordedTexture
_When = tuple[int, int, int]
"""The first three fields of an event."""


class Missing(NamedTuple):
    """Ticks of a run that are in no row."""

    run: int
    first_tick: int
    last_tick: int
    ticks: int
    host_time_ns: int
    """Time when the row after them was received."""


class RecordedFrames:
    """Decodes the records of a log to rows and events.

    Parameters
    ----------
    head
        Head of the log.
    at_hand
        Object dictionaries that need not be made from the EDS texts of the head again.

    Attributes
    ----------
    ods
        Object dictionary of each node by node-ID.
    tpdos
        TPDOs that the stimulator published.
    events
        Events decoded so far, in order.

    Raises
    ------
    KeyError, ValueError, TypeError, AttributeError, OverflowError
        If the head is not that of a recording.
    """

    def __init__(self, head: Mapping[str, Any], at_hand: Iterable[ObjectDictionary] = ()) -> None:
        made = {(od.node_id, od.text): od for od in at_hand}
        nodes = [(int(node["node_id"]), node["eds"]) for node in head["nodes"]]
        self.ods = {each: made.get((each, eds)) or load_eds(eds, each) for each, eds in nodes}
        node_id = int(head["node_id"])
        own = self.ods[node_id]
        self.tpdos = [RecordedPdo(own, pdo) for pdo in head["published"]]
        commanded = [RecordedPdo(own, pdo) for pdo in head["commanded"]]
        known = head["settings"]
        self._rows = RowReader(self.tpdos, head["held"], bool(head["clocked"]))
        self._events = EventReader(self.ods, node_id, self.tpdos, commanded, known)
        self._rest = np.empty(0, RECORD)
        self._last = (0, -1)
        self.events: list[Event] = []

    @property
    def gaps(self) -> list[Missing]:
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
        events, restarts = self._events.take(records)
        rows = self._rows.take(records, np.array(restarts, np.intp), last)
        for at, event in events:
            before = int(np.searchsorted(rows.at, at)) - 1
            run, tick = self._last if before < 0 else (rows.run[before], rows.tick[before])
            self.events.append(event._replace(run=int(run), tick=int(tick)))
        if len(rows.tick):
            self._last = int(rows.run[-1]), int(rows.tick[-1])
        return rows


class Rows(NamedTuple):
    """Rows of a piece of a recording; all arrays have the same length."""

    at: Places
    """Index of the last frame of each row among the records."""
    time_ns: Integers
    run: Integers
    """Number of the run of ticks, from 0; a restart of node or simulation begins another."""
    tick: Integers
    """Tick in ms; increases within a run."""
    origin: Integers
    """Tick with which the run began."""
    follows: Flags
    """Whether no tick is missing before the row."""
    values: dict[str, Integers]
    """Raw values by name of the object."""

    def chosen(self, which: Flags | slice) -> Rows:
        """Return the rows selected by `which`."""
        return Rows(
            self.at[which],
            self.time_ns[which],
            self.run[which],
            self.tick[which],
            self.origin[which],
            self.follows[which],
            {name: column[which] for name, column in self.values.items()},
        )

    def joined(self, others: Rows) -> Rows:
        """Return these rows, from earlier records, followed by `others`."""
        return Rows(
            np.append(np.full(len(self.at), -1, np.intp), others.at),
            np.append(self.time_ns, others.time_ns),
            np.append(self.run, others.run),
            np.append(self.tick, others.tick),
            np.append(self.origin, others.origin),
            np.append(self.follows, others.follows),
            {name: np.append(column, others.values[name]) for name, column in self.values.items()},
        )


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
        self._clocked = clocked
        self._last = (0, 0, -1, -1, -1)
        """Last row: tick on the bus, time in ns, run, tick, and the first tick of the run."""
        self._restarted = False
        self._waiting: Rows | None = None
        self._given = (-1, -1)
        """Run and tick of the last returned row."""
        self.gaps: list[Missing] = []

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
        return self._sure(self._counted(at, time_ns, values, restarts), last)

    def _counted(
        self, at: Places, time_ns: Integers, values: dict[str, Integers], restarts: Places
    ) -> Rows:
        """Return the rows with their ticks, which have 16 bits on the bus."""
        wire = values.pop(TICK)
        delta, anew = self._steps(wire, time_ns, self._since_restart(restarts, at))
        steps = np.cumsum(np.where(anew, 0, delta))
        begun = np.maximum.accumulate(np.where(anew, np.arange(len(anew)), -1))
        # Until the first restart the run of the last piece goes on.
        _, _, run, tick, origin = self._last
        rows = Rows(
            at,
            time_ns,
            run=run + np.cumsum(anew),
            tick=np.where(begun < 0, tick + steps, wire[begun] + steps - steps[begun]),
            origin=np.where(begun < 0, origin, wire[begun]),
            follows=anew | (delta <= 1),
            values=values,
        )
        if len(wire):
            last = (wire, time_ns, rows.run, rows.tick, rows.origin)
            self._last = tuple(int(column[-1]) for column in last)  # type: ignore[assignment]
        # When a cycle is late, the event timers of the TPDOs send the values of the last one again.
        return rows.chosen(anew | (delta > 0))

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

    def _sure(self, rows: Rows, last: bool) -> Rows:
        """Drop the rows on both sides of a loss, and record the gap.

        A loss may begin in one cycle and end in another; what is left of both looks like one cycle.
        """
        if self._waiting is not None:
            rows = self._waiting.joined(rows)
        sure = rows.follows.copy()
        sure[:-1] &= rows.follows[1:]
        self._waiting = None
        if len(sure) and not last:
            self._waiting = rows.chosen(np.s_[-1:])
            sure[-1] = False
        rows = rows.chosen(sure)
        run, tick = np.append(self._given[0], rows.run), np.append(self._given[1], rows.tick)
        before = np.where(run[1:] == run[:-1], tick[:-1], rows.origin - 1)
        for i in np.flatnonzero(rows.tick - before > 1).tolist():
            first, end = int(before[i]) + 1, int(rows.tick[i])
            row = (int(rows.run[i]), first, end - 1, end - first, int(rows.time_ns[i]))
            self.gaps.append(Missing(*row))
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

    def take(self, records: Records) -> tuple[list[tuple[int, Event]], list[int]]:
        """Decode the next records.

        Returns
        -------
        tuple
            Events in order, each with the index of its record, and the indices of the records in
            which a node or the simulation reported a restart. The events have no run and tick yet.
        """
        kinds = records["kind"]
        others = ~np.isin(records["can_id"], self._tpdos) | (kinds != FRAME)
        events: list[tuple[int, Event]] = []
        restarts: list[int] = []
        for at in np.flatnonzero(others).tolist():
            record = records[at]
            when, data = (int(record["time_ns"]), 0, -1), bytes(record["data"][: record["length"]])
            if kinds[at] == MARK:
                self._text += data if len(self._text) < _MOST_MARKER_BYTES else b""
            elif kinds[at] == MARK_END:
                text, self._text = (self._text + data).decode(errors="replace"), b""
                events.append((at, Marker(*when, text)))
            elif record["can_id"] in self._commanded:
                events += ((at, event) for event in self._commands(when, record))
            else:
                frame = Frame(int(record["can_id"]), data)
                for node_id, od in self._ods.items():
                    found = list(self._read(when, frame, node_id, od))
                    restarts += [at] * found.count(None)
                    events += ((at, event) for event in found if event is not None)
        return events, restarts

    def _commands(self, when: _When, record: np.void) -> Iterable[Event]:
        pdo = self._commanded[int(record["can_id"])]
        rows = np.array([record])
        if pdo.found(rows)[0]:
            for entry, values in zip(pdo.entries, pdo.values(rows).values(), strict=True):
                raw = int(values[0])
                if self._known.get(entry.name) != raw:
                    yield self._set_point(when, self._node_id, entry, raw)

    def _set_point(self, when: _When, node_id: int, entry: Entry, raw: int) -> SetPoint:
        self._known[entry.name] = raw
        return SetPoint(*when, node_id, entry.name, shown(entry, raw), shown_unit(entry) or "1")

    def _read(
        self, when: _When, frame: Frame, node_id: int, od: ObjectDictionary
    ) -> Iterable[Event | None]:
        """Yield the events of a frame from or to a node that is not a PDO; None for a restart."""
        if frame == (cia.HEARTBEAT_ID + node_id, cia.BOOT_UP, False):
            yield None
        elif frame.can_id == cia.EMCY_ID + node_id and len(frame.data) == _EMCY_BYTES:
            code = int.from_bytes(frame.data[:2], "little")
            yield Emergency(*when, node_id, code, _emergency(code, frame.data))
        elif taken := self._downloads[node_id].hear(frame):
            entry = od.get(*taken.address)
            if entry is not None:
                yield from self._taken(when, node_id, entry, taken)

    def _taken(
        self, when: _When, node_id: int, entry: Entry, taken: Written
    ) -> Iterable[Event | None]:
        if entry.name in TABLE_NAMES:
            slot = TABLE_NAMES.index(entry.name) + 1
            yield RecordedTexture(*when, slot, False, *texture_in(taken.data))
        elif entry.size == len(taken.data):
            raw = unpack(entry.data_type, taken.data)
            if isinstance(raw, int) and entry.index >= cia.MANUFACTURER_FIRST:
                yield self._set_point(when, node_id, entry, raw)
            if entry.name == START_RUN:
                yield None


def texture_in(table: bytes) -> tuple[bool, Texture | None]:
    """Return whether all of a table was received, and its texture; None if it is empty."""
    try:
        return True, Texture(TextureTable.unpack(table)) if table else None
    except ValueError:
        return False, None


def _emergency(code: int, data: bytes) -> str:
    watchdog = data[3]
    if code and watchdog < len(Watchdog) and WATCHDOGS[Watchdog(watchdog)].code == code:
        return WATCHDOGS[Watchdog(watchdog)].text
    return "" if code else "reset"
