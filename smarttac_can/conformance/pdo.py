"""Process data: PDOs set up for a case, and the cases of their mapping."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from smarttac_can.conformance.case import (
    Failure,
    NotApplicable,
    Pdo,
    case,
    needs_mapping,
    needs_sync,
)
from smarttac_can.conformance.examiner import Examiner, number, upload, write_number
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_INVALID,
    COB_NO_RTR,
    EVENT_MANUFACTURER,
    FRAME_BYTES,
    PDO_COB_ID,
    PDO_EVENT,
    PDO_INHIBIT,
    PDO_SYNC_START,
    PDO_TRANSMISSION,
    Abort,
    AbortCode,
    DataType,
    NMTCommand,
)
from smarttac_can.od.data_types import SIZES, pack
from smarttac_can.od.entry import Entry

# Putting PDOs into the state a case needs, by the procedure of CiA 301, 7.5.2.36.


_OWN_EVENTS = 3
_NAMES = {
    PDO_TRANSMISSION: "transmission type",
    PDO_INHIBIT: "inhibit time",
    PDO_EVENT: "event timer",
    PDO_SYNC_START: "SYNC start value",
}


def tpdo(examiner: Examiner) -> Pdo:
    """Return the first TPDO that can be configured."""
    return examiner.sheet.usable(examiner.sheet.tpdos)[0]


def rpdo(examiner: Examiner) -> Pdo:
    """Return the first RPDO that can be configured and whose values can be read back.

    Raises
    ------
    NotApplicable
        If there is none.
    """
    for pdo in examiner.sheet.usable(examiner.sheet.rpdos):
        if any(entry.readable for entry in entries(examiner, pdo)):
            return pdo
    raise NotApplicable("no RPDO carries a value that can be read back")


def can_id(examiner: Examiner, pdo: Pdo) -> int:
    """Return the CAN-ID that the data sheet gives a PDO."""
    return examiner.sheet.od.number(pdo.communication, PDO_COB_ID) & CAN_ID_MASK


def entries(examiner: Examiner, pdo: Pdo) -> list[Entry]:
    """Return the entries of the default mapping; dummies are left out."""
    found = (examiner.sheet.od.get(m >> 16, m >> 8 & 0xFF) for m in examiner.sheet.mapped(pdo))
    return [entry for entry in found if entry is not None]


def disable(examiner: Examiner, pdo: Pdo) -> int:
    """Set the invalid bit of a PDO; return its COB-ID on the device without that bit."""
    cob_id = number(examiner, pdo.communication, PDO_COB_ID)
    write_number(examiner, pdo.communication, PDO_COB_ID, cob_id | COB_INVALID)
    return cob_id & ~COB_INVALID | can_id(examiner, pdo)


def enable(examiner: Examiner, pdo: Pdo, cob_id: int) -> None:
    """Clear the invalid bit of a PDO, with this COB-ID."""
    write_number(examiner, pdo.communication, PDO_COB_ID, cob_id & ~COB_INVALID)


def configure(
    examiner: Examiner,
    pdo: Pdo,
    transmission: int,
    *,
    inhibit: int | None = None,
    event: int | None = None,
    start: int | None = None,
    rtr: bool | None = None,
) -> None:
    """Disable a PDO, write its parameters and enable it.

    Raises
    ------
    NotApplicable
        The EDS has no such parameter, or the device does not take the value.
    """
    cob_id = disable(examiner, pdo)
    wanted = {
        PDO_TRANSMISSION: transmission,
        PDO_INHIBIT: inhibit,
        PDO_EVENT: event,
        PDO_SYNC_START: start,
    }
    for subindex, value in wanted.items():
        if value is None:
            continue
        if not examiner.sheet.writable(pdo.communication, subindex):
            raise NotApplicable(f"{pdo.communication:04X}h has no {_NAMES[subindex]} to write")
        try:
            write_number(examiner, pdo.communication, subindex, value)
        except Abort as abort:
            reason = f"the device refuses {_NAMES[subindex]} {value}: {abort}"
            raise NotApplicable(reason) from None
    if rtr is not None:
        cob_id = cob_id & ~COB_NO_RTR if rtr else cob_id | COB_NO_RTR
    try:
        enable(examiner, pdo, cob_id)
    except Abort as abort:
        if rtr:
            raise NotApplicable(f"the device allows no RTR: {abort}") from None
        raise


def configure_rpdo(examiner: Examiner, pdo: Pdo, transmission: int) -> None:
    """Configure an RPDO without a deadline, whose end may undo what it brought."""
    watched = examiner.sheet.writable(pdo.communication, PDO_EVENT)
    configure(examiner, pdo, transmission, event=0 if watched else None)


def started(examiner: Examiner, transmission: int, **parameters: Any) -> Pdo:
    """Configure the first TPDO, with parameters of `configure`, and start the device."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, transmission, **parameters)
    operational(examiner)
    return pdo


def refuse_own_events(examiner: Examiner) -> None:
    """Raise `NotApplicable` if the application makes a TPDO go all the time by its own events."""
    timed = examiner.sheet.writable(tpdo(examiner).communication, PDO_EVENT)
    pdo = started(examiner, EVENT_MANUFACTURER, event=0 if timed else None)
    if len(examiner.collect(can_id(examiner, pdo))) > _OWN_EVENTS:
        raise NotApplicable("the application has events all the time")
    examiner.enter(NMTCommand.ENTER_PRE_OPERATIONAL)


def operational(examiner: Examiner) -> None:
    """Start the device and let the first event-driven TPDOs pass."""
    examiner.enter(NMTCommand.START)


def content(examiner: Examiner, mapped: Iterable[int]) -> bytes:
    """Read by SDO what a PDO with these mapping entries would carry now."""
    return b"".join(upload(examiner, m >> 16, m >> 8 & 0xFF)[: (m & 0xFF) // 8] for m in mapped)


def changed(examiner: Examiner, pdo: Pdo) -> tuple[bytes, list[tuple[Entry, bytes]]]:
    """Make the content of an RPDO with values other than the present ones.

    Returns
    -------
    tuple
        The content, and the bytes of each entry that can be read back.
    """
    data = b""
    wanted = []
    for mapping in examiner.sheet.mapped(pdo):
        size = (mapping & 0xFF) // 8
        entry = examiner.sheet.od.get(mapping >> 16, mapping >> 8 & 0xFF)
        if entry is None:
            data += bytes(size)
            continue
        part = entry.pack()
        if entry.readable:
            part = upload(examiner, entry.index, entry.subindex)
            present = entry.unpack(part)
            if isinstance(present, int | float):
                value = present + 1 if present + 1 <= entry.high else present - 1
                part = pack(entry.data_type, value)
            wanted.append((entry, part))
        data += part
    return data, wanted


def reads(examiner: Examiner, wanted: list[tuple[Entry, bytes]]) -> bool:
    """Tell whether all entries read as wanted."""
    return all(upload(examiner, e.index, e.subindex) == part for e, part in wanted)


def expect_values(examiner: Examiner, wanted: list[tuple[Entry, bytes]], when: str) -> None:
    """Raise `Failure` unless all entries read as wanted."""
    for entry, part in wanted:
        got = upload(examiner, entry.index, entry.subindex)
        if got != part:
            raise Failure(f"{entry.name} is {got.hex(' ')} {when}, not {part.hex(' ')}")


# Mapping: the defaults, and the procedure to change it.


_BITS = 64
_PROCEDURE = "7.5.2.38: disable, number 0, entries, number, enable"
_REFUSED = (AbortCode.NOT_MAPPABLE,)
_PROTECTED = (AbortCode.ACCESS, AbortCode.NOT_MAPPABLE)
_TOO_MUCH = (AbortCode.PDO_LENGTH, AbortCode.NOT_MAPPABLE, AbortCode.VALUE, AbortCode.TOO_HIGH)


def _pdo(examiner: Examiner) -> Pdo:
    return examiner.sheet.mappable(examiner.sheet.tpdos)[0]


def _parameter(entry: Entry) -> int:
    return entry.index << 16 | entry.subindex << 8 | 8 * entry.size


def _mappable(examiner: Examiner) -> list[Entry]:
    """Find the entries of whole bytes that a TPDO may carry, the longest first."""
    found = (e for e in examiner.sheet.od if e.tpdo_mappable and e.size and e.readable)
    whole = (e for e in found if e.data_type != DataType.BOOLEAN and e.size <= FRAME_BYTES)
    return sorted(whole, key=lambda entry: -entry.size)


def _open(examiner: Examiner, pdo: Pdo) -> int:
    """Disable a PDO and set its number of entries to 0; return its COB-ID."""
    cob_id = disable(examiner, pdo)
    write_number(examiner, pdo.mapping, 0, 0)
    return cob_id


def _map(examiner: Examiner, pdo: Pdo, parameters: list[int]) -> None:
    for subindex, parameter in enumerate(parameters, 1):
        write_number(examiner, pdo.mapping, subindex, parameter)
    write_number(examiner, pdo.mapping, 0, len(parameters))


def _all_pdos(examiner: Examiner) -> Iterator[tuple[Pdo, Callable[[Entry], bool], str]]:
    for pdo in examiner.sheet.tpdos:
        yield pdo, lambda entry: entry.tpdo_mappable, "TPDO"
    for pdo in examiner.sheet.rpdos:
        yield pdo, lambda entry: entry.rpdo_mappable, "RPDO"


def _has_pdos(sheet: object) -> str | None:
    pdos = [*getattr(sheet, "tpdos", ()), *getattr(sheet, "rpdos", ())]
    return None if pdos else "the EDS has no PDO"


@case(
    "PDO-26",
    "7.5.2.36, .38: each entry exists, may be mapped in that direction, and all fit 64 bits.",
    _has_pdos,
)
def default_mapping(examiner: Examiner) -> None:
    """Default mapping."""
    od = examiner.sheet.od
    for pdo, allowed, kind in _all_pdos(examiner):
        count = number(examiner, pdo.mapping)
        bits = 0
        for subindex in range(1, count + 1):
            value = number(examiner, pdo.mapping, subindex)
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
    needs_sync,
)
def remap(examiner: Examiner) -> None:
    """Mapping changed by the procedure."""
    pdo = _pdo(examiner)
    cob_id = _open(examiner, pdo)
    parameters = [_parameter(_mappable(examiner)[-1])] * 2
    if not examiner.sheet.has(pdo.mapping, 2):
        parameters.pop()
    _map(examiner, pdo, parameters)
    enable(examiner, pdo, cob_id)
    if number(examiner, pdo.mapping) != len(parameters):
        raise Failure("the number of entries does not read as written")
    configure(examiner, pdo, 1)
    operational(examiner)
    examiner.sync()
    data = examiner.expect(can_id(examiner, pdo), "TPDO at SYNC").data
    if len(data) != len(content(examiner, parameters)):
        raise Failure(f"TPDO of {len(data)} bytes after mapping {len(parameters)} entries anew")


@case(
    "PDO-28",
    f"{_PROCEDURE}; a valid PDO, or one whose number is not 0, refuses also what is there.",
    needs_mapping,
)
def remap_out_of_order(examiner: Examiner) -> None:
    """Mapping changed without the procedure."""
    pdo = _pdo(examiner)
    enable(examiner, pdo, disable(examiner, pdo))
    other = next(
        (
            p
            for e in _mappable(examiner)
            if (p := _parameter(e)) != number(examiner, pdo.mapping, 1)
        ),
        None,
    )
    if other is None:
        raise NotApplicable("the EDS has one mappable entry only")

    def write(parameter: int) -> None:
        write_number(examiner, pdo.mapping, 1, parameter)

    present = number(examiner, pdo.mapping, 1)
    examiner.refuse(lambda: write_number(examiner, pdo.mapping, 0, 0), "number 0 of a valid PDO")
    examiner.refuse(lambda: write(other), "new entry of a valid PDO")
    disable(examiner, pdo)
    for parameter, what in ((other, "new entry"), (present, "entry written back")):
        examiner.refuse(partial(write, parameter), f"{what} while the number is not 0", *_PROTECTED)


@case("PDO-29", "7.5.2.38: a number beyond the sub-indices.", needs_mapping)
def too_many(examiner: Examiner) -> None:
    """Too many entries."""
    pdo = _pdo(examiner)
    _open(examiner, pdo)
    most = max(examiner.sheet.od.objects[pdo.mapping].entries)
    examiner.refuse(
        lambda: write_number(examiner, pdo.mapping, 0, most + 1),
        f"{most + 1} entries in a mapping of {most}",
        *_TOO_MUCH,
    )


@case("PDO-30", "7.5.2.38: more than 64 bits by 06040042h.", needs_mapping)
def too_many_bits(examiner: Examiner) -> None:
    """Too many bits."""
    pdo = _pdo(examiner)
    longest = _mappable(examiner)[0]
    count = _BITS // (8 * longest.size) + 1
    if not examiner.sheet.has(pdo.mapping, count):
        raise NotApplicable("the mapping has too few sub-indices for more than 64 bits")
    _open(examiner, pdo)
    examiner.refuse(
        lambda: _map(examiner, pdo, [_parameter(longest)] * count),
        f"{count} entries of {longest.size} bytes",
        AbortCode.PDO_LENGTH,
        AbortCode.NOT_MAPPABLE,
    )


@case(
    "PDO-31",
    "7.5.2.38: missing ones by 06020000h or 06040041h, PDOMapping=0 by 06040041h.",
    needs_mapping,
)
def not_mappable(examiner: Examiner) -> None:
    """Entries that cannot be mapped."""
    pdo = _pdo(examiner)
    _open(examiner, pdo)
    absent = next(i for i in range(0xFFFF, 0, -1) if i not in examiner.sheet.od.objects)
    examiner.refuse(
        lambda: _map(examiner, pdo, [absent << 16 | 8]),
        f"mapping of {absent:04X}h",
        AbortCode.NO_OBJECT,
        AbortCode.NOT_MAPPABLE,
    )
    plain = next((e for e in examiner.sheet.od if not e.pdo and e.size and e.readable), None)
    if plain is not None:
        write_number(examiner, pdo.mapping, 0, 0)
        examiner.refuse(
            lambda: _map(examiner, pdo, [_parameter(plain)]), f"mapping of {plain.name}", *_REFUSED
        )


@case(
    "PDO-32",
    "CiA 306, 4.6: wo and rww only in RPDOs, ro, const and rwr only in TPDOs.",
    needs_mapping,
)
def direction(examiner: Examiner) -> None:
    """Direction by access."""
    asked = 0
    for pdos, name, kinds in (
        (examiner.sheet.tpdos, "TPDO", ("wo", "rww")),
        (examiner.sheet.rpdos, "RPDO", ("ro", "rwr")),
    ):
        usable = examiner.sheet.mappable(pdos)
        if not usable:
            continue
        _open(examiner, usable[0])
        for kind in kinds:
            entry = next((e for e in examiner.sheet.od if e.pdo and e.access == kind), None)
            if entry is not None:
                asked += 1
                parameter = _parameter(entry)
                write_number(examiner, usable[0].mapping, 0, 0)
                examiner.refuse(
                    partial(_map, examiner, usable[0], [parameter]),
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
def dummies(examiner: Examiner) -> None:
    """Dummies."""
    usable = examiner.sheet.mappable(examiner.sheet.rpdos)
    dummies_of_bytes = examiner.sheet.od.dummies - {DataType.BOOLEAN}
    if not usable or not dummies_of_bytes:
        raise NotApplicable("the EDS has no RPDO with a writable mapping, or no dummies")
    dummy = min(dummies_of_bytes)
    parameter = dummy << 16 | 8 * SIZES[dummy]
    cob_id = _open(examiner, usable[0])
    _map(examiner, usable[0], [parameter])
    enable(examiner, usable[0], cob_id)
    if upload(examiner, usable[0].mapping, 1) != parameter.to_bytes(4, "little"):
        raise Failure("the dummy does not read as written")
    pdo = _pdo(examiner)
    _open(examiner, pdo)
    examiner.refuse(
        lambda: _map(examiner, pdo, [parameter]), "dummy in a TPDO", AbortCode.NO_OBJECT, *_REFUSED
    )
