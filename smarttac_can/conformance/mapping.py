"""PDO mapping: the defaults, and the procedure to change it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from smarttac_can.conformance.case import Failure, NotApplicable, case
from smarttac_can.conformance.pdo_setup import (
    can_id,
    configure,
    content,
    disable,
    enable,
    operational,
)
from smarttac_can.conformance.probe import Probe
from smarttac_can.conformance.sdo_client import number, upload, write_number
from smarttac_can.conformance.sheet import Pdo, needs_mapping, needs_object
from smarttac_can.od.cia import FRAME_BYTES, SYNC_COB_ID, AbortCode, DataType
from smarttac_can.od.data_types import SIZES
from smarttac_can.od.dictionary import Entry

_BITS = 64
_PROCEDURE = "7.5.2.38: disable, number 0, entries, number, enable"
_REFUSED = (AbortCode.NOT_MAPPABLE,)
_TOO_MUCH = (AbortCode.PDO_LENGTH, AbortCode.NOT_MAPPABLE, AbortCode.VALUE, AbortCode.TOO_HIGH)


def _pdo(probe: Probe) -> Pdo:
    return probe.sheet.mappable(probe.sheet.tpdos)[0]


def _parameter(entry: Entry) -> int:
    return entry.index << 16 | entry.subindex << 8 | 8 * entry.size


def _mappable(probe: Probe) -> list[Entry]:
    """Find the entries of whole bytes that a TPDO may carry, the longest first."""
    found = (e for e in probe.sheet.od if e.tpdo_mappable and e.size and e.readable)
    whole = (e for e in found if e.data_type != DataType.BOOLEAN and e.size <= FRAME_BYTES)
    return sorted(whole, key=lambda entry: -entry.size)


def _open(probe: Probe, pdo: Pdo) -> int:
    """Disable a PDO and set its number of entries to 0; return its COB-ID."""
    cob_id = disable(probe, pdo)
    write_number(probe, pdo.mapping, 0, 0)
    return cob_id


def _map(probe: Probe, pdo: Pdo, parameters: list[int]) -> None:
    for subindex, parameter in enumerate(parameters, 1):
        write_number(probe, pdo.mapping, subindex, parameter)
    write_number(probe, pdo.mapping, 0, len(parameters))


def _all_pdos(probe: Probe) -> Iterator[tuple[Pdo, Callable[[Entry], bool], str]]:
    for pdo in probe.sheet.tpdos:
        yield pdo, lambda entry: entry.tpdo_mappable, "TPDO"
    for pdo in probe.sheet.rpdos:
        yield pdo, lambda entry: entry.rpdo_mappable, "RPDO"


def _has_pdos(sheet: object) -> str | None:
    pdos = [*getattr(sheet, "tpdos", ()), *getattr(sheet, "rpdos", ())]
    return None if pdos else "the EDS has no PDO"


@case(
    "PDO-26",
    "7.5.2.36, .38: each entry exists, may be mapped in that direction, and all fit 64 bits.",
    _has_pdos,
)
def default_mapping(probe: Probe) -> None:
    """Default mapping."""
    od = probe.sheet.od
    for pdo, allowed, kind in _all_pdos(probe):
        count = number(probe, pdo.mapping)
        bits = 0
        for subindex in range(1, count + 1):
            value = number(probe, pdo.mapping, subindex)
            bits += value & 0xFF
            entry = od.get(value >> 16, value >> 8 & 0xFF)
            where = f"{pdo.mapping:04X}h:{subindex:02X} = {value:08X}h"
            if entry is None:
                if value >> 16 not in od.dummies or kind == "TPDO":
                    raise Failure(f"{where} maps what does not exist")
            elif not allowed(entry):
                raise Failure(f"{where} maps what no {kind} may carry")
            elif entry.size and value & 0xFF != 8 * entry.size and entry.size > 1:
                raise Failure(f"{where} has the wrong length")
        if bits > _BITS:
            raise Failure(f"{pdo.mapping:04X}h maps {bits} bits")
        if count != od.number(pdo.mapping):
            raise Failure(f"{pdo.mapping:04X}h maps {count} entries, not as the EDS says")


@case(
    "PDO-27",
    f"{_PROCEDURE}; the PDO then carries the new entries.",
    needs_mapping,
    needs_object(SYNC_COB_ID),
)
def remap(probe: Probe) -> None:
    """Mapping changed by the procedure."""
    pdo = _pdo(probe)
    cob_id = _open(probe, pdo)
    parameters = [_parameter(_mappable(probe)[-1])] * 2
    if not probe.sheet.has(pdo.mapping, 2):
        parameters.pop()
    _map(probe, pdo, parameters)
    enable(probe, pdo, cob_id)
    if number(probe, pdo.mapping) != len(parameters):
        raise Failure("the number of entries does not read as written")
    configure(probe, pdo, 1)
    operational(probe)
    probe.sync()
    data = probe.expect(can_id(probe, pdo), "TPDO at SYNC").data
    if len(data) != len(content(probe, parameters)):
        raise Failure(f"TPDO of {len(data)} bytes after mapping {len(parameters)} entries anew")


@case(
    "PDO-28",
    f"{_PROCEDURE}; a valid PDO, or one whose number is not 0, refuses.",
    needs_mapping,
)
def remap_out_of_order(probe: Probe) -> None:
    """Mapping changed without the procedure."""
    pdo = _pdo(probe)
    enable(probe, pdo, disable(probe, pdo))
    other = next(
        (p for e in _mappable(probe) if (p := _parameter(e)) != number(probe, pdo.mapping, 1)),
        None,
    )
    if other is None:
        raise NotApplicable("the EDS has one mappable entry only")

    def write() -> None:
        write_number(probe, pdo.mapping, 1, other)

    probe.refuse(lambda: write_number(probe, pdo.mapping, 0, 0), "number 0 of a valid PDO")
    probe.refuse(write, "new entry of a valid PDO")
    disable(probe, pdo)
    probe.refuse(write, "new entry while the number is not 0")


@case("PDO-29", "7.5.2.38: a number beyond the sub-indices.", needs_mapping)
def too_many(probe: Probe) -> None:
    """Too many entries."""
    pdo = _pdo(probe)
    _open(probe, pdo)
    most = max(probe.sheet.od.objects[pdo.mapping].entries)
    probe.refuse(
        lambda: write_number(probe, pdo.mapping, 0, most + 1),
        f"{most + 1} entries in a mapping of {most}",
        *_TOO_MUCH,
    )


@case("PDO-30", "7.5.2.38: more than 64 bits by 06040042h.", needs_mapping)
def too_many_bits(probe: Probe) -> None:
    """Too many bits."""
    pdo = _pdo(probe)
    longest = _mappable(probe)[0]
    count = _BITS // (8 * longest.size) + 1
    if not probe.sheet.has(pdo.mapping, count):
        raise NotApplicable("the mapping has too few sub-indices for more than 64 bits")
    _open(probe, pdo)
    probe.refuse(
        lambda: _map(probe, pdo, [_parameter(longest)] * count),
        f"{count} entries of {longest.size} bytes",
        AbortCode.PDO_LENGTH,
        AbortCode.NOT_MAPPABLE,
    )


@case(
    "PDO-31",
    "7.5.2.38: missing ones by 06020000h or 06040041h, PDOMapping=0 by 06040041h.",
    needs_mapping,
)
def not_mappable(probe: Probe) -> None:
    """Entries that cannot be mapped."""
    pdo = _pdo(probe)
    _open(probe, pdo)
    absent = next(i for i in range(0xFFFF, 0, -1) if i not in probe.sheet.od.objects)
    probe.refuse(
        lambda: _map(probe, pdo, [absent << 16 | 8]),
        f"mapping of {absent:04X}h",
        AbortCode.NO_OBJECT,
        AbortCode.NOT_MAPPABLE,
    )
    plain = next((e for e in probe.sheet.od if not e.pdo and e.size and e.readable), None)
    if plain is not None:
        write_number(probe, pdo.mapping, 0, 0)
        probe.refuse(
            lambda: _map(probe, pdo, [_parameter(plain)]), f"mapping of {plain.name}", *_REFUSED
        )


@case(
    "PDO-32",
    "CiA 306, 4.6: wo and rww only in RPDOs, ro, const and rwr only in TPDOs.",
    needs_mapping,
)
def direction(probe: Probe) -> None:
    """Direction by access."""
    asked = 0
    for pdos, name, kinds in (
        (probe.sheet.tpdos, "TPDO", ("wo", "rww")),
        (probe.sheet.rpdos, "RPDO", ("ro", "rwr")),
    ):
        usable = probe.sheet.mappable(pdos)
        if not usable:
            continue
        _open(probe, usable[0])
        for kind in kinds:
            entry = next((e for e in probe.sheet.od if e.pdo and e.access == kind), None)
            if entry is not None:
                asked += 1
                parameter = _parameter(entry)
                write_number(probe, usable[0].mapping, 0, 0)
                probe.refuse(
                    partial(_map, probe, usable[0], [parameter]),
                    f"{kind} entry {entry.name} in a {name}",
                    *_REFUSED,
                )
    if not asked:
        raise NotApplicable("the EDS has no mappable entry of one direction only")


@case(
    "PDO-33",
    "7.4.7.3 and CiA 306, 4.6.2: an RPDO takes those of [DummyUsage], a TPDO takes none.",
    needs_mapping,
)
def dummies(probe: Probe) -> None:
    """Dummies."""
    usable = probe.sheet.mappable(probe.sheet.rpdos)
    dummies_of_bytes = probe.sheet.od.dummies - {DataType.BOOLEAN}
    if not usable or not dummies_of_bytes:
        raise NotApplicable("the EDS has no RPDO with a writable mapping, or no dummies")
    dummy = min(dummies_of_bytes)
    parameter = dummy << 16 | 8 * SIZES[dummy]
    cob_id = _open(probe, usable[0])
    _map(probe, usable[0], [parameter])
    enable(probe, usable[0], cob_id)
    if upload(probe, usable[0].mapping, 1) != parameter.to_bytes(4, "little"):
        raise Failure("the dummy does not read as written")
    pdo = _pdo(probe)
    _open(probe, pdo)
    probe.refuse(
        lambda: _map(probe, pdo, [parameter]), "dummy in a TPDO", AbortCode.NO_OBJECT, *_REFUSED
    )
