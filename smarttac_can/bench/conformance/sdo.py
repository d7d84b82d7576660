"""SDO: expedited and segmented transfers, refusals and odd frames."""

from __future__ import annotations

from smarttac_can.bench.conformance.case import Failure, NotApplicable, case
from smarttac_can.bench.conformance.probe import Probe
from smarttac_can.bench.conformance.sdo_client import (
    address,
    confirm,
    download,
    download_segments,
    upload,
)
from smarttac_can.bench.conformance.sheet import needs_number
from smarttac_can.od.cia import (
    DEVICE_TYPE,
    SDO_RX_ID,
    SDO_TX_ID,
    Abort,
    AbortCode,
)
from smarttac_can.od.dictionary import Entry

SERVER_TIME_OUT_S = 2.0
"""Longest time after which an abandoned transfer must not be in the way any more."""

_LENGTH_CODES = (AbortCode.LENGTH, AbortCode.TOO_LONG, AbortCode.TOO_SHORT)


def _number(probe: Probe) -> Entry:
    entry = probe.sheet.number_entry()
    if entry is None:
        raise NotApplicable("the EDS has no rw number of 4 bytes to write")
    return entry


def _long(probe: Probe) -> Entry:
    entry = probe.sheet.long_entry()
    if entry is None:
        raise NotApplicable("the EDS has no entry of more than 4 bytes")
    return entry


def other_value(probe: Probe, entry: Entry) -> bytes:
    """Value other than the present one, within the limits."""
    present = int.from_bytes(upload(probe, entry.index, entry.subindex), "little")
    value = present + 1 if present < entry.high else present - 1
    return value.to_bytes(4, "little")


def _read_back(probe: Probe, entry: Entry, data: bytes) -> None:
    back = upload(probe, entry.index, entry.subindex)
    if back != data:
        raise Failure(f"{entry.name}: {data.hex(' ')} written, {back.hex(' ')} read")


def alive(probe: Probe) -> None:
    """Raise `Failure` unless the server answers a plain upload."""
    try:
        upload(probe, DEVICE_TYPE)
    except (Abort, Failure) as error:
        raise Failure(f"the SDO server does not work afterwards: {error}") from error


@case("SDO-01", "Expedited upload", "7.2.4.3.5: up to 4 bytes come in the initiate response.")
def expedited_upload(probe: Probe) -> None:
    response = probe.request(b"\x40" + address(DEVICE_TYPE, 0))
    if response[0] != 0x43 or response[1:4] != address(DEVICE_TYPE, 0):
        raise Failure(f"upload of the device type answered by {response.hex(' ')}")


@case(
    "SDO-02",
    "Expedited download",
    "7.2.4.3.3: a value of up to 4 bytes is confirmed and then read back.",
    needs_number,
)
def expedited_download(probe: Probe) -> None:
    entry = _number(probe)
    data = other_value(probe, entry)
    download(probe, entry.index, entry.subindex, data)
    _read_back(probe, entry, data)


@case(
    "SDO-03",
    "Expedited download without size",
    "7.2.4.3.3: with s = 0 the length is that of the entry.",
    needs_number,
)
def expedited_download_without_size(probe: Probe) -> None:
    entry = _number(probe)
    data, where = other_value(probe, entry), address(entry.index, entry.subindex)
    confirm(probe.request(b"\x22" + where + data), where)
    _read_back(probe, entry, data)


@case(
    "SDO-04",
    "Segmented upload",
    "7.2.4.3.5, .6: more than 4 bytes come in segments with alternating toggle.",
)
def segmented_upload(probe: Probe) -> None:
    entry = _long(probe)
    data = upload(probe, entry.index, entry.subindex)
    if entry.size and len(data) != entry.size:
        raise Failure(f"{entry.name}: {len(data)} bytes instead of {entry.size}")


def _segmented_download(probe: Probe, *, say_size: bool) -> None:
    entry = probe.sheet.long_writable()
    if entry is None:
        entry = _number(probe)
        data = other_value(probe, entry)
    else:
        data = upload(probe, entry.index, entry.subindex)
    download_segments(probe, entry.index, entry.subindex, data, say_size=say_size)
    _read_back(probe, entry, data)


@case(
    "SDO-05",
    "Segmented download with size",
    "7.2.4.3.3, .4: segments are confirmed with their toggle, the value is read back.",
    needs_number,
)
def segmented_download(probe: Probe) -> None:
    _segmented_download(probe, say_size=True)


@case(
    "SDO-06",
    "Segmented download without size",
    "7.2.4.3.3: with s = 0 the length follows from the last segment.",
    needs_number,
)
def segmented_download_without_size(probe: Probe) -> None:
    _segmented_download(probe, say_size=False)


@case(
    "SDO-07",
    "Wrong toggle in an upload",
    "7.2.4.3.6: a segment request whose toggle did not alternate is aborted by 05030000h.",
)
def upload_toggle(probe: Probe) -> None:
    entry = _long(probe)
    probe.request(b"\x40" + address(entry.index, entry.subindex))
    probe.refuse(lambda: probe.request(b"\x70"), "toggle 1 in the first segment", AbortCode.TOGGLE)
    alive(probe)


@case(
    "SDO-08",
    "Wrong toggle in a download",
    "7.2.4.3.4: a segment whose toggle did not alternate is aborted by 05030000h.",
    needs_number,
)
def download_toggle(probe: Probe) -> None:
    entry = _number(probe)
    where = address(entry.index, entry.subindex)
    before = upload(probe, entry.index, entry.subindex)
    confirm(probe.request(b"\x21" + where + b"\x04"), where)
    segment = b"\x17" + other_value_of(before)
    probe.refuse(lambda: probe.request(segment), "toggle 1 in the first segment", AbortCode.TOGGLE)
    _read_back(probe, entry, before)


def other_value_of(data: bytes) -> bytes:
    """Bytes other than those given."""
    return bytes((data[0] ^ 1,)) + data[1:]


@case(
    "SDO-09",
    "Segment without a transfer",
    "7.2.4.3: a segment that belongs to no transfer is aborted by 05040001h.",
)
def segment_without_transfer(probe: Probe) -> None:
    for command, what in ((0x60, "upload"), (0x00, "download")):
        probe.refuse(
            lambda command=command: probe.request(bytes((command,))),
            f"{what} segment without a transfer",
            AbortCode.COMMAND,
        )
    alive(probe)


@case(
    "SDO-10",
    "Unknown command",
    "7.2.4.3.17: an unknown command specifier is aborted by 05040001h.",
)
def unknown_command(probe: Probe) -> None:
    probe.refuse(lambda: probe.request(b"\xe0"), "command specifier 7", AbortCode.COMMAND)
    alive(probe)


@case(
    "SDO-11",
    "Abort by the client",
    "7.2.4.3.17: an abort ends the transfer and is not answered.",
)
def client_abort(probe: Probe) -> None:
    entry = _long(probe)
    where = address(entry.index, entry.subindex)
    probe.request(b"\x40" + where)
    probe.sdo_send(b"\x80" + where + AbortCode.GENERAL.to_bytes(4, "little"))
    probe.silence(SDO_TX_ID + probe.node_id, "answer to an abort")
    probe.refuse(
        lambda: probe.request(b"\x60"), "segment request after the abort", AbortCode.COMMAND
    )
    alive(probe)


@case(
    "SDO-12",
    "A new transfer after one left behind",
    "7.2.4.3: an initiate request is served while an abandoned transfer is open.",
)
def abandoned_transfer(probe: Probe) -> None:
    entry = _long(probe)
    probe.request(b"\x40" + address(entry.index, entry.subindex))
    alive(probe)


@case(
    "SDO-13",
    "Time-out of a transfer left behind",
    "7.2.4.3.17: a server that waits in vain gives up, by 05040000h or in silence.",
)
def transfer_time_out(probe: Probe) -> None:
    entry = _long(probe)
    probe.request(b"\x40" + address(entry.index, entry.subindex))
    try:
        probe.sdo_response(SERVER_TIME_OUT_S)
    except Abort as abort:
        if abort.code != AbortCode.TIME_OUT:
            raise Failure(f"the transfer ended with {abort}") from None
    except Failure:
        pass
    else:
        raise Failure("the server goes on without a request")
    alive(probe)


def _absent_index(probe: Probe) -> int:
    objects = probe.sheet.od.objects
    first = min(objects)
    return next(index for index in range(first, first + len(objects) + 1) if index not in objects)


def _absent_subindex(probe: Probe) -> tuple[int, int]:
    item = next(i for i in probe.sheet.od.objects.values() if max(i.entries) < 0xFE)
    return item.index, max(item.entries) + 1


@case(
    "SDO-14",
    "Access to an object that does not exist",
    "Table 22: reading and writing are aborted by 06020000h.",
)
def no_object(probe: Probe) -> None:
    index = _absent_index(probe)
    where = f"{index:04X}h"
    code = AbortCode.NO_OBJECT
    probe.refuse(lambda: upload(probe, index), f"reading {where}", code)
    probe.refuse(lambda: download(probe, index, 0, b"\0"), f"writing {where}", code)


@case(
    "SDO-15",
    "Access to a sub-index that does not exist",
    "Table 22: reading and writing are aborted by 06090011h.",
)
def no_subindex(probe: Probe) -> None:
    index, subindex = _absent_subindex(probe)
    where = f"{index:04X}h:{subindex:02X}"
    code = AbortCode.NO_SUBINDEX
    probe.refuse(lambda: upload(probe, index, subindex), f"reading {where}", code)
    probe.refuse(lambda: download(probe, index, subindex, b"\0"), f"writing {where}", code)


@case("SDO-16", "Write to a read-only entry", "Table 22: it is aborted by 06010002h.")
def write_read_only(probe: Probe) -> None:
    entry = probe.sheet.od.entry(DEVICE_TYPE)
    probe.refuse(
        lambda: download(probe, entry.index, 0, bytes(entry.size)),
        "writing the device type",
        AbortCode.READ_ONLY,
    )


@case("SDO-17", "Read of a write-only entry", "Table 22: it is aborted by 06010001h.")
def read_write_only(probe: Probe) -> None:
    entry = probe.sheet.first("wo", writable=True)
    if entry is None:
        raise NotApplicable("the EDS has no write-only entry")
    probe.refuse(
        lambda: upload(probe, entry.index, entry.subindex),
        f"reading {entry.name}",
        AbortCode.WRITE_ONLY,
    )


@case(
    "SDO-18",
    "Too many bytes",
    "Table 22: more bytes than the entry has are aborted by 06070012h or 06070010h.",
    needs_number,
)
def too_long(probe: Probe) -> None:
    entry = _number(probe)
    before = upload(probe, entry.index, entry.subindex)
    probe.refuse(
        lambda: download_segments(probe, entry.index, entry.subindex, before + b"\0"),
        f"5 bytes to {entry.name}",
        *_LENGTH_CODES,
    )
    _read_back(probe, entry, before)


@case(
    "SDO-19",
    "Too few bytes",
    "Table 22: fewer bytes than the entry has are aborted by 06070013h or 06070010h.",
    needs_number,
)
def too_short(probe: Probe) -> None:
    entry = _number(probe)
    before = upload(probe, entry.index, entry.subindex)
    probe.refuse(
        lambda: download(probe, entry.index, entry.subindex, other_value_of(before)[:2]),
        f"2 bytes to {entry.name}",
        *_LENGTH_CODES,
    )
    _read_back(probe, entry, before)


@case(
    "SDO-20",
    "Announced size not kept",
    "7.2.4.3.4: fewer bytes than announced are aborted; nothing is written.",
    needs_number,
)
def size_not_kept(probe: Probe) -> None:
    entry = _number(probe)
    where = address(entry.index, entry.subindex)
    before = upload(probe, entry.index, entry.subindex)
    confirm(probe.request(b"\x21" + where + b"\x04"), where)
    segment = b"\x0b" + other_value_of(before)[:2]
    probe.refuse(
        lambda: probe.request(segment), "2 bytes where 4 were announced", *_LENGTH_CODES
    )
    _read_back(probe, entry, before)


@case(
    "SDO-21",
    "Frames that are no SDO",
    "7.2.4.3: an SDO has 8 bytes; shorter frames and remote frames change nothing.",
    needs_number,
)
def no_sdo(probe: Probe) -> None:
    entry = _number(probe)
    before = upload(probe, entry.index, entry.subindex)
    can_id = SDO_RX_ID + probe.node_id
    probe.send(can_id, b"\x23" + address(entry.index, entry.subindex) + other_value_of(before)[:3])
    probe.send(can_id)
    probe.send(can_id, rtr=True)
    probe.settle()
    _read_back(probe, entry, before)


@case(
    "SDO-22",
    "Multiplexer in an abort",
    "7.2.4.3.17: an abort names the index and sub-index of the request.",
)
def abort_names_entry(probe: Probe) -> None:
    where = address(_absent_index(probe), 3)
    probe.drain()
    probe.sdo_send(b"\x40" + where)
    data = probe.expect(SDO_TX_ID + probe.node_id, "SDO response").data
    if data[:4] != b"\x80" + where:
        raise Failure(f"request {where.hex(' ')} aborted by {data.hex(' ')}")
