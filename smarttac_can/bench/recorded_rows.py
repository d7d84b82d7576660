"""Rows of a recording made of its TPDOs, with ticks that rise, runs told apart, and gaps named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.recorded_ticks import Flags, TickCount
from smarttac_can.bench.traces import Integers
from smarttac_can.host.frame_log import FRAME, Records
from smarttac_can.od.dictionary import ObjectDictionary

TICK: Final = "Contact.Tick"
Places = npt.NDArray[np.intp]


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
        """Tell which records are frames of it."""
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
            Places among them where a node, or the simulation, said that it begins anew.
        last
            Whether there are no more; else the last row waits for the one behind it.
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
        """Return for each row what a TPDO that comes only on a change has said last."""
        found = np.flatnonzero(pdo.found(records))
        behind = np.searchsorted(found, at, side="right")
        columns = {}
        for name, values in pdo.values(records[found]).items():
            known = np.append(self._held[name], values)
            columns[name] = known[behind]
            self._held[name] = int(known[-1])
        return columns

    def _since_restart(self, restarts: Places, at: Places) -> Flags:
        """Tell for each row whether there was a restart since the row before."""
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
