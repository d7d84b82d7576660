"""Values as an EDS writes them: numbers, `$NODEID` formulas, texts and octets (CiA 306, 4.3)."""

from __future__ import annotations

import re
import struct
from typing import Any, Final

from smarttac_can.od.cia import DataType
from smarttac_can.od.data_types import REAL, SIGNED, SIZES, TEXT, bounds
from smarttac_can.od.ini import EDSError

_NUMBER: Final = re.compile(r"^([+-]?)(0x[0-9a-f]{1,32}|[0-9]{1,32})$")
_NODE_ID: Final = re.compile(r"^(?:\$nodeid\+)(.+)$|^(.+)\+\$nodeid$|^\$nodeid()$")


def parse_value(data_type: DataType, text: str, node_id: int, where: str) -> Any:
    """Read a default, a limit or another value of an entry.

    Parameters
    ----------
    text
        Not empty.
    node_id
        What stands for ``$NODEID``.
    where
        What the message of an error begins with.

    Raises
    ------
    EDSError
        The text is no value of the type.
    """
    if data_type in TEXT:
        return text
    if data_type in REAL:
        return _real(data_type, text, where)
    if bounds(data_type) == (0, 0):
        return _octets(data_type, text, where)
    lowered = text.replace(" ", "").lower()
    if found := _NODE_ID.match(lowered):
        value = node_id + parse_integer(next((g for g in found.groups() if g), "0"), where)
    else:
        value = parse_integer(lowered, where)
    low, high = bounds(data_type)
    if data_type in SIGNED and lowered.startswith("0x") and high < value <= 2 * high + 1:
        value -= 2 * int(high) + 2
    if not low <= value <= high:
        raise EDSError(f"{where} is outside {data_type.name}")
    return value


def parse_integer(text: str, where: str) -> int:
    """Read a decimal, a hexadecimal with 0x or an octal with a leading 0.

    Raises
    ------
    EDSError
        If the text is none of them; the message begins with ``where``.
    """
    found = _NUMBER.match(text.strip().lower())
    if found is None:
        raise EDSError(f"{where} is no integer")
    digits = found[2]
    octal = len(digits) > 1 and digits.startswith("0") and not digits.startswith("0x")
    try:
        value = int(digits, 8 if octal else 0)
    except ValueError:
        raise EDSError(f"{where} is no octal number") from None
    return -value if found[1] == "-" else value


def _real(data_type: DataType, text: str, where: str) -> float:
    """Read a decimal, or the bits in hexadecimal, as some tools write them."""
    low, high = bounds(data_type)
    try:
        if text.lower().startswith("0x"):
            raw = int(text, 16).to_bytes(SIZES[data_type], "big")
            value = float(struct.unpack(">f" if data_type == DataType.REAL32 else ">d", raw)[0])
        else:
            value = float(text)
    except (ValueError, OverflowError):
        raise EDSError(f"{where} is no {data_type.name}") from None
    if not low <= value <= high:
        raise EDSError(f"{where} is outside {data_type.name}")
    return value


def _octets(data_type: DataType, text: str, where: str) -> bytes:
    """Read bytes in hexadecimal; a plain 0 stands for bytes of zero."""
    size = SIZES.get(data_type, 0)
    if text.lower() in ("0", "0x0"):
        return bytes(size)
    try:
        data = bytes.fromhex(text.lower().removeprefix("0x"))
    except ValueError:
        raise EDSError(f"{where} is no hexadecimal string") from None
    if size and len(data) != size:
        raise EDSError(f"{where} is not {size} bytes long")
    return data
