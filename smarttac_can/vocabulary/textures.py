"""Textures: tables of COF over position or time, and their binary format."""

from __future__ import annotations

import struct
from binascii import crc32
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

COF_COUNT: Final = 1e-4
"""COF of one count."""
SLOTS: Final = 4
"""Number of tables that a stimulator stores."""
TABLES: Final = "Texture table"
"""Name of the array of objects that holds the tables."""
TABLE_NAMES: Final = tuple(f"{TABLES}.Table {number}" for number in range(1, SLOTS + 1))
"""Names of the objects, by slot."""
MAX_VALUES: Final = 4096
"""Most values of a table: 76 mm of plate in steps of 19 um."""
MAX_STEP: Final = 10_000_000
"""Largest step: 10 mm or 10 s."""
MAX_START: Final = 100_000_000
"""Largest distance of the first value from the middle of the plate in nm."""

_MAGIC: Final = b"STX1"
_HEADER: Final = struct.Struct("<4sBBHiI")
_CRC_BYTES: Final = 4
_LEAST_BYTES: Final = _HEADER.size + 2 + _CRC_BYTES
MAX_BYTES: Final = _HEADER.size + 2 * MAX_VALUES + _CRC_BYTES
"""Size of the longest table in bytes."""


class Axis(IntEnum):
    """Axis of a table."""

    POSITION = 0
    """Position of the finger in nm from the middle of the plate."""
    TIME = 1
    """Time in us since the table started to play."""


@dataclass(frozen=True, slots=True)
class TextureTable:
    """A table of COF with equidistant values and linear interpolation between them.

    Before the first value and after the last one the COF is constant, unless the table repeats.

    Raises
    ------
    ValueError
        A field is out of range; the message names the first such field and its range.
    """

    axis: Axis
    """Axis of the table."""
    repeats: bool
    """Whether the table repeats, one step after its last value and also before its first one."""
    start: int
    """Position of the first value: -100000000..100000000 nm, or 0 us."""
    step: int
    """Distance between two values in nm or us, 1..10000000."""
    values: tuple[int, ...]
    """COF values in 1e-4, 1 to 4096 of them, each 1..65535; the bounds of a device are narrower."""

    def __post_init__(self) -> None:
        most = MAX_START if self.axis is Axis.POSITION else 0
        _require("start", self.start, -most, most)
        _require("step", self.step, 1, MAX_STEP)
        _require("number of values", len(self.values), 1, MAX_VALUES)
        _require("value", min(self.values), 1, 0xFFFF)
        _require("value", max(self.values), 1, 0xFFFF)

    def at(self, place: float) -> float:
        """Return the COF at a place in nm or us."""
        return cof_at(self.values, self.repeats, self.start, self.step, place)

    def require_within(self, low: int, high: int) -> None:
        """Check values in 1e-4 against the bounds of a device.

        Raises
        ------
        ValueError
            A value is outside; the message names the first one, its number in the table, and the
            bounds.
        """
        for number, value in enumerate(self.values):
            if not low <= value <= high:
                raise ValueError(
                    f"COF {value * COF_COUNT:g} of value {number} is outside "
                    f"{low * COF_COUNT:g}..{high * COF_COUNT:g}"
                )

    def pack(self) -> bytes:
        """Return the bytes: header, values, and a CRC-32 of both, all little-endian."""
        count = len(self.values)
        header = _HEADER.pack(_MAGIC, self.axis, self.repeats, count, self.start, self.step)
        body = header + struct.pack(f"<{count}H", *self.values)
        return body + crc32(body).to_bytes(_CRC_BYTES, "little")

    @classmethod
    def unpack(cls, data: bytes) -> TextureTable:
        """Return the table in bytes made by `pack`.

        Raises
        ------
        ValueError
            The bytes are no table, or a damaged one; the message says why.
        """
        _require("number of bytes", len(data), _LEAST_BYTES, MAX_BYTES)
        body, crc = data[:-_CRC_BYTES], data[-_CRC_BYTES:]
        magic, axis, repeats, count, start, step = _HEADER.unpack_from(body)
        if magic != _MAGIC:
            raise ValueError(f"they begin with {magic.hex(' ')}, not {_MAGIC.hex(' ')}")
        if crc32(body) != int.from_bytes(crc, "little"):
            raise ValueError("the checksum is not that of the content")
        if len(body) != _HEADER.size + 2 * count:
            raise ValueError(f"number of values {count} is not that of {len(data)} bytes")
        _require("axis", axis, Axis.POSITION, Axis.TIME)
        _require("repeat flag", repeats, 0, 1)
        values = struct.unpack_from(f"<{count}H", body, _HEADER.size)
        return cls(Axis(axis), bool(repeats), start, step, values)


def cof_at(values: Sequence[float], repeats: bool, start: int, step: int, place: float) -> float:
    """Return the COF at a place in nm or us; the other arguments are those of `TextureTable`."""
    count = len(values)
    steps = (place - start) / step
    if repeats:
        steps %= count
        number = int(steps)
        # A remainder just below 0 may be rounded up to the full period.
        if number >= count:
            return values[0] * COF_COUNT
        after = values[(number + 1) % count]
    elif steps <= 0.0:
        return values[0] * COF_COUNT
    elif steps >= count - 1:
        return values[-1] * COF_COUNT
    else:
        number = int(steps)
        after = values[number + 1]
    before = values[number]
    return (before + (after - before) * (steps - number)) * COF_COUNT


def _require(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise ValueError(f"{name} {value} is outside {low}..{high}")
