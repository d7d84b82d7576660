"""The object dictionary: every object of the EDS, its access, default, limits and write-back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from smarttac_can.conformance.case import COMMANDS, Failure, NotApplicable, case
from smarttac_can.conformance.examiner import OUT_OF_RANGE, Examiner, download, upload
from smarttac_can.od.cia import ERROR_FIELD, Abort, AbortCode, DataType, ObjectType
from smarttac_can.od.data_types import REAL, SIGNED, SIZES, UNSIGNED, bounds, pack
from smarttac_can.od.entry import Entry

_SHOWN = 3
_STRUCTURE = 0xFF
_ORDERED = {*SIGNED, *UNSIGNED, *REAL}


def report(faults: list[str], count: int) -> None:
    """Raise `Failure` with the first few of the faults, if any."""
    if faults:
        more = f" and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
        raise Failure(f"{len(faults)} of {count}: {'; '.join(faults[:_SHOWN])}{more}")


def where(entry: Entry) -> str:
    """Return index and sub-index of an entry as text."""
    return f"{entry.index:04X}h:{entry.subindex:02X}"


def _readable(examiner: Examiner) -> list[Entry]:
    return [e for e in examiner.sheet.od if e.readable and e.index not in COMMANDS]


def _read(examiner: Examiner, entry: Entry) -> bytes | None:
    """Read the bytes of an entry; None if the device has no data for it now."""
    try:
        return upload(examiner, entry.index, entry.subindex)
    except Abort as abort:
        if abort.code == AbortCode.NO_DATA:
            return None
        raise


@case("OD-01", "7.4.1: each readable entry of the EDS can be read.")
def every_object(examiner: Examiner) -> None:
    """Every object exists."""
    entries, faults = _readable(examiner), []
    for entry in entries:
        try:
            _read(examiner, entry)
        except Abort as abort:
            faults.append(f"{where(entry)} {abort}")
    report(faults, len(entries))


@case("OD-02", "7.1: each value is as long as its data type.")
def lengths(examiner: Examiner) -> None:
    """Length by data type."""
    entries, faults = _readable(examiner), []
    for entry in entries:
        try:
            data = _read(examiner, entry)
        except Abort:
            continue
        if data is not None and entry.size and len(data) != entry.size:
            faults.append(f"{where(entry)} has {len(data)} bytes, {entry.data_type.name}")
    report(faults, len(entries))


@case(
    "OD-03",
    "CiA 306, 4.6: constants and parameters, not process data, have the EDS's DefaultValue.",
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
    faults = []
    for entry in entries:
        try:
            data = _read(examiner, entry)
        except Abort:
            continue
        wanted = pack(entry.data_type, entry.default)
        if data is not None and data != wanted:
            faults.append(f"{where(entry)} is {data.hex(' ')}, the EDS says {wanted.hex(' ')}")
    report(faults, len(entries))


@case("OD-04", "Table 22: writing any of them is aborted by 06010002h.")
def read_only(examiner: Examiner) -> None:
    """Read-only entries."""
    entries = [e for e in examiner.sheet.od if not e.writable]
    faults = []
    for entry in entries:
        write = partial(download, data=bytes(entry.size or 1))
        faults += _wrong_refusal(examiner, entry, write, AbortCode.READ_ONLY)
    report(faults, len(entries))


def _wrong_refusal(
    examiner: Examiner, entry: Entry, access: Callable[..., object], *codes: AbortCode
) -> list[str]:
    """Return what is wrong with the refusal of an access to an entry, as a list."""
    try:
        examiner.refuse(lambda: access(examiner, entry.index, entry.subindex), where(entry), *codes)
    except Failure as failure:
        return [str(failure)]
    return []


@case("OD-05", "Table 22: reading any of them is aborted by 06010001h.")
def write_only(examiner: Examiner) -> None:
    """Write-only entries."""
    entries = [e for e in examiner.sheet.od if not e.readable]
    if not entries:
        raise NotApplicable("the EDS has no write-only entry")
    faults = []
    for entry in entries:
        faults += _wrong_refusal(examiner, entry, upload, AbortCode.WRITE_ONLY)
    report(faults, len(entries))


def _beyond(entry: Entry) -> Iterator[bytes]:
    """Yield the values just outside the limits that the data type can represent."""
    low, high = bounds(entry.data_type)
    for value, possible in ((entry.low - 1, entry.low > low), (entry.high + 1, entry.high < high)):
        if possible:
            yield pack(entry.data_type, value)


@case(
    "OD-06",
    "CiA 306, 4.6 and table 22: beyond LowLimit and HighLimit 06090030h, 31h or 32h.",
)
def limits(examiner: Examiner) -> None:
    """Limits."""
    entries = [
        e
        for e in examiner.sheet.od
        if e.data_type in _ORDERED
        and e.writable
        and e.index not in COMMANDS
        and (e.low, e.high) != bounds(e.data_type)
    ]
    if not entries:
        raise NotApplicable("the EDS has no writable entry with limits")
    faults = []
    for entry in entries:
        for data in _beyond(entry):
            write = partial(download, data=data)
            faults += _wrong_refusal(examiner, entry, write, *OUT_OF_RANGE)
    report(faults, len(entries))


@case(
    "OD-07",
    "A master that writes each rw entry back with its own value gets no abort, mappings apart.",
)
def write_back(examiner: Examiner) -> None:
    """Write-back."""
    mappings = [p.mapping for p in examiner.sheet.tpdos + examiner.sheet.rpdos]
    entries = [
        e
        for e in _readable(examiner)
        if e.writable
        and e.data_type != DataType.DOMAIN
        and not (e.index in mappings and e.subindex)
    ]
    faults = []
    for entry in entries:
        try:
            data = _read(examiner, entry)
            if data is not None:
                download(examiner, entry.index, entry.subindex, data)
        except Abort as abort:
            faults.append(f"{where(entry)} {abort}")
    report(faults, len(entries))


@case(
    "OD-08",
    "7.4.5: sub-index 0 of arrays and records is the highest one; none beyond it exists.",
)
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


@case(
    "OD-09",
    "7.4.7.2: it gives data type and object code, or does not exist (06090011h).",
)
def structure(examiner: Examiner) -> None:
    """Sub-index FFh."""
    objects = [i for i in examiner.sheet.od.objects.values() if _STRUCTURE not in i.entries]
    faults = []
    for item in objects:
        try:
            data = upload(examiner, item.index, _STRUCTURE)
        except Abort as abort:
            if abort.code != AbortCode.NO_SUBINDEX:
                faults.append(f"{item.index:04X}h:FF {abort}")
            continue
        if len(data) != SIZES[DataType.UNSIGNED32] or data[0] != item.object_type:
            faults.append(f"{item.index:04X}h:FF is {data.hex(' ')}, {item.object_type.name}")
    report(faults, len(objects))
