"""End-to-end check of the loop's PDOs: CAN guards the wire, this the memories at its ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from struct import Struct
from typing import Final

from smarttac_can.od.cia import DataType
from smarttac_can.od.entry import Entry

_POLYNOMIAL: Final = 0x1D
_START: Final = 0xFF
_FORMATS: Final = {
    DataType.UNSIGNED8: "B",
    DataType.UNSIGNED16: "H",
    DataType.UNSIGNED32: "I",
    DataType.INTEGER16: "h",
}


def _table() -> bytes:
    table = bytearray()
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc << 1 ^ (_POLYNOMIAL if crc & 0x80 else 0)) & 0xFF
        table.append(crc)
    return bytes(table)


_TABLE: Final = _table()
_PAIRS: Final = b"".join(
    _TABLE.translate(bytes([_TABLE[byte ^ second] for byte in range(256)])) for second in range(256)
)
"""The same for two bytes at a time, by the second and the first."""
_INVERSE: Final = bytes(_TABLE.index(byte) for byte in range(256))
"""What the table was asked for."""
_SOUND: Final = _TABLE[0xFF] ^ 0xFF
"""Sum of bytes whose last one is that of those before."""


def crc8(data: bytes) -> int:
    """Return the CRC-8 of SAE J1850: x^8 + x^4 + x^3 + x^2 + 1, from FFh on, inverted at the end.

    One wrong bit, and wrong bits within 8 in a row, are always found.
    """
    crc = _START
    size = len(data)
    for pair in _pairs_of(size)(data):
        crc = _PAIRS[crc ^ pair]
    if size % 2:
        crc = _TABLE[crc ^ data[-1]]
    return crc ^ 0xFF


@cache
def _pairs_of(size: int) -> Callable[[bytes], tuple[int, ...]]:
    return Struct(f"<{size // 2}H").unpack_from


class CheckedFrames:
    """Layout of the frames of one drive, or of one measurement, whose last byte is a check sum.

    Parameters
    ----------
    mapped
        Integers in the order of the bus. The last one, an UNSIGNED8, is the check sum of the
        others, and of what is not sent.

    Attributes
    ----------
    entries
        Those without the check sum.
    check
        Entry of the check sum.
    unpack
        Returns the values in the concatenated bytes, the check sum last.
    """

    __slots__ = ("_mapped", "_pack", "check", "entries", "unpack")

    def __init__(self, mapped: Sequence[Entry]) -> None:
        self._mapped = mapped
        *entries, self.check = mapped
        self.entries = tuple(entries)
        # Little-endian, as a PDO.
        code = "<" + "".join([_FORMATS[entry.data_type] for entry in entries])
        self._pack: Callable[..., bytes] = Struct(code).pack
        self.unpack: Callable[[bytes], tuple[int, ...]] = Struct(f"{code}B").unpack

    def write_check(self, unsent: bytes = b"") -> None:
        """Set the check sum to that of what the entries hold now.

        Parameters
        ----------
        unsent
            Bytes that both ends know, and that the check sum covers, too.
        """
        body = self._pack(*[entry.value for entry in self.entries])
        self.check.value = crc8(body + unsent)

    def keep(self, values: tuple[int, ...]) -> None:
        """Set the entries to the values of all frames, the check sum last."""
        for entry, value in zip(self._mapped, values, strict=True):
            entry.value = value


def holds(data: bytes) -> bool:
    """Tell whether the last byte is the check sum of those before, with nothing unsent."""
    return crc8(data) == _SOUND


def last_unsent(data: bytes, before: bytes) -> int:
    """Return the byte not sent that makes the last byte the sum, behind others that are known.

    There is exactly one: a sum that is wrong gives another.
    """
    return _INVERSE[data[-1] ^ 0xFF] ^ crc8(data[:-1] + before) ^ 0xFF
