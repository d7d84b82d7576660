"""Transfer syntax of the CiA 301 data types: little-endian, as in SDO and PDO."""

from __future__ import annotations

import struct
import sys
from typing import Any, Final

from smarttac_can.canopen.od.cia import Abort, AbortCode, DataType

SIGNED: Final[dict[int, int]] = {
    DataType.INTEGER8: 1,
    DataType.INTEGER16: 2,
    DataType.INTEGER24: 3,
    DataType.INTEGER32: 4,
    DataType.INTEGER40: 5,
    DataType.INTEGER48: 6,
    DataType.INTEGER56: 7,
    DataType.INTEGER64: 8,
}
UNSIGNED: Final[dict[int, int]] = {
    DataType.UNSIGNED8: 1,
    DataType.UNSIGNED16: 2,
    DataType.UNSIGNED24: 3,
    DataType.UNSIGNED32: 4,
    DataType.UNSIGNED40: 5,
    DataType.UNSIGNED48: 6,
    DataType.UNSIGNED56: 7,
    DataType.UNSIGNED64: 8,
}
REAL: Final[dict[int, int]] = {DataType.REAL32: 4, DataType.REAL64: 8}
TIME: Final[dict[int, int]] = {DataType.TIME_OF_DAY: 6, DataType.TIME_DIFFERENCE: 6}
TEXT: Final = frozenset({DataType.VISIBLE_STRING, DataType.UNICODE_STRING})

SIZES: Final[dict[int, int]] = {DataType.BOOLEAN: 1, **SIGNED, **UNSIGNED, **REAL, **TIME}
"""Size in bytes of every type of fixed length; the other types have a variable length."""

STRUCT_CODES: Final[dict[int, str]] = {
    DataType.BOOLEAN: "B",
    DataType.INTEGER8: "b",
    DataType.INTEGER16: "h",
    DataType.INTEGER32: "i",
    DataType.INTEGER64: "q",
    DataType.UNSIGNED8: "B",
    DataType.UNSIGNED16: "H",
    DataType.UNSIGNED32: "I",
    DataType.UNSIGNED64: "Q",
    DataType.REAL32: "f",
    DataType.REAL64: "d",
}
"""Codes of the module struct, for the types that it has; PDOs are packed with them, after ``<``."""
_REAL_LARGEST: Final[dict[int, float]] = {
    DataType.REAL32: (2 - 2**-23) * 2.0**127,
    DataType.REAL64: sys.float_info.max,
}
_VISIBLE: Final = bytes([0, *b"\t\n\r", *range(0x20, 0x7F)])
"""Valid bytes of a VISIBLE_STRING: those of CiA 301, and white space, which data sheets contain."""
_REPLACED: Final = {code: "?" for code in range(0x80) if code not in _VISIBLE}


def bounds(data_type: DataType) -> tuple[int | float, int | float]:
    """Return the smallest and the largest value of a numeric type; (0, 0) for any other type."""
    if data_type in UNSIGNED:
        return 0, (1 << 8 * UNSIGNED[data_type]) - 1
    if data_type in SIGNED:
        half = 1 << (8 * SIGNED[data_type] - 1)
        return -half, half - 1
    if data_type in REAL:
        return -_REAL_LARGEST[data_type], _REAL_LARGEST[data_type]
    return (0, 1) if data_type == DataType.BOOLEAN else (0, 0)


def visible(text: str) -> str:
    """Return a text as a VISIBLE_STRING, with ``?`` for each character that it cannot hold."""
    return text.encode("ascii", "replace").decode("ascii").translate(_REPLACED)


def zero(data_type: DataType) -> Any:
    """Return the value of an entry without a default in the EDS."""
    if data_type in TEXT:
        return ""
    if data_type in REAL:
        return 0.0
    if data_type in SIGNED or data_type in UNSIGNED or data_type == DataType.BOOLEAN:
        return 0
    return bytes(SIZES.get(data_type, 0))


def pack(data_type: DataType, value: Any) -> bytes:
    """Return the bytes of a value, which must be within the bounds of its type.

    `unpack` accepts all bytes that this returns, so a client can write back what it has read.
    Characters that a string cannot hold are replaced by ``?``.
    """
    if data_type in UNSIGNED or data_type == DataType.BOOLEAN:
        return int(value).to_bytes(SIZES[data_type], "little")
    if data_type in SIGNED:
        return int(value).to_bytes(SIGNED[data_type], "little", signed=True)
    if data_type in REAL:
        return struct.pack(f"<{STRUCT_CODES[data_type]}", value)
    if data_type == DataType.VISIBLE_STRING:
        return visible(str(value)).encode("ascii")
    if data_type == DataType.UNICODE_STRING:
        return str(value).encode("utf-16-le", "replace")
    return bytes(value)


def unpack(data_type: DataType, data: bytes) -> Any:
    """Return the value in the bytes of one entry.

    Raises
    ------
    Abort
        TOO_LONG or TOO_SHORT for a length other than that of the type, LENGTH for half a character
        of a UNICODE_STRING, VALUE for bytes that are no characters of the type.
    """
    size = SIZES.get(data_type)
    if size is not None and len(data) != size:
        raise Abort(AbortCode.TOO_LONG if len(data) > size else AbortCode.TOO_SHORT)
    if data_type in UNSIGNED or data_type == DataType.BOOLEAN:
        return int.from_bytes(data, "little")
    if data_type in SIGNED:
        return int.from_bytes(data, "little", signed=True)
    if data_type in REAL:
        return struct.unpack(f"<{STRUCT_CODES[data_type]}", data)[0]
    if data_type == DataType.VISIBLE_STRING:
        if data.translate(None, _VISIBLE):
            raise Abort(AbortCode.VALUE)
        return data.decode("ascii")
    if data_type == DataType.UNICODE_STRING:
        if len(data) % 2:
            raise Abort(AbortCode.LENGTH)
        try:
            return data.decode("utf-16-le")
        except UnicodeDecodeError:
            raise Abort(AbortCode.VALUE) from None
    return bytes(data)
