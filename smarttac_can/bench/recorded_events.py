"""What happened beside the rows: set-points, textures, emergencies, markers, restarts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import Enum, auto
from typing import Final, NamedTuple

import numpy as np

from smarttac_can.bench.recorded_rows import RecordedPdo
from smarttac_can.device.frame import Frame
from smarttac_can.host.frame_log import FRAME, MARK, MARK_END, Records
from smarttac_can.master.requests import Downloads, Written
from smarttac_can.od.cia import BOOT_UP, EMCY_ID, HEARTBEAT_ID, MANUFACTURER_FIRST
from smarttac_can.od.data_types import unpack
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.objects import START_RUN
from smarttac_can.vocabulary.textures import TABLE_NAMES
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

_EMCY_BYTES: Final = 8
_MOST_MARKER_BYTES: Final = 4000
"""Of 1000 characters; a log that is damaged may go on and on."""


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
    """Say what an emergency message means, as the nodes of this package send it."""
    watchdog = data[3]
    if code and watchdog < len(Watchdog) and WATCHDOGS[Watchdog(watchdog)].code == code:
        return WATCHDOGS[Watchdog(watchdog)].text
    return "" if code else "reset"
