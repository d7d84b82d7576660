"""The object dictionary: every object of the EDS, its access, default, limits and write-back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress

from smarttac_can.canopen.conformance import refusals
from smarttac_can.canopen.conformance.case import COMMANDS, Failure, Group, NotApplicable, case
from smarttac_can.canopen.conformance.examiner import Examiner, download, upload
from smarttac_can.canopen.od.cia import (
    COMMUNICATION_LAST,
    ERROR_FIELD,
    Abort,
    AbortCode,
    DataType,
    ObjectType,
)
from smarttac_can.canopen.od.data_types import REAL, SIGNED, SIZES, UNSIGNED, bounds, pack
from smarttac_can.canopen.od.entry import Entry

_SHOWN = 3
_SHOWN_BYTES = 16
_STRUCTURE = 0xFF
_BY_STATE = (AbortCode.LOCAL_CONTROL, AbortCode.STATE)
"""Aborts of an entry that takes values, but not in the present state of the device."""
_ORDERED = {*SIGNED, *UNSIGNED, *REAL}


def report(faults: list[str], count: int) -> None:
    """Raise `Failure` with the first few of the faults, if any."""
    if faults:
        more = f" and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
        raise Failure(f"{len(faults)} of {count}: {'; '.join(faults[:_SHOWN])}{more}")


def where(entry: Entry) -> str:
    """Return index and sub-index of an entry as text."""
    return f"{entry.index:04X}h:{entry.subindex:02X}"


def _hex(data: bytes) -> str:
    more = f" ... ({len(data)} bytes)" if len(data) > _SHOWN_BYTES else ""
    return data[:_SHOWN_BYTES].hex(" ") + more


def _readable(examiner: Examiner) -> list[Entry]:
    sheet = examiner.sheet
    return [e for e in sheet.od if e.readable and e.index not in COMMANDS and sheet.scans_read(e)]


def _read(examiner: Examiner, entry: Entry) -> bytes | None:
    """Read the bytes of an entry; None if the device has no data for it now."""
    try:
        return upload(examiner, entry.index, entry.subindex)
    except Abort as abort:
        if abort.code == AbortCode.NO_DATA:
            return None
        raise


def _values(examiner: Examiner, entries: Iterable[Entry]) -> Iterator[tuple[Entry, bytes]]:
    """Read entries, and yield the bytes of each one that the device does not refuse."""
    for entry in entries:
        with suppress(Abort):
            yield entry, upload(examiner, entry.index, entry.subindex)


@contextmanager
def _refused(
    examiner: Examiner, entry: Entry, faults: list[str], refusal: refusals.Refusal
) -> Iterator[None]:
    """Add to the faults what is wrong with the refusal of an access to an entry in the block."""
    try:
        with examiner.refused(where(entry), refusal):
            yield
    except Failure as failure:
        faults.append(str(failure))


_od = Group("OD")


@case(_od, 1, "7.4.1: each readable entry of the EDS can be read.")
def every_object(examiner: Examiner) -> None:
    """Every object exists."""
    entries, faults = _readable(examiner), []
    for entry in entries:
        try:
            _read(examiner, entry)
        except Abort as abort:
            faults.append(f"{where(entry)} {abort}")
    report(faults, len(entries))


@case(_od, 2, "7.1: each value is as long as its data type.")
def lengths(examiner: Examiner) -> None:
    """Length by data type."""
    entries = _readable(examiner)
    faults = [
        f"{where(entry)} has {len(data)} bytes, {entry.data_type.name}"
        for entry, data in _values(examiner, entries)
        if entry.size and len(data) != entry.size
    ]
    report(faults, len(entries))


@case(
    _od, 3, "CiA 306, 4.6: constants and parameters, not process data, have the EDS's DefaultValue."
)
def defaults(examiner: Examiner) -> None:
    """Values after a reset."""
    entries = [
        entry
        for entry in _readable(examiner)
        if entry.access in ("const", "rw")
        and not entry.pdo
        and examiner.sheet.states_default(entry)
    ]
    faults = [
        f"{where(entry)} is {_hex(data)}, the EDS says {_hex(wanted)}"
        for entry, data in _values(examiner, entries)
        if data != (wanted := pack(entry.data_type, entry.default))
    ]
    report(faults, len(entries))


@case(_od, 4, "Table 22: writing any of them is aborted by 06010002h.")
def read_only(examiner: Examiner) -> None:
    """Read-only entries."""
    entries = [e for e in examiner.sheet.od if not e.writable and examiner.sheet.scans_write(e)]
    faults: list[str] = []
    for entry in entries:
        with _refused(examiner, entry, faults, refusals.READ_ONLY):
            download(examiner, entry.index, entry.subindex, bytes(entry.size or 1))
    report(faults, len(entries))


@case(_od, 5, "Table 22: reading any of them is aborted by 06010001h.")
def write_only(examiner: Examiner) -> None:
    """Write-only entries."""
    entries = [e for e in examiner.sheet.od if not e.readable and examiner.sheet.scans_read(e)]
    if not entries:
        raise NotApplicable("the EDS has no write-only entry")
    faults: list[str] = []
    for entry in entries:
        with _refused(examiner, entry, faults, refusals.WRITE_ONLY):
            upload(examiner, entry.index, entry.subindex)
    report(faults, len(entries))


def _beyond(entry: Entry) -> Iterator[bytes]:
    """Yield the values just outside the limits that the data type can represent."""
    low, high = bounds(entry.data_type)
    for value, possible in ((entry.low - 1, entry.low > low), (entry.high + 1, entry.high < high)):
        if possible:
            yield pack(entry.data_type, value)


@case(_od, 6, "CiA 306, 4.6 and table 22: beyond LowLimit and HighLimit 06090030h, 31h or 32h.")
def limits(examiner: Examiner) -> None:
    """Limits."""
    entries = [
        e
        for e in examiner.sheet.od
        if e.data_type in _ORDERED
        and e.writable
        and e.index not in COMMANDS
        and (e.low, e.high) != bounds(e.data_type)
        and examiner.sheet.scans_write(e)
    ]
    if not entries:
        raise NotApplicable("the EDS has no writable entry with limits")
    faults: list[str] = []
    for entry in entries:
        for data in _beyond(entry):
            with _refused(examiner, entry, faults, refusals.OUT_OF_RANGE):
                download(examiner, entry.index, entry.subindex, data)
    report(faults, len(entries))


@case(
    _od,
    7,
    "CiA 306, 4.6: each rw entry above 1FFFh takes its own value back, unless ObjFlags refuse it.",
)
def write_back(examiner: Examiner) -> None:
    """Write-back."""
    # The entries of communication have procedures of their own, which other cases examine.
    entries = [
        e
        for e in _readable(examiner)
        if e.index > COMMUNICATION_LAST
        and e.writable
        and e.data_type != DataType.DOMAIN
        and examiner.sheet.scans_write(e)
    ]
    if not entries:
        raise NotApplicable("the EDS has no rw entry above 1FFFh that a scan may write")
    faults: list[str] = []
    for entry in entries:
        try:
            data = _read(examiner, entry)
            if data is not None:
                download(examiner, entry.index, entry.subindex, data)
        except Abort as abort:
            found = examiner.remarks if abort.code in _BY_STATE else faults
            found.append(f"{where(entry)} {abort}")
    report(faults, len(entries))


@case(_od, 8, "7.4.5: sub-index 0 of arrays and records is the highest one; none beyond it exists.")
def highest_subindex(examiner: Examiner) -> None:
    """Highest sub-index."""
    mapping_or_history = [ERROR_FIELD] + [
        p.mapping for p in examiner.sheet.tpdos + examiner.sheet.rpdos
    ]
    objects = [
        item
        for item in examiner.sheet.od.objects.values()
        if item.object_type in (ObjectType.ARRAY, ObjectType.RECORD)
        and item.index not in mapping_or_history
        and 0 in item.entries
    ]
    faults = []
    for item in objects:
        highest = max(item.entries)
        try:
            data = upload(examiner, item.index, 0)
        except Abort as abort:
            faults.append(f"{item.index:04X}h:00 {abort}")
            continue
        if data[0] != highest:
            faults.append(f"{item.index:04X}h:00 is {data[0]}, the highest is {highest}")
    report(faults, len(objects))


@case(_od, 9, "7.4.7.2: it gives data type and object code, or does not exist (06090011h).")
def structure(examiner: Examiner) -> None:
    """Sub-index FFh."""
    objects = [
        item
        for item in examiner.sheet.od.objects.values()
        if _STRUCTURE not in item.entries
        and examiner.sheet.scans_read(next(iter(item.entries.values())))
    ]
    faults = []
    for item in objects:
        try:
            data = upload(examiner, item.index, _STRUCTURE)
        except Abort as abort:
            if abort.code not in refusals.NO_STRUCTURE.codes:
                examiner.remarks.append(f"{item.index:04X}h:FF {abort}")
            continue
        if len(data) != SIZES[DataType.UNSIGNED32] or data[0] != item.object_type:
            faults.append(f"{item.index:04X}h:FF is {data.hex(' ')}, {item.object_type.name}")
    report(faults, len(objects))
