"""The difference between a frame of a log and the one that is recomputed, in words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.mapping import Direction, compile_mapping
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.vocabulary.meanings import emergency_text, meaning, meaning_of_bytes
from smarttac_can.vocabulary.signals import DRIVE_TPDO

NOTHING: Final = "nothing"
INITIATED: Final = (2, 3)
"""Command specifiers of SDO answers that name the object."""
_SERVICES: Final = {cia.EMCY_ID: "EMCY", cia.SDO_TX_ID: "SDO answer", cia.HEARTBEAT_ID: "heartbeat"}


class Field(NamedTuple):
    """A difference in a frame."""

    name: str
    """Name of the object, or of the part of the frame."""
    recorded: str
    recomputed: str


class Difference(NamedTuple):
    """The first frame in which a log and its replay differ."""

    number: int
    """Number of the frame in the log, from 1; if the log lacks a frame, the number before it."""
    time_s: float
    """Time in s since the first frame of the log."""
    what: str
    """Kind of the frame."""
    can_id: int
    recorded: Frame | None
    recomputed: Frame | None
    fields: tuple[Field, ...]
    """Differences; empty if one of the two frames is missing."""

    def __str__(self) -> str:
        """Return the difference in one line."""
        where = f"frame {self.number} at {self.time_s:.6f} s"
        what = f"{self.what} ({self.can_id:03X}h)"
        if self.recorded is None:
            return f"after {where}: the log lacks the {what} that is recomputed there"
        if self.recomputed is None:
            return f"{where}: nothing that the log has makes the node send this {what}"
        shown = [
            f"{f.name} is {f.recorded} in the log, {f.recomputed} recomputed" for f in self.fields
        ]
        return f"{where}, {what}: {'; '.join(shown)}"

    def as_json(self) -> dict[str, object]:
        """Return the difference for JSON."""
        return {
            "frame": self.number,
            "time_s": round(self.time_s, 6),
            "what": self.what,
            "can_id": self.can_id,
            "recorded": None if self.recorded is None else self.recorded.data.hex(),
            "recomputed": None if self.recomputed is None else self.recomputed.data.hex(),
            "objects": [field._asdict() for field in self.fields],
        }


def difference(
    od: ObjectDictionary,
    number: int,
    time_s: float,
    recorded: Frame | None,
    recomputed: Frame | None,
) -> Difference:
    """Return the difference of two frames with one identifier, one of which may be missing.

    Parameters
    ----------
    od
        Object dictionary of the node in its present state.
    number, time_s
        Number and time in s in the log.
    recorded, recomputed
        Frame in the log, and frame of the replay.
    """
    frame = recorded or recomputed
    assert frame is not None
    tpdo = _tpdo(od, frame.can_id)
    if tpdo:
        what = f"drive, TPDO {tpdo}" if tpdo == DRIVE_TPDO else f"TPDO {tpdo}"
    elif frame.can_id == od.sync_id:
        what = "SYNC"
    else:
        what = _SERVICES.get(frame.can_id - od.node_id, "frame")
    fields: tuple[Field, ...] = ()
    if recorded is not None and recomputed is not None:
        fields = tuple(_fields(od, tpdo, recorded, recomputed)) or (_bytes(recorded, recomputed),)
    return Difference(number, time_s, what, frame.can_id, recorded, recomputed, fields)


def _tpdo(od: ObjectDictionary, can_id: int) -> int:
    """Return the number of the TPDO with an identifier; 0 if there is none."""
    for number in range(1, cia.PDO_COUNT + 1):
        communication = od.get(cia.TPDO_COMMUNICATION + number - 1, cia.PDO_COB_ID)
        if communication is None:
            return 0
        if communication.value & cia.CAN_ID_MASK == can_id:
            return number
    return 0


def mapped(
    od: ObjectDictionary, index: int, direction: Direction, frame: Frame
) -> list[tuple[Entry, int]]:
    """Return the entries that a PDO maps, with their raw values; [] if the length differs."""
    mapping = compile_mapping(od, index, direction)
    if mapping.size != len(frame.data):
        return []
    return list(zip(mapping.entries, mapping.read(frame.data), strict=True))


def _fields(od: ObjectDictionary, tpdo: int, recorded: Frame, recomputed: Frame) -> Iterator[Field]:
    if tpdo:
        index = cia.TPDO_MAPPING + tpdo - 1
        both = [mapped(od, index, Direction.TRANSMIT, frame) for frame in (recorded, recomputed)]
        for (entry, there), (_, here) in zip(*both, strict=False):
            if there != here:
                yield Field(entry.name, meaning(entry, there), meaning(entry, here))
    elif len(recorded.data) == len(recomputed.data) == cia.FRAME_BYTES:
        if recorded.can_id == cia.EMCY_ID + od.node_id:
            yield Field("error", _emergency(recorded), _emergency(recomputed))
        elif recorded.data[:4] == recomputed.data[:4] and recorded.data[0] >> 5 in INITIATED:
            yield from _read_field(od, recorded, recomputed)


def _read_field(od: ObjectDictionary, recorded: Frame, recomputed: Frame) -> Iterator[Field]:
    entry = od.get(recorded.data[1] | recorded.data[2] << 8, recorded.data[3])
    if entry is None:
        return
    there, here = (meaning_of_bytes(entry, frame.data[4:]) for frame in (recorded, recomputed))
    yield Field(entry.name, there, here)


def _bytes(recorded: Frame, recomputed: Frame) -> Field:
    there, here = recorded.data.hex(), recomputed.data.hex()
    return Field("it", there or NOTHING, here or NOTHING)


def _emergency(frame: Frame) -> str:
    code = int.from_bytes(frame.data[:2], "little")
    return f"{code:04X}h, {emergency_text(code)} ({frame.data.hex()})"
