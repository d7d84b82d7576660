"""SDO: expedited and segmented transfers, refusals and odd frames."""

from __future__ import annotations

from functools import partial

from smarttac_can.conformance.case import Failure, NotApplicable, case
from smarttac_can.conformance.description import needs_number
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.sdo_client import (
    address,
    confirm,
    download,
    download_segments,
    upload,
)
from smarttac_can.od.cia import DEVICE_TYPE, SDO_TX_ID, Abort, AbortCode
from smarttac_can.od.data_types import pack, unpack
from smarttac_can.od.entry import Entry

_EXPEDITED_4_BYTES = 0x43
SERVER_TIME_OUT_S = 2.0
"""Longest time after which an abandoned transfer must not be in the way any more."""


def number_entry(examiner: Examiner) -> Entry:
    """Find the first rw number of 4 bytes of the EDS that the device really has.

    Raises
    ------
    Failure
        If it has none.
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
    """Return the bytes of a value next to the present one, within the limits."""
    present = unpack(entry.data_type, upload(examiner, entry.index, entry.subindex))
    return pack(entry.data_type, present + 1 if present < entry.high else present - 1)


def read_back(examiner: Examiner, entry: Entry, data: bytes) -> None:
    """Raise `Failure` unless an entry reads as written."""
    back = upload(examiner, entry.index, entry.subindex)
    if back != data:
        raise Failure(f"{entry.name}: {data.hex(' ')} written, {back.hex(' ')} read")


def alive(examiner: Examiner) -> None:
    """Raise `Failure` unless the server answers a plain upload."""
    try:
        upload(examiner, DEVICE_TYPE)
    except (Abort, Failure) as error:
        raise Failure(f"the SDO server does not work afterwards: {error}") from error


@case("SDO-01", "7.2.4.3.5: up to 4 bytes come in the initiate response.")
def expedited_upload(examiner: Examiner) -> None:
    """Expedited upload."""
    response = examiner.request(b"\x40" + address(DEVICE_TYPE, 0))
    if response[0] != _EXPEDITED_4_BYTES or response[1:4] != address(DEVICE_TYPE, 0):
        raise Failure(f"upload of the device type answered by {response.hex(' ')}")


@case(
    "SDO-02",
    "7.2.4.3.3: a value of up to 4 bytes is confirmed and then read back.",
    needs_number,
)
def expedited_download(examiner: Examiner) -> None:
    """Expedited download."""
    entry = number_entry(examiner)
    data = other_value(examiner, entry)
    download(examiner, entry.index, entry.subindex, data)
    read_back(examiner, entry, data)


@case(
    "SDO-03",
    "7.2.4.3.3: with s = 0 the length is that of the entry.",
    needs_number,
)
def expedited_download_without_size(examiner: Examiner) -> None:
    """Expedited download without size."""
    entry = number_entry(examiner)
    data, where = other_value(examiner, entry), address(entry.index, entry.subindex)
    confirm(examiner.request(b"\x22" + where + data), where)
    read_back(examiner, entry, data)


@case(
    "SDO-04",
    "7.2.4.3.5, .6: more than 4 bytes come in segments with alternating toggle.",
)
def segmented_upload(examiner: Examiner) -> None:
    """Segmented upload."""
    entry = _long(examiner)
    data = upload(examiner, entry.index, entry.subindex)
    if entry.size and len(data) != entry.size:
        raise Failure(f"{entry.name}: {len(data)} bytes instead of {entry.size}")


def _segmented_download(examiner: Examiner, *, say_size: bool) -> None:
    entry = examiner.sheet.long_writable()
    if entry is None:
        entry = number_entry(examiner)
        data = other_value(examiner, entry)
    else:
        data = upload(examiner, entry.index, entry.subindex)
    download_segments(examiner, entry.index, entry.subindex, data, say_size=say_size)
    read_back(examiner, entry, data)


@case(
    "SDO-05",
    "7.2.4.3.3, .4: segments are confirmed with their toggle, the value is read back.",
    needs_number,
)
def segmented_download(examiner: Examiner) -> None:
    """Segmented download with size."""
    _segmented_download(examiner, say_size=True)


@case(
    "SDO-06",
    "7.2.4.3.3: with s = 0 the length follows from the last segment.",
    needs_number,
)
def segmented_download_without_size(examiner: Examiner) -> None:
    """Segmented download without size."""
    _segmented_download(examiner, say_size=False)


@case(
    "SDO-07",
    "7.2.4.3.6: a segment request whose toggle did not alternate is aborted by 05030000h.",
)
def upload_toggle(examiner: Examiner) -> None:
    """Wrong toggle in an upload."""
    entry = _long(examiner)
    examiner.request(b"\x40" + address(entry.index, entry.subindex))
    examiner.refuse(
        lambda: examiner.request(b"\x70"), "toggle 1 in the first segment", AbortCode.TOGGLE
    )
    alive(examiner)


@case(
    "SDO-08",
    "7.2.4.3.4: a segment whose toggle did not alternate is aborted by 05030000h.",
    needs_number,
)
def download_toggle(examiner: Examiner) -> None:
    """Wrong toggle in a download."""
    entry = number_entry(examiner)
    where = address(entry.index, entry.subindex)
    before = upload(examiner, entry.index, entry.subindex)
    confirm(examiner.request(b"\x21" + where + b"\x04"), where)
    segment = b"\x17" + other_value_of(before)
    examiner.refuse(
        lambda: examiner.request(segment), "toggle 1 in the first segment", AbortCode.TOGGLE
    )
    read_back(examiner, entry, before)


def other_value_of(data: bytes) -> bytes:
    """Return bytes of the same length that differ from those given."""
    return bytes((data[0] ^ 1,)) + data[1:]


@case(
    "SDO-09",
    "7.2.4.3: a segment that belongs to no transfer is aborted by 05040001h.",
)
def segment_without_transfer(examiner: Examiner) -> None:
    """Segment without a transfer."""
    for command, what in ((0x60, "upload"), (0x00, "download")):
        examiner.refuse(
            partial(examiner.request, bytes((command,))),
            f"{what} segment without a transfer",
            AbortCode.COMMAND,
        )
    alive(examiner)


@case(
    "SDO-10",
    "7.2.4.3.17: an unknown command specifier is aborted by 05040001h.",
)
def unknown_command(examiner: Examiner) -> None:
    """Unknown command."""
    examiner.refuse(lambda: examiner.request(b"\xe0"), "command specifier 7", AbortCode.COMMAND)
    alive(examiner)


@case(
    "SDO-11",
    "7.2.4.3.17: an abort ends the transfer and is not answered.",
)
def client_abort(examiner: Examiner) -> None:
    """Abort by the client."""
    entry = _long(examiner)
    where = address(entry.index, entry.subindex)
    examiner.request(b"\x40" + where)
    examiner.sdo_send(b"\x80" + where + AbortCode.GENERAL.to_bytes(4, "little"))
    examiner.silence(SDO_TX_ID + examiner.node_id, "answer to an abort")
    examiner.refuse(
        lambda: examiner.request(b"\x60"), "segment request after the abort", AbortCode.COMMAND
    )
    alive(examiner)


@case(
    "SDO-12",
    "7.2.4.3: an initiate request is served while an abandoned transfer is open.",
)
def abandoned_transfer(examiner: Examiner) -> None:
    """A new transfer after one left behind."""
    entry = _long(examiner)
    examiner.request(b"\x40" + address(entry.index, entry.subindex))
    alive(examiner)


@case(
    "SDO-13",
    "7.2.4.3.17: a server that waits in vain gives up, by 05040000h or in silence.",
)
def transfer_time_out(examiner: Examiner) -> None:
    """Time-out of a transfer left behind."""
    entry = _long(examiner)
    examiner.request(b"\x40" + address(entry.index, entry.subindex))
    try:
        examiner.sdo_response(SERVER_TIME_OUT_S)
    except Abort as abort:
        if abort.code != AbortCode.TIME_OUT:
            raise Failure(f"the transfer ended with {abort}") from None
    except Failure:
        pass
    else:
        raise Failure("the server goes on without a request")
    alive(examiner)
