"""Where a log and its replay part: the frame by what it is, its objects by name, in their units."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, NamedTuple

from smarttac_can.device.frame import Frame
from smarttac_can.device.mapping import Direction, compile_mapping
from smarttac_can.nodes.loop_frames import DRIVE_TPDO
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    EMCY_ID,
    FRAME_BYTES,
    HEARTBEAT_ID,
    PDO_COB_ID,
    PDO_COUNT,
    SDO_TX_ID,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
    Abort,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.meanings import emergency_text

NOTHING: Final = "nothing"
_INITIATED: Final = (2, 3)
"""Command specifiers of SDO answers that name the object."""
_SERVICES: Final = {EMCY_ID: "EMCY", SDO_TX_ID: "SDO answer", HEARTBEAT_ID: "heartbeat"}


class Field(NamedTuple):
    """What differs in a frame."""

    name: str
    """Of the object, or of the part of the frame."""
    recorded: str
    recomputed: str


class Difference(NamedTuple):
    """The first frame in which a log and its replay differ."""

    number: int
    """Of the frame in the log, from 1; of the last one before a frame that the log lacks."""
    time_s: float
    """Since the first frame of the log."""
    what: str
    """What kind of frame it is."""
    can_id: int
    recorded: Frame | None
    recomputed: Frame | None
    fields: tuple[Field, ...]
    """Empty where one of the two frames is missing."""

    def __str__(self) -> str:
        """Say it in one line."""
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
        """Return it for JSON."""
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
    """Name a difference between two frames with one identifier, one of which may be missing.

    Parameters
    ----------
    od
        Object dictionary of the node, as it is now.
    number, time_s
        Where it is in the log.
    recorded, recomputed
        The two frames.
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


def drive_voltage(od: ObjectDictionary, frame: Frame) -> int | None:
    """Return the raw voltage of a drive; None if it has another length."""
    values = mapped(od, TPDO_MAPPING + DRIVE_TPDO - 1, Direction.TRANSMIT, frame)
    return next((raw for entry, raw in values if entry.name.endswith("Voltage")), None)


def _tpdo(od: ObjectDictionary, can_id: int) -> int:
    """Return the number of the TPDO that is sent with an identifier; 0 for none."""
    for number in range(1, PDO_COUNT + 1):
        communication = od.get(TPDO_COMMUNICATION + number - 1, PDO_COB_ID)
        if communication is None:
            return 0
        if communication.value & CAN_ID_MASK == can_id:
            return number
    return 0


def mapped(
    od: ObjectDictionary, index: int, direction: Direction, frame: Frame
) -> list[tuple[Entry, int]]:
    """Return the entries that a PDO maps with their raw values; empty if its length is another."""
    mapping = compile_mapping(od, index, direction)
    if mapping.size != len(frame.data):
        return []
    return list(zip(mapping.entries, mapping.read(frame.data), strict=True))


def _fields(od: ObjectDictionary, tpdo: int, recorded: Frame, recomputed: Frame) -> Iterator[Field]:
    if tpdo:
        index = TPDO_MAPPING + tpdo - 1
        both = [mapped(od, index, Direction.TRANSMIT, frame) for frame in (recorded, recomputed)]
        for (entry, there), (_, here) in zip(*both, strict=False):
            if there != here:
                yield Field(entry.name, _shown(entry, there), _shown(entry, here))
    elif len(recorded.data) == len(recomputed.data) == FRAME_BYTES:
        if recorded.can_id == EMCY_ID + od.node_id:
            yield Field("error", _emergency(recorded), _emergency(recomputed))
        elif recorded.data[:4] == recomputed.data[:4] and recorded.data[0] >> 5 in _INITIATED:
            yield from _read_field(od, recorded, recomputed)


def _read_field(od: ObjectDictionary, recorded: Frame, recomputed: Frame) -> Iterator[Field]:
    """Compare two answers to the same SDO read."""
    entry = od.get(recorded.data[1] | recorded.data[2] << 8, recorded.data[3])
    if entry is None:
        return
    there, here = (_read_value(entry, frame.data[4:]) for frame in (recorded, recomputed))
    yield Field(entry.name, there, here)


def _read_value(entry: Entry, data: bytes) -> str:
    try:
        return _shown(entry, entry.unpack(data[: entry.size or None]))
    except Abort:
        return data.hex()


def _bytes(recorded: Frame, recomputed: Frame) -> Field:
    there, here = recorded.data.hex(), recomputed.data.hex()
    return Field("it", there or NOTHING, here or NOTHING)


def _emergency(frame: Frame) -> str:
    code = int.from_bytes(frame.data[:2], "little")
    return f"{code:04X}h, {emergency_text(code)} ({frame.data.hex()})"


def _shown(entry: Entry, raw: object) -> str:
    if not isinstance(raw, int):
        return repr(raw)
    if entry.name.endswith("word"):
        return f"{raw:#06x}"
    return f"{raw * float(entry.unit.number):.12g} {entry.unit.symbol}".rstrip()
