"""SDO: expedited, segmented and block transfers, refusals and invalid frames."""

from __future__ import annotations

from binascii import crc_hqx

from smarttac_can.canopen.conformance import refusals
from smarttac_can.canopen.conformance.case import Failure, Group, NotApplicable, case, needs_number
from smarttac_can.canopen.conformance.examiner import (
    Examiner,
    address,
    confirm,
    download,
    download_segments,
    upload,
)
from smarttac_can.canopen.master.requests import ABORT
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.data_types import pack, unpack
from smarttac_can.canopen.od.entry import Entry

_EXPEDITED_4_BYTES = 0x43


def number_entry(examiner: Examiner) -> Entry:
    """Return the first rw number of 4 bytes in the EDS that the device has.

    Raises
    ------
    Failure
        The device has none.
    """
    for entry in examiner.sheet.number_entries():
        try:
            upload(examiner, entry.index, entry.subindex)
        except Abort:
            continue
        return entry
    raise Failure("the device has none of the rw numbers of 4 bytes that the EDS has")


def _long(examiner: Examiner) -> Entry:
    entry = examiner.sheet.long_entry()
    if entry is None:
        raise NotApplicable("the EDS has no entry of more than 4 bytes")
    return entry


def other_value(examiner: Examiner, entry: Entry) -> bytes:
    """Return the bytes of a value that differs by 1 from the present one, within the limits."""
    present = unpack(entry.data_type, upload(examiner, entry.index, entry.subindex))
    return pack(entry.data_type, present + 1 if present < entry.high else present - 1)


def read_back(examiner: Examiner, entry: Entry, data: bytes) -> None:
    """Raise `Failure` unless an entry has the written value."""
    back = upload(examiner, entry.index, entry.subindex)
    if back != data:
        raise Failure(f"{entry.name}: {data.hex(' ')} written, {back.hex(' ')} read")


def alive(examiner: Examiner) -> None:
    """Raise `Failure` unless the server answers a normal upload."""
    try:
        upload(examiner, cia.DEVICE_TYPE)
    except (Abort, Failure) as error:
        raise Failure(f"the SDO server does not work afterwards: {error}") from error


_sdo = Group("SDO")


@case(_sdo, 1, "7.2.4.3.5: up to 4 bytes come in the initiate response.")
def expedited_upload(examiner: Examiner) -> None:
    """Expedited upload."""
    response = examiner.request(b"\x40" + address(cia.DEVICE_TYPE, 0))
    if response[0] != _EXPEDITED_4_BYTES or response[1:4] != address(cia.DEVICE_TYPE, 0):
        raise Failure(f"upload of the device type answered by {response.hex(' ')}")


_of_number = Group("SDO", (needs_number,))


@case(_of_number, 2, "7.2.4.3.3: a value of up to 4 bytes is confirmed and then read back.")
def expedited_download(examiner: Examiner) -> None:
    """Expedited download."""
    entry = number_entry(examiner)
    data = other_value(examiner, entry)
    download(examiner, entry.index, entry.subindex, data)
    read_back(examiner, entry, data)


@case(_of_number, 3, "7.2.4.3.3: with s = 0 the length is that of the entry.")
def expedited_download_without_size(examiner: Examiner) -> None:
    """Expedited download without size."""
    entry = number_entry(examiner)
    data, where = other_value(examiner, entry), address(entry.index, entry.subindex)
    confirm(examiner.request(b"\x22" + where + data), where)
    read_back(examiner, entry, data)


@case(_sdo, 4, "7.2.4.3.5, .6: more than 4 bytes come in segments with alternating toggle.")
def segmented_upload(examiner: Examiner) -> None:
    """Segmented upload."""
    entry = _long(examiner)
    data = upload(examiner, entry.index, entry.subindex)
    if entry.size and len(data) != entry.size:
        raise Failure(f"{entry.name}: {len(data)} bytes instead of {entry.size}")


def _segmented_download(examiner: Examiner, *, with_size: bool) -> None:
    entry = examiner.sheet.long_writable()
    if entry is None:
        entry = number_entry(examiner)
        data = other_value(examiner, entry)
    else:
        data = upload(examiner, entry.index, entry.subindex)
    download_segments(examiner, entry.index, entry.subindex, data, with_size=with_size)
    read_back(examiner, entry, data)


@case(
    _of_number,
    5,
    "7.2.4.3.3, .4: segments are confirmed with their toggle, the value is read back.",
)
def segmented_download(examiner: Examiner) -> None:
    """Segmented download with size."""
    _segmented_download(examiner, with_size=True)


@case(_of_number, 6, "7.2.4.3.3: with s = 0 the length follows from the last segment.")
def segmented_download_without_size(examiner: Examiner) -> None:
    """Segmented download without size."""
    _segmented_download(examiner, with_size=False)


@case(
    _sdo, 7, "7.2.4.3.6: a segment request whose toggle did not alternate is aborted by 05030000h."
)
def upload_toggle(examiner: Examiner) -> None:
    """Wrong toggle in an upload."""
    entry = _long(examiner)
    examiner.request(b"\x40" + address(entry.index, entry.subindex))
    with examiner.refused("toggle 1 in the first segment", refusals.TOGGLE):
        examiner.request(b"\x70")
    alive(examiner)


@case(_of_number, 8, "7.2.4.3.4: a segment whose toggle did not alternate is aborted by 05030000h.")
def download_toggle(examiner: Examiner) -> None:
    """Wrong toggle in a download."""
    entry = number_entry(examiner)
    where = address(entry.index, entry.subindex)
    before = upload(examiner, entry.index, entry.subindex)
    confirm(examiner.request(b"\x21" + where + b"\x04"), where)
    segment = b"\x17" + other_value_of(before)
    with examiner.refused("toggle 1 in the first segment", refusals.TOGGLE):
        examiner.request(segment)
    read_back(examiner, entry, before)


def other_value_of(data: bytes) -> bytes:
    """Return other bytes of the same length."""
    return bytes((data[0] ^ 1,)) + data[1:]


@case(_sdo, 9, "7.2.4.3: a segment that belongs to no transfer is aborted by 05040001h.")
def segment_without_transfer(examiner: Examiner) -> None:
    """Segment without a transfer."""
    for command, what in ((0x60, "upload"), (0x00, "download")):
        with examiner.refused(f"{what} segment without a transfer", refusals.COMMAND):
            examiner.request(bytes((command,)))
    alive(examiner)


@case(_sdo, 10, "7.2.4.3.17: an unknown command specifier is aborted by 05040001h.")
def unknown_command(examiner: Examiner) -> None:
    """Unknown command."""
    with examiner.refused("command specifier 7", refusals.COMMAND):
        examiner.request(b"\xe0")
    alive(examiner)


@case(_sdo, 11, "7.2.4.3.17: an abort ends the transfer and is not answered.")
def client_abort(examiner: Examiner) -> None:
    """Abort by the client."""
    entry = _long(examiner)
    where = address(entry.index, entry.subindex)
    examiner.request(b"\x40" + where)
    examiner.sdo_send(b"\x80" + where + AbortCode.GENERAL.to_bytes(4, "little"))
    examiner.silence(cia.SDO_TX_ID + examiner.node_id, "answer to an abort")
    with examiner.refused("segment request after the abort", refusals.COMMAND):
        examiner.request(b"\x60")
    alive(examiner)


@case(
    _sdo,
    12,
    "7.2.4.3.17: an abandoned transfer is replaced, or ended by an abort; then all is served.",
)
def abandoned_transfer(examiner: Examiner) -> None:
    """A new transfer after one left behind."""
    entry = _long(examiner)
    examiner.request(b"\x40" + address(entry.index, entry.subindex))
    try:
        upload(examiner, cia.DEVICE_TYPE)
    except Abort as abort:
        # No clause says that a request replaces the transfer; an abort ends it as well.
        examiner.remarks.append(f"a request while a transfer is open: {abort}")
    alive(examiner)


@case(_sdo, 13, "7.2.4.3.17, table 22: if a server gives up by itself, its abort is 05040000h.")
def transfer_time_out(examiner: Examiner) -> None:
    """Transfer left behind."""
    entry = _long(examiner)
    examiner.request(b"\x40" + address(entry.index, entry.subindex))
    arrival = examiner.wait(cia.SDO_TX_ID + examiner.node_id)
    if arrival is not None:
        data = arrival.frame.data
        if data[:1] != bytes((ABORT,)):
            raise Failure(f"without a request the server sends {data.hex(' ')}")
        code = int.from_bytes(data[4:], "little")
        if code != AbortCode.TIME_OUT:
            examiner.remarks.append(f"the server gives up by {Abort(code)}, not 05040000h")
    examiner.abort_transfer()
    alive(examiner)


# Requests that a server must refuse, and frames that are no SDO.


def _absent_index(examiner: Examiner) -> int:
    objects = examiner.sheet.od.objects
    first = min(objects)
    return next(index for index in range(first, first + len(objects) + 1) if index not in objects)


def _absent_subindex(examiner: Examiner) -> tuple[int, int]:
    item = next(i for i in examiner.sheet.od.objects.values() if max(i.entries) < cia.LAST_SUBINDEX)
    return item.index, max(item.entries) + 1


@case(_sdo, 14, "Table 22: reading and writing are aborted by 06020000h.")
def no_object(examiner: Examiner) -> None:
    """Access to an object that does not exist."""
    index = _absent_index(examiner)
    where = f"{index:04X}h"
    with examiner.refused(f"reading {where}", refusals.NO_OBJECT):
        upload(examiner, index)
    with examiner.refused(f"writing {where}", refusals.NO_OBJECT):
        download(examiner, index, 0, b"\0")


@case(_sdo, 15, "Table 22: reading and writing are aborted by 06090011h.")
def no_subindex(examiner: Examiner) -> None:
    """Access to a sub-index that does not exist."""
    index, subindex = _absent_subindex(examiner)
    where = f"{index:04X}h:{subindex:02X}"
    with examiner.refused(f"reading {where}", refusals.NO_SUBINDEX):
        upload(examiner, index, subindex)
    with examiner.refused(f"writing {where}", refusals.NO_SUBINDEX):
        download(examiner, index, subindex, b"\0")


@case(_sdo, 16, "Table 22: it is aborted by 06010002h.")
def write_read_only(examiner: Examiner) -> None:
    """Write to a read-only entry."""
    entry = examiner.sheet.od.entry(cia.DEVICE_TYPE)
    with examiner.refused("writing the device type", refusals.READ_ONLY):
        download(examiner, entry.index, 0, bytes(entry.size))


@case(_sdo, 17, "Table 22: it is aborted by 06010001h.")
def read_write_only(examiner: Examiner) -> None:
    """Read of a write-only entry."""
    entry = next((e for e in examiner.sheet.od if e.access == "wo" and e.size), None)
    if entry is None:
        raise NotApplicable("the EDS has no write-only entry")
    with examiner.refused(f"reading {entry.name}", refusals.WRITE_ONLY):
        upload(examiner, entry.index, entry.subindex)


@case(
    _of_number, 18, "Table 22: more bytes than the entry has are aborted by 06070012h or 06070010h."
)
def too_long(examiner: Examiner) -> None:
    """Too many bytes."""
    entry = number_entry(examiner)
    before = upload(examiner, entry.index, entry.subindex)
    with examiner.refused(f"5 bytes to {entry.name}", refusals.TOO_LONG):
        download_segments(examiner, entry.index, entry.subindex, before + b"\0")
    read_back(examiner, entry, before)


@case(
    _of_number,
    19,
    "Table 22: fewer bytes than the entry has are aborted by 06070013h or 06070010h.",
)
def too_short(examiner: Examiner) -> None:
    """Too few bytes."""
    entry = number_entry(examiner)
    before = upload(examiner, entry.index, entry.subindex)
    with examiner.refused(f"2 bytes to {entry.name}", refusals.TOO_SHORT):
        download(examiner, entry.index, entry.subindex, other_value_of(before)[:2])
    read_back(examiner, entry, before)


@case(_of_number, 20, "7.2.4.3.4: fewer bytes than announced are aborted; nothing is written.")
def size_not_kept(examiner: Examiner) -> None:
    """Announced size not kept."""
    entry = number_entry(examiner)
    where = address(entry.index, entry.subindex)
    before = upload(examiner, entry.index, entry.subindex)
    confirm(examiner.request(b"\x21" + where + b"\x04"), where)
    segment = b"\x0b" + other_value_of(before)[:2]
    with examiner.refused("2 bytes where 4 were announced", refusals.TOO_SHORT):
        examiner.request(segment)
    read_back(examiner, entry, before)


@case(
    _of_number, 21, "7.2.4.3: an SDO has 8 bytes; shorter frames and remote frames change nothing."
)
def no_sdo(examiner: Examiner) -> None:
    """Frames that are no SDO."""
    entry = number_entry(examiner)
    before = upload(examiner, entry.index, entry.subindex)
    can_id = cia.SDO_RX_ID + examiner.node_id
    examiner.send(
        can_id, b"\x23" + address(entry.index, entry.subindex) + other_value_of(before)[:3]
    )
    examiner.send(can_id)
    examiner.send(can_id, rtr=True)
    examiner.settle()
    read_back(examiner, entry, before)


@case(_sdo, 22, "7.2.4.3.17: an abort names the index and sub-index of the request.")
def abort_names_entry(examiner: Examiner) -> None:
    """Multiplexer in an abort."""
    where = address(_absent_index(examiner), 3)
    examiner.drain()
    examiner.sdo_send(b"\x40" + where)
    data = examiner.expect(cia.SDO_TX_ID + examiner.node_id, "SDO response").data
    if data[:4] != b"\x80" + where:
        raise Failure(f"request {where.hex(' ')} aborted by {data.hex(' ')}")


# Block transfer of an object of a few bytes, with and without CRC, and requests to be refused.
#
# Block transfer is optional: a server without it aborts the initiate request, by 05040001h.


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
        raise NotApplicable(f"the device has no SDO block transfer: {abort}") from None


def _upload_request(entry: Entry, *, crc: bool = False, block_size: int = _MOST_SEGMENTS) -> bytes:
    where = address(entry.index, entry.subindex)
    return bytes((0xA0 | crc * _CRC,)) + where + bytes((block_size, 0))


def _begin_upload(examiner: Examiner, entry: Entry, *, crc: bool) -> bool:
    """Initiate a block upload; return whether the server computes a CRC."""
    where = address(entry.index, entry.subindex)
    response = _initiate(examiner, _upload_request(entry, crc=crc))
    if response[0] & 0xF9 != _UPLOAD or response[1:4] != where:
        raise Failure(f"block upload answered by {response.hex(' ')}")
    return bool(response[0] & _CRC)


def _segments(examiner: Examiner) -> list[bytes]:
    segments: list[bytes] = []
    while not segments or not segments[-1][0] & _LAST:
        data = examiner.sdo_response()
        if data[0] & 0x7F != len(segments) + 1:
            end = data[0] & 0xE3 == _UPLOAD_END
            name = "end of the block upload" if end else f"segment {data[0] & 0x7F}"
            raise Failure(f"{name} ({data.hex(' ')}) instead of segment {len(segments) + 1}")
        segments.append(data)
    return segments


def _end_upload(examiner: Examiner, segments: list[bytes], *, crc: bool) -> bytes:
    """Acknowledge the last sub-block and check the end; return the data."""
    end = examiner.request(bytes((0xA2, len(segments), 127)))
    if end[0] & 0xE3 != _UPLOAD_END:
        raise Failure(f"block upload ended by {end.hex(' ')}")
    data = b"".join(segment[1:] for segment in segments)
    data = data[: len(data) - (end[0] >> 2 & 7)]
    examiner.sdo_end(b"\xa1")
    wanted = crc_hqx(data, 0) if crc else 0
    got = int.from_bytes(end[1:3], "little")
    if got != wanted:
        raise Failure(f"CRC {got:04X}h instead of {wanted:04X}h")
    return data


def _block_upload(examiner: Examiner, *, crc: bool) -> None:
    entry = examiner.sheet.od.entry(cia.DEVICE_TYPE)
    plain = upload(examiner, cia.DEVICE_TYPE)
    server_crc = _begin_upload(examiner, entry, crc=crc)
    examiner.sdo_send(b"\xa3")
    data = _end_upload(examiner, _segments(examiner), crc=crc and server_crc)
    if data != plain:
        raise Failure(f"block upload gives {data.hex(' ')}, plain upload {plain.hex(' ')}")
    alive(examiner)


@case(_sdo, 23, "7.2.4.3.13 to .15: 4 bytes and their CRC-CCITT.")
def upload_with_crc(examiner: Examiner) -> None:
    """Block upload with CRC."""
    _block_upload(examiner, crc=True)


@case(_sdo, 24, "7.2.4.3.15: without a CRC its field is 0.")
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
    """Send one last segment; return the number that the server acknowledges."""
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


@case(_of_number, 25, "7.2.4.3.9 to .11: 4 bytes with their CRC-CCITT are confirmed and read back.")
def download_with_crc(examiner: Examiner) -> None:
    """Block download with CRC."""
    _block_download(examiner, crc=True)


@case(_of_number, 26, "7.2.4.3.9: a client may have no CRC; its field is then not looked at.")
def download_without_crc(examiner: Examiner) -> None:
    """Block download without CRC."""
    _block_download(examiner, crc=False)


@case(
    _of_number,
    27,
    "7.2.4.3.10: the server acknowledges the last segment in order; the rest is sent again.",
)
def lost_segment(examiner: Examiner) -> None:
    """Block download with a lost segment."""
    _block_download(examiner, crc=True, lose=True)


@case(_of_number, 28, "7.2.4.3.11: it is aborted by 05040004h and nothing is written.")
def wrong_crc(examiner: Examiner) -> None:
    """Block download with a wrong CRC."""
    entry = number_entry(examiner)
    before = upload(examiner, entry.index, entry.subindex)
    data = other_value(examiner, entry)
    if not _begin_download(examiner, entry, len(data), crc=True):
        raise NotApplicable("the server checks no CRC")
    _sub_block(examiner, 1, data)
    wrong = crc_hqx(data, 0) ^ 1
    with examiner.refused("a wrong CRC", refusals.CRC):
        _end_download(examiner, data, wrong)
    if upload(examiner, entry.index, entry.subindex) != before:
        raise Failure("the value with the wrong CRC was written")


@case(_sdo, 29, "7.2.4.3.13: block sizes 0 and 128 are aborted by 05040002h.")
def block_size(examiner: Examiner) -> None:
    """Block size out of range."""
    entry = examiner.sheet.od.entry(cia.DEVICE_TYPE)
    _begin_upload(examiner, entry, crc=False)
    examiner.abort_transfer()
    for size in (0, 128):
        with examiner.refused(f"block size {size}", refusals.BLOCK_SIZE):
            examiner.request(_upload_request(entry, block_size=size))
    alive(examiner)


@case(_sdo, 30, "7.2.4.3.14: after 0 the sub-block comes again; 128 is aborted by 05040003h.")
def sequence(examiner: Examiner) -> None:
    """Acknowledged sequence number."""
    _begin_upload(examiner, examiner.sheet.od.entry(cia.DEVICE_TYPE), crc=False)
    examiner.sdo_send(b"\xa3")
    first = _segments(examiner)
    examiner.sdo_send(bytes((0xA2, 0, 127)))
    if _segments(examiner) != first:
        raise Failure("the sub-block that comes again is another one")
    with examiner.refused("sequence 128", refusals.SEQUENCE):
        examiner.request(bytes((0xA2, 128, 127)))
    alive(examiner)
