"""SDO block transfer of an object of a few bytes, with and without CRC, and what must be refused.

Block transfer is optional: a server that answers the initiate request by 05040001h has none.
"""

from __future__ import annotations

from binascii import crc_hqx
from functools import partial

from smarttac_can.conformance.case import Failure, NotApplicable, case
from smarttac_can.conformance.description import needs_number
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.sdo import alive, number_entry, other_value, read_back
from smarttac_can.conformance.sdo_client import address, upload
from smarttac_can.od.cia import DEVICE_TYPE, Abort, AbortCode
from smarttac_can.od.entry import Entry

_CRC = 0x04
_SIZE = 0x02
_LAST = 0x80
_SEGMENT = 7
_MOST_SEGMENTS = 127

# Commands of the server without their flags: CRC, size and number of unused bytes.
_UPLOAD = 0xC0
_UPLOAD_END = 0xC1
_DOWNLOAD = 0xA0
_SUB_BLOCK = 0xA2
_DOWNLOAD_END = 0xA1


def _initiate(examiner: Examiner, request: bytes) -> bytes:
    try:
        return examiner.request(request)
    except Abort as abort:
        if abort.code == AbortCode.COMMAND:
            raise NotApplicable("the device has no SDO block transfer") from None
        raise


def _begin_upload(
    examiner: Examiner, entry: Entry, *, crc: bool, block_size: int = _MOST_SEGMENTS
) -> bool:
    """Initiate a block upload; return whether the server makes a CRC."""
    where = address(entry.index, entry.subindex)
    response = _initiate(examiner, bytes((0xA0 | crc * _CRC,)) + where + bytes((block_size, 0)))
    if response[0] & 0xF9 != _UPLOAD or response[1:4] != where:
        raise Failure(f"block upload answered by {response.hex(' ')}")
    return bool(response[0] & _CRC)


def _segments(examiner: Examiner) -> list[bytes]:
    """Receive the segments of the last sub-block of an upload."""
    segments: list[bytes] = []
    while not segments or not segments[-1][0] & _LAST:
        data = examiner.sdo_response()
        if data[0] & 0x7F != len(segments) + 1:
            raise Failure(f"segment {data[0] & 0x7F} instead of {len(segments) + 1}")
        segments.append(data)
    return segments


def _end_upload(examiner: Examiner, segments: list[bytes], *, crc: bool) -> bytes:
    """Acknowledge the last sub-block and check the end; return the data."""
    end = examiner.request(bytes((0xA2, len(segments), 127)))
    if end[0] & 0xE3 != _UPLOAD_END:
        raise Failure(f"block upload ended by {end.hex(' ')}")
    data = b"".join(segment[1:] for segment in segments)
    data = data[: len(data) - (end[0] >> 2 & 7)]
    examiner.sdo_send(b"\xa1")
    wanted = crc_hqx(data, 0) if crc else 0
    got = int.from_bytes(end[1:3], "little")
    if got != wanted:
        raise Failure(f"CRC {got:04X}h instead of {wanted:04X}h")
    return data


def _block_upload(examiner: Examiner, *, crc: bool) -> None:
    entry = examiner.sheet.od.entry(DEVICE_TYPE)
    plain = upload(examiner, DEVICE_TYPE)
    server_crc = _begin_upload(examiner, entry, crc=crc)
    examiner.sdo_send(b"\xa3")
    data = _end_upload(examiner, _segments(examiner), crc=crc and server_crc)
    if data != plain:
        raise Failure(f"block upload gives {data.hex(' ')}, plain upload {plain.hex(' ')}")
    alive(examiner)


@case("SDO-23", "7.2.4.3.13 to .15: 4 bytes and their CRC-CCITT.")
def upload_with_crc(examiner: Examiner) -> None:
    """Block upload with CRC."""
    _block_upload(examiner, crc=True)


@case("SDO-24", "7.2.4.3.15: without a CRC its field is 0.")
def upload_without_crc(examiner: Examiner) -> None:
    """Block upload without CRC."""
    _block_upload(examiner, crc=False)


def _begin_download(examiner: Examiner, entry: Entry, size: int, *, crc: bool) -> bool:
    """Initiate a block download; return whether the server checks the CRC."""
    where = address(entry.index, entry.subindex)
    command = 0xC0 | crc * _CRC | _SIZE
    response = _initiate(examiner, bytes((command,)) + where + size.to_bytes(4, "little"))
    named = response[0] & 0xFB == _DOWNLOAD and response[1:4] == where
    if not named or not 1 <= response[4] <= _MOST_SEGMENTS:
        raise Failure(f"block download answered by {response.hex(' ')}")
    return bool(response[0] & _CRC)


def _sub_block(examiner: Examiner, sequence: int, data: bytes) -> int:
    """Send one last segment and return the number that the server acknowledges."""
    response = examiner.request(bytes((_LAST | sequence,)) + data)
    if response[0] != _SUB_BLOCK:
        raise Failure(f"sub-block answered by {response.hex(' ')}")
    return response[1]


def _end_download(examiner: Examiner, data: bytes, crc: int) -> None:
    command = 0xC1 | (_SEGMENT - len(data)) << 2
    response = examiner.request(bytes((command,)) + crc.to_bytes(2, "little"))
    if response[0] != _DOWNLOAD_END:
        raise Failure(f"end of the block download answered by {response.hex(' ')}")


def _block_download(examiner: Examiner, *, crc: bool, lose: bool = False) -> None:
    entry = number_entry(examiner)
    data = other_value(examiner, entry)
    server_crc = _begin_download(examiner, entry, len(data), crc=crc)
    if lose and (acknowledged := _sub_block(examiner, 2, data)) != 0:
        raise Failure(f"segment 1 was lost, the server acknowledges {acknowledged}")
    if (acknowledged := _sub_block(examiner, 1, data)) != 1:
        raise Failure(f"segment 1 was sent, the server acknowledges {acknowledged}")
    _end_download(examiner, data, crc_hqx(data, 0) if crc and server_crc else 0)
    read_back(examiner, entry, data)


@case(
    "SDO-25",
    "7.2.4.3.9 to .11: 4 bytes with their CRC-CCITT are confirmed and read back.",
    needs_number,
)
def download_with_crc(examiner: Examiner) -> None:
    """Block download with CRC."""
    _block_download(examiner, crc=True)


@case(
    "SDO-26",
    "7.2.4.3.9: a client may have no CRC; its field is then not looked at.",
    needs_number,
)
def download_without_crc(examiner: Examiner) -> None:
    """Block download without CRC."""
    _block_download(examiner, crc=False)


@case(
    "SDO-27",
    "7.2.4.3.10: the server acknowledges the last segment in order; the rest is sent again.",
    needs_number,
)
def lost_segment(examiner: Examiner) -> None:
    """Block download with a lost segment."""
    _block_download(examiner, crc=True, lose=True)


@case(
    "SDO-28",
    "7.2.4.3.11: it is aborted by 05040004h and nothing is written.",
    needs_number,
)
def wrong_crc(examiner: Examiner) -> None:
    """Block download with a wrong CRC."""
    entry = number_entry(examiner)
    before = upload(examiner, entry.index, entry.subindex)
    data = other_value(examiner, entry)
    if not _begin_download(examiner, entry, len(data), crc=True):
        raise NotApplicable("the server checks no CRC")
    _sub_block(examiner, 1, data)
    wrong = crc_hqx(data, 0) ^ 1
    examiner.refuse(lambda: _end_download(examiner, data, wrong), "a wrong CRC", AbortCode.CRC)
    if upload(examiner, entry.index, entry.subindex) != before:
        raise Failure("the value with the wrong CRC was written")


@case(
    "SDO-29",
    "7.2.4.3.13: block sizes 0 and 128 are aborted by 05040002h.",
)
def block_size(examiner: Examiner) -> None:
    """Block size out of range."""
    entry = examiner.sheet.od.entry(DEVICE_TYPE)
    for size in (0, 128):
        examiner.refuse(
            partial(_begin_upload, examiner, entry, crc=False, block_size=size),
            f"block size {size}",
            AbortCode.BLOCK_SIZE,
        )
    alive(examiner)


@case(
    "SDO-30",
    "7.2.4.3.14: after 0 the sub-block comes again; 128 is aborted by 05040003h.",
)
def sequence(examiner: Examiner) -> None:
    """Acknowledged sequence number."""
    _begin_upload(examiner, examiner.sheet.od.entry(DEVICE_TYPE), crc=False)
    examiner.sdo_send(b"\xa3")
    first = _segments(examiner)
    examiner.sdo_send(bytes((0xA2, 0, 127)))
    if _segments(examiner) != first:
        raise Failure("the sub-block that comes again is another one")
    examiner.refuse(
        lambda: examiner.request(bytes((0xA2, 128, 127))), "sequence 128", AbortCode.SEQUENCE
    )
    alive(examiner)
