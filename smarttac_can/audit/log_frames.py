"""What the frames of a log mean: fields of PDOs by the EDS, and the parts of the log of a row."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from smarttac_can.device.frame import Frame
from smarttac_can.od.cia import CAN_ID_MASK, PDO_COB_ID
from smarttac_can.od.dictionary import ObjectDictionary

Stamped = tuple[int, Frame]
"""A frame with its time stamp in us."""
_SILENCE_US: Final = 120_000
"""A heartbeat comes every 100 ms: a log that is silent for longer leaves something out."""


class Field(NamedTuple):
    """Where an unsigned object is in the PDO that carries it."""

    can_id: int
    first: int
    last: int
    """Its bytes, the last one not included."""
    size: int
    """Bytes of the PDO."""

    def read(self, frame: Frame) -> int | None:
        """Return the raw value in a frame; None in a frame that does not carry it."""
        if frame.can_id != self.can_id or frame.rtr or len(frame.data) != self.size:
            return None
        return int.from_bytes(frame.data[self.first : self.last], "little")


def find_field(od: ObjectDictionary, communication: int, mapping: int, name: str) -> Field:
    """Find an object in a PDO that maps it by default, whether the PDO is valid by default or not.

    Parameters
    ----------
    od
        The EDS, loaded for the node-ID.
    communication, mapping
        Index of the PDO's communication and mapping parameter.
    name
        Name of an object of whole bytes.

    Raises
    ------
    ValueError
        If the PDO does not map it.
    """
    wanted = od[name]
    can_id = od.number(communication, PDO_COB_ID) & CAN_ID_MASK
    mapped = [od.number(mapping, place) for place in range(1, od.number(mapping) + 1)]
    size = sum(value & 0xFF for value in mapped) // 8
    first = 0
    for value in mapped:
        last = first + (value & 0xFF) // 8
        if value >> 8 == wanted.index << 8 | wanted.subindex:
            return Field(can_id, first, last, size)
        first = last
    raise ValueError(f"{name} is not mapped in {communication:04X}h")


def parts(frames: Iterable[Stamped]) -> Iterator[list[Stamped]]:
    """Split a log where it leaves something out.

    Raises
    ------
    ValueError
        If time runs backwards.
    """
    part: list[Stamped] = []
    before = 0
    for time, frame in frames:
        if time < before:
            raise ValueError(f"time runs backwards at {time * 1e-6:.6f} s")
        if part and time - before > _SILENCE_US:
            yield part
            part = []
        part.append((time, frame))
        before = time
    if part:
        yield part
