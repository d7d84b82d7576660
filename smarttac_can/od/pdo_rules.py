"""Rules for the PDOs of an EDS: every default mapping resolves, fits, and goes the right way."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from smarttac_can.od import cia
from smarttac_can.od.cia import DataType
from smarttac_can.od.data_types import SIZES
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.od.finding import Finding

_BITS: Final = 64
_MOST_ENTRIES: Final = 64
_MULTIPLEXED: Final = (254, 255)
"""Numbers of mapped objects that make a multiplexed PDO, which maps nothing itself."""
_KINDS: Final = (
    ("RPDO", cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING),
    ("TPDO", cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING),
)


def check_pdos(od: ObjectDictionary) -> Iterator[Finding]:
    """Check the parameters of all PDOs, and the objects that they need."""
    used: dict[int, str] = {}
    synchronous = False
    for kind, communication, mapping in _KINDS:
        for number in range(cia.PDO_COUNT):
            index, mapped = communication + number, mapping + number
            if index in od.objects:
                yield from _check_communication(od, kind, index, used)
                transmission = od.number(index, cia.PDO_TRANSMISSION)
                synchronous |= transmission <= cia.CYCLIC_LAST
                if mapped not in od.objects:
                    yield Finding(f"{index:04x}", f"there is no mapping {mapped:04X}h")
            if mapped in od.objects:
                if index not in od.objects:
                    yield Finding(f"{mapped:04x}", f"there is no {kind} {index:04X}h")
                yield from _check_mapping(od, kind, mapped)
    if synchronous and cia.SYNC_COB_ID not in od.objects:
        yield Finding("", f"a PDO is synchronous, but there is no SYNC {cia.SYNC_COB_ID:04X}h")


def _check_communication(
    od: ObjectDictionary, kind: str, index: int, used: dict[int, str]
) -> Iterator[Finding]:
    for subindex in (cia.PDO_COB_ID, cia.PDO_TRANSMISSION):
        if od.get(index, subindex) is None:
            yield Finding(f"{index:04x}", f"sub-index {subindex} of this {kind} is missing")
            return
    last_reserved = cia.RTR_EVENT if kind == "RPDO" else cia.RTR_SYNC - 1
    transmission = od.number(index, cia.PDO_TRANSMISSION)
    if cia.CYCLIC_LAST < transmission <= last_reserved:
        section = f"{index:04x}sub{cia.PDO_TRANSMISSION}"
        yield Finding(section, f"transmission type {transmission} of this {kind} is reserved")
    section = f"{index:04x}sub{cia.PDO_COB_ID}"
    cob_id = od.number(index, cia.PDO_COB_ID)
    if cob_id & cia.COB_INVALID:
        return
    can_id = cob_id & cia.CAN_ID_MASK
    if cob_id & cia.COB_EXTENDED:
        yield Finding(section, "the CAN-ID has 29 bits", error=False)
    elif cia.restricted(can_id):
        yield Finding(section, f"CAN-ID {can_id:03X}h is restricted")
    elif can_id in used:
        yield Finding(section, f"CAN-ID {can_id:03X}h is also that of [{used[can_id]}]")
    used[can_id] = f"{index:04X}"


def _check_mapping(od: ObjectDictionary, kind: str, mapped: int) -> Iterator[Finding]:
    count = od.number(mapped)
    if count in _MULTIPLEXED:
        return
    if count > _MOST_ENTRIES:
        yield Finding(f"{mapped:04x}sub0", f"maps {count} objects, more than {_MOST_ENTRIES}")
        return
    total = 0
    for position in range(1, count + 1):
        section = f"{mapped:04x}sub{position:x}"
        if od.get(mapped, position) is None:
            yield Finding(f"{mapped:04x}", f"maps {count}, but has no sub-index {position}")
            return
        value = od.number(mapped, position)
        total += value & 0xFF
        if message := _mapping_fault(od, kind, value):
            yield Finding(section, message)
    if total > _BITS:
        yield Finding(f"{mapped:04x}", f"maps {total} bit, more than {_BITS}")


def _mapping_fault(od: ObjectDictionary, kind: str, value: int) -> str:
    """Return what is wrong with a mapping parameter; empty if nothing."""
    index, subindex, bits = value >> 16, value >> 8 & 0xFF, value & 0xFF
    where = f"{index:04X}h sub-index {subindex}"
    entry = od.get(index, subindex)
    if entry is None:
        named = index in SIZES and subindex == 0
        return _dummy_fault(od, kind, index, bits) if named else f"maps {where}, which is not there"
    if not entry.pdo:
        return f"maps {where}, which has PDOMapping=0"
    if not (entry.tpdo_mappable if kind == "TPDO" else entry.rpdo_mappable):
        return f"maps {where} into this {kind}, but it is {entry.access}"
    return "" if _fits(entry, bits) else f"maps {bits} bit of {where}, a {entry.data_type.name}"


def _dummy_fault(od: ObjectDictionary, kind: str, index: int, bits: int) -> str:
    if kind == "TPDO":
        return f"maps the dummy {index:04X}h into this TPDO"
    if index not in od.dummies:
        return f"maps the dummy {index:04X}h, which DummyUsage does not allow"
    return "" if bits == 8 * SIZES[index] else f"maps {bits} bit of the dummy {index:04X}h"


def _fits(entry: Entry, bits: int) -> bool:
    if entry.data_type is DataType.BOOLEAN:
        return bits in (1, 8)
    return bits == 8 * entry.size if entry.size else bits > 0 and bits % 8 == 0
