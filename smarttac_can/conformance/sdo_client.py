"""SDO transfers as a client makes them, with each step checked."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.od.cia import EXPEDITED_BYTES, AbortCode

OUT_OF_RANGE = (AbortCode.VALUE, AbortCode.TOO_HIGH, AbortCode.TOO_LOW)
"""How a device may refuse a value that is outside of what an entry takes."""
_UPLOAD_RESPONSE = 2
_SEGMENT = 7
_LONGEST = 1 << 24


def address(index: int, subindex: int) -> bytes:
    """Return the three bytes that name an entry in an SDO request: its multiplexer."""
    return index.to_bytes(2, "little") + bytes((subindex,))


def upload(examiner: Examiner, index: int, subindex: int = 0) -> bytes:
    """Read the bytes of an entry, expedited or segmented.

    Raises
    ------
    Abort
        If the device refuses.
    Failure
        If it does not answer, or breaks the protocol.
    """
    where = address(index, subindex)
    response = examiner.request(b"\x40" + where)
    command = response[0]
    if command >> 5 != _UPLOAD_RESPONSE or response[1:4] != where:
        raise Failure(f"upload of {index:04X}h:{subindex:02X} answered by {response.hex(' ')}")
    if command & 2:
        return response[4 : 8 - (command >> 2 & 3)] if command & 1 else response[4:]
    size = int.from_bytes(response[4:], "little") if command & 1 else None
    data = bytearray()
    toggle = 0
    while len(data) < _LONGEST:
        segment = examiner.request(bytes((0x60 | toggle,)))
        if segment[0] >> 5 or segment[0] & 0x10 != toggle:
            raise Failure(f"upload segment with command byte {segment[0]:02X}h, toggle {toggle:X}h")
        data += segment[1 : 8 - (segment[0] >> 1 & 7)]
        toggle ^= 0x10
        if segment[0] & 1:
            break
    if size is not None and len(data) != size:
        raise Failure(f"{index:04X}h:{subindex:02X} says {size} bytes and sends {len(data)}")
    return bytes(data)


def download(examiner: Examiner, index: int, subindex: int, data: bytes) -> None:
    """Write an entry, expedited up to 4 bytes, else segmented.

    Raises
    ------
    Abort
        If the device refuses.
    Failure
        If it does not answer, or breaks the protocol.
    """
    if not 1 <= len(data) <= EXPEDITED_BYTES:
        download_segments(examiner, index, subindex, data)
        return
    where = address(index, subindex)
    command = 0x23 | (4 - len(data)) << 2
    confirm(examiner.request(bytes((command,)) + where + data), where)


def download_segments(
    examiner: Examiner, index: int, subindex: int, data: bytes, *, say_size: bool = True
) -> None:
    """Write an entry by segments, whatever its length."""
    where = address(index, subindex)
    size = len(data).to_bytes(4, "little") if say_size else bytes(4)
    confirm(examiner.request(bytes((0x20 | say_size,)) + where + size), where)
    toggle = 0
    parts = [data[i : i + _SEGMENT] for i in range(0, len(data), _SEGMENT)] or [b""]
    for number, part in enumerate(parts, 1):
        last = number == len(parts)
        command = toggle | (_SEGMENT - len(part)) << 1 | last
        response = examiner.request(bytes((command,)) + part)
        if response[0] != 0x20 | toggle:
            raise Failure(f"download segment answered by {response.hex(' ')}")
        toggle ^= 0x10


def confirm(response: bytes, where: bytes) -> None:
    """Raise `Failure` unless the response confirms a download to the entry."""
    if response != b"\x60" + where + bytes(4):
        raise Failure(f"download answered by {response.hex(' ')}")


def number(examiner: Examiner, index: int, subindex: int = 0) -> int:
    """Read an unsigned number of any length."""
    return int.from_bytes(upload(examiner, index, subindex), "little")


def write_number(examiner: Examiner, index: int, subindex: int, value: int) -> None:
    """Write an unsigned number in the length that the data sheet gives the entry."""
    size = examiner.sheet.od.entry(index, subindex).size
    download(examiner, index, subindex, value.to_bytes(size, "little"))
