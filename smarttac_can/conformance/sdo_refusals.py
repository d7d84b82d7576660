"""SDO: what a server must refuse, and frames that are no SDO."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure, NotApplicable, case
from smarttac_can.conformance.probe import Probe
from smarttac_can.conformance.sdo import number_entry, other_value_of, read_back
from smarttac_can.conformance.sdo_client import (
    address,
    confirm,
    download,
    download_segments,
    upload,
)
from smarttac_can.conformance.sheet import needs_number
from smarttac_can.od.cia import DEVICE_TYPE, LAST_SUBINDEX, SDO_RX_ID, SDO_TX_ID, AbortCode

_LENGTH_CODES = (AbortCode.LENGTH, AbortCode.TOO_LONG, AbortCode.TOO_SHORT)


def _absent_index(probe: Probe) -> int:
    objects = probe.sheet.od.objects
    first = min(objects)
    return next(index for index in range(first, first + len(objects) + 1) if index not in objects)


def _absent_subindex(probe: Probe) -> tuple[int, int]:
    item = next(i for i in probe.sheet.od.objects.values() if max(i.entries) < LAST_SUBINDEX)
    return item.index, max(item.entries) + 1


@case(
    "SDO-14",
    "Table 22: reading and writing are aborted by 06020000h.",
)
def no_object(probe: Probe) -> None:
    """Access to an object that does not exist."""
    index = _absent_index(probe)
    where = f"{index:04X}h"
    code = AbortCode.NO_OBJECT
    probe.refuse(lambda: upload(probe, index), f"reading {where}", code)
    probe.refuse(lambda: download(probe, index, 0, b"\0"), f"writing {where}", code)


@case(
    "SDO-15",
    "Table 22: reading and writing are aborted by 06090011h.",
)
def no_subindex(probe: Probe) -> None:
    """Access to a sub-index that does not exist."""
    index, subindex = _absent_subindex(probe)
    where = f"{index:04X}h:{subindex:02X}"
    code = AbortCode.NO_SUBINDEX
    probe.refuse(lambda: upload(probe, index, subindex), f"reading {where}", code)
    probe.refuse(lambda: download(probe, index, subindex, b"\0"), f"writing {where}", code)


@case("SDO-16", "Table 22: it is aborted by 06010002h.")
def write_read_only(probe: Probe) -> None:
    """Write to a read-only entry."""
    entry = probe.sheet.od.entry(DEVICE_TYPE)
    probe.refuse(
        lambda: download(probe, entry.index, 0, bytes(entry.size)),
        "writing the device type",
        AbortCode.READ_ONLY,
    )


@case("SDO-17", "Table 22: it is aborted by 06010001h.")
def read_write_only(probe: Probe) -> None:
    """Read of a write-only entry."""
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
    "Table 22: more bytes than the entry has are aborted by 06070012h or 06070010h.",
    needs_number,
)
def too_long(probe: Probe) -> None:
    """Too many bytes."""
    entry = number_entry(probe)
    before = upload(probe, entry.index, entry.subindex)
    probe.refuse(
        lambda: download_segments(probe, entry.index, entry.subindex, before + b"\0"),
        f"5 bytes to {entry.name}",
        *_LENGTH_CODES,
    )
    read_back(probe, entry, before)


@case(
    "SDO-19",
    "Table 22: fewer bytes than the entry has are aborted by 06070013h or 06070010h.",
    needs_number,
)
def too_short(probe: Probe) -> None:
    """Too few bytes."""
    entry = number_entry(probe)
    before = upload(probe, entry.index, entry.subindex)
    probe.refuse(
        lambda: download(probe, entry.index, entry.subindex, other_value_of(before)[:2]),
        f"2 bytes to {entry.name}",
        *_LENGTH_CODES,
    )
    read_back(probe, entry, before)


@case(
    "SDO-20",
    "7.2.4.3.4: fewer bytes than announced are aborted; nothing is written.",
    needs_number,
)
def size_not_kept(probe: Probe) -> None:
    """Announced size not kept."""
    entry = number_entry(probe)
    where = address(entry.index, entry.subindex)
    before = upload(probe, entry.index, entry.subindex)
    confirm(probe.request(b"\x21" + where + b"\x04"), where)
    segment = b"\x0b" + other_value_of(before)[:2]
    probe.refuse(lambda: probe.request(segment), "2 bytes where 4 were announced", *_LENGTH_CODES)
    read_back(probe, entry, before)


@case(
    "SDO-21",
    "7.2.4.3: an SDO has 8 bytes; shorter frames and remote frames change nothing.",
    needs_number,
)
def no_sdo(probe: Probe) -> None:
    """Frames that are no SDO."""
    entry = number_entry(probe)
    before = upload(probe, entry.index, entry.subindex)
    can_id = SDO_RX_ID + probe.node_id
    probe.send(can_id, b"\x23" + address(entry.index, entry.subindex) + other_value_of(before)[:3])
    probe.send(can_id)
    probe.send(can_id, rtr=True)
    probe.settle()
    read_back(probe, entry, before)


@case(
    "SDO-22",
    "7.2.4.3.17: an abort names the index and sub-index of the request.",
)
def abort_names_entry(probe: Probe) -> None:
    """Multiplexer in an abort."""
    where = address(_absent_index(probe), 3)
    probe.drain()
    probe.sdo_send(b"\x40" + where)
    data = probe.expect(SDO_TX_ID + probe.node_id, "SDO response").data
    if data[:4] != b"\x80" + where:
        raise Failure(f"request {where.hex(' ')} aborted by {data.hex(' ')}")
