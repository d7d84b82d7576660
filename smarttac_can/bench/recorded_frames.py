"""Rows and events made of the frames of a recording, piece by piece; no clock, no file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from smarttac_can.bench.recorded_events import Event, EventReader, Kind
from smarttac_can.bench.recorded_rows import TICK, Gap, RecordedPdo, RowReader, Rows
from smarttac_can.host.frame_log import RECORD, Records
from smarttac_can.od.eds import load_eds

_MOST_WAITING: Final = 1 << 18
"""Records that wait for the end of their cycle, which may never come."""


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
            Whether there are no more: the events behind the last row are taken, too.
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
