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


class FrameCheck:
    """Check sum of what a drive, or a measurement, carries, and of bytes that both ends know.

    Parameters
    ----------
    entries
        Integers in the order in which they are put on the bus; the last, an UNSIGNED8, is the sum
        of the others, and of what is not sent.
    """

    __slots__ = ("_check", "_entries", "_pack")

    def __init__(self, entries: Sequence[Entry]) -> None:
        *self._entries, self._check = entries
        # Little-endian, as a PDO.
        codes = [_FORMATS[entry.data_type] for entry in self._entries]
        self._pack = Struct("<" + "".join(codes)).pack

    def write(self, unsent: bytes = b"") -> None:
        """Put the check sum of what the entries hold now, and of unsent bytes, into its entry."""
        self._check.value = self._sum(unsent)

    def holds(self) -> bool:
        """Tell whether the check sum is that of what the entries hold."""
        return bool(self._check.value == self._sum(b""))

    def last_unsent(self, before: bytes) -> int:
        """Return the byte not sent that makes the sum right, behind others that are known.

        There is exactly one: a sum that is wrong gives another.
        """
        check = int(self._check.value)
        return _INVERSE[check ^ 0xFF] ^ self._sum(before) ^ 0xFF

    def _sum(self, unsent: bytes) -> int:
        return crc8(self._pack(*[entry.value for entry in self._entries]) + unsent)
