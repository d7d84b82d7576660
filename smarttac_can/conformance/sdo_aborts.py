"""SDO: what a server must refuse, and frames that are no SDO."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure, NotApplicable, case
from smarttac_can.conformance.description import needs_number
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.sdo import number_entry, other_value_of, read_back
from smarttac_can.conformance.sdo_client import (
    address,
    confirm,
    download,
    download_segments,
    upload,
)
from smarttac_can.od.cia import DEVICE_TYPE, LAST_SUBINDEX, SDO_RX_ID, SDO_TX_ID, AbortCode

_LENGTH_CODES = (AbortCode.LENGTH, AbortCode.TOO_LONG, AbortCode.TOO_SHORT)


def _absent_index(examiner: Examiner) -> int:
    objects = examiner.sheet.od.objects
    first = min(objects)
    return next(index for index in range(first, first + len(objects) + 1) if index not in objects)


def _absent_subindex(examiner: Examiner) -> tuple[int, int]:
    item = next(i for i in examiner.sheet.od.objects.values() if max(i.entries) < LAST_SUBINDEX)
    return item.index, max(item.entries) + 1


@case(
    "SDO-14",
    "Table 22: reading and writing are aborted by 06020000h.",
)
def no_object(examiner: Examiner) -> None:
    """Access to an object that does not exist."""
    index = _absent_index(examiner)
    where = f"{index:04X}h"
    code = AbortCode.NO_OBJECT
    examiner.refuse(lambda: upload(examiner, index), f"reading {where}", code)
    examiner.refuse(lambda: download(examiner, index, 0, b"\0"), f"writing {where}", code)


@case(
    "SDO-15",
    "Table 22: reading and writing are aborted by 06090011h.",
)
def no_subindex(examiner: Examiner) -> None:
    """Access to a sub-index that does not exist."""
    index, subindex = _absent_subindex(examiner)
    where = f"{index:04X}h:{subindex:02X}"
    code = AbortCode.NO_SUBINDEX
    examiner.refuse(lambda: upload(examiner, index, subindex), f"reading {where}", code)
    examiner.refuse(lambda: download(examiner, index, subindex, b"\0"), f"writing {where}", code)


@case("SDO-16", "Table 22: it is aborted by 06010002h.")
def write_read_only(examiner: Examiner) -> None:
    """Write to a read-only entry."""
    entry = examiner.sheet.od.entry(DEVICE_TYPE)
    examiner.refuse(
        lambda: download(examiner, entry.index, 0, bytes(entry.size)),
        "writing the device type",
        AbortCode.READ_ONLY,
    )


@case("SDO-17", "Table 22: it is aborted by 06010001h.")
def read_write_only(examiner: Examiner) -> None:
    """Read of a write-only entry."""
    entry = next((e for e in examiner.sheet.od if e.access == "wo" and e.size), None)
    if entry is None:
        raise NotApplicable("the EDS has no write-only entry")
    examiner.refuse(
        lambda: upload(examiner, entry.index, entry.subindex),
        f"reading {entry.name}",
        AbortCode.WRITE_ONLY,
    )


@case(
    "SDO-18",
    "Table 22: more bytes than the entry has are aborted by 06070012h or 06070010h.",
    needs_number,
)
def too_long(examiner: Examiner) -> None:
    """Too many bytes."""
    entry = number_entry(examiner)
    before = upload(examiner, entry.index, entry.subindex)
    examiner.refuse(
        lambda: download_segments(examiner, entry.index, entry.subindex, before + b"\0"),
        f"5 bytes to {entry.name}",
        *_LENGTH_CODES,
    )
    read_back(examiner, entry, before)


@case(
    "SDO-19",
    "Table 22: fewer bytes than the entry has are aborted by 06070013h or 06070010h.",
    needs_number,
)
def too_short(examiner: Examiner) -> None:
    """Too few bytes."""
    entry = number_entry(examiner)
    before = upload(examiner, entry.index, entry.subindex)
    examiner.refuse(
        lambda: download(examiner, entry.index, entry.subindex, other_value_of(before)[:2]),
        f"2 bytes to {entry.name}",
        *_LENGTH_CODES,
    )
    read_back(examiner, entry, before)


@case(
    "SDO-20",
    "7.2.4.3.4: fewer bytes than announced are aborted; nothing is written.",
    needs_number,
)
def size_not_kept(examiner: Examiner) -> None:
    """Announced size not kept."""
    entry = number_entry(examiner)
    where = address(entry.index, entry.subindex)
    before = upload(examiner, entry.index, entry.subindex)
    confirm(examiner.request(b"\x21" + where + b"\x04"), where)
    segment = b"\x0b" + other_value_of(before)[:2]
    examiner.refuse(
        lambda: examiner.request(segment), "2 bytes where 4 were announced", *_LENGTH_CODES
    )
    read_back(examiner, entry, before)


@case(
    "SDO-21",
    "7.2.4.3: an SDO has 8 bytes; shorter frames and remote frames change nothing.",
    needs_number,
)
def no_sdo(examiner: Examiner) -> None:
    """Frames that are no SDO."""
    entry = number_entry(examiner)
    before = upload(examiner, entry.index, entry.subindex)
    can_id = SDO_RX_ID + examiner.node_id
    examiner.send(
        can_id, b"\x23" + address(entry.index, entry.subindex) + other_value_of(before)[:3]
    )
    examiner.send(can_id)
    examiner.send(can_id, rtr=True)
    examiner.settle()
    read_back(examiner, entry, before)


@case(
    "SDO-22",
    "7.2.4.3.17: an abort names the index and sub-index of the request.",
)
def abort_names_entry(examiner: Examiner) -> None:
    """Multiplexer in an abort."""
    where = address(_absent_index(examiner), 3)
    examiner.drain()
    examiner.sdo_send(b"\x40" + where)
    data = examiner.expect(SDO_TX_ID + examiner.node_id, "SDO response").data
    if data[:4] != b"\x80" + where:
        raise Failure(f"request {where.hex(' ')} aborted by {data.hex(' ')}")
