"""Reference of a device's objects, in Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import groupby
from typing import Final

from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.data_types import bounds
from smarttac_can.canopen.od.dictionary import Object, ObjectDictionary
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.entry import Entry

LEGEND: Final = (
    "Limits and defaults are raw counts; *one count* says what a count stands for, and is empty "
    "for a plain number. `1018h:2` is index 1018h, sub-index 2. Sub-index 0 of arrays and records, "
    "the number of members, is left out. Members in a row that differ by name alone share a row: "
    "in `Simulation.Seed, .Subject` the second is `Simulation.Subject`. "
    "An object marked *PDO* may be mapped: `ro` and `rwr` into a TPDO, `rww` into an RPDO, `rw` "
    "into both."
)
"""Text that explains the tables to a reader."""

_PDOS: Final = (
    ("RPDO", cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING),
    ("TPDO", cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING),
)
_HEXADECIMAL_FROM: Final = 10_000
"""Least value of an UNSIGNED32 without a unit that is shown in hexadecimal, as it is a code."""
_NUMBER: Final = re.compile(r"\d+$")
"""Number at the end of the name of a member."""


def table(*rows: tuple[str, ...]) -> Iterator[str]:
    """Yield the lines of a table, whose first row is the head, and an empty line."""
    head, *body = rows
    yield f"| {' | '.join(head)} |"
    yield "|" + "---|" * len(head)
    for row in body:
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |"
    yield ""


def object_reference(text: str, *, level: int = 2) -> Iterator[str]:
    """Yield the lines of the tables of all PDOs and objects of an EDS.

    Parameters
    ----------
    text
        Content of the file.
    level
        Level of the headings.

    Raises
    ------
    EDSError
        The file cannot be interpreted.
    """
    # A master has to compute the values that differ between two node-IDs, so both are loaded.
    od, other = (load_eds(text, node_id) for node_id in (1, 2))
    heading = "#" * level
    pdos = list(_pdo_rows(od, other))
    if len(pdos) > 1:
        yield from (f"{heading} PDOs", "", *table(*pdos))
    for title, objects in _areas(od):
        rows = list(_rows(objects, other))
        if len(rows) > 1:
            yield from (f"{heading} {title}", "", *table(*rows))


def _areas(od: ObjectDictionary) -> Iterator[tuple[str, list[Object]]]:
    """Yield the objects by area, without the PDO parameters, which have their own table."""
    found = od.objects.values()
    yield (
        "Communication profile",
        [
            item
            for item in found
            if item.index < cia.RPDO_COMMUNICATION
            or cia.TPDO_MAPPING + cia.PDO_COUNT <= item.index < cia.MANUFACTURER_FIRST
        ],
    )
    yield (
        "Manufacturer-specific",
        [item for item in found if cia.MANUFACTURER_FIRST <= item.index < cia.PROFILE_FIRST],
    )
    yield "Device profile", [item for item in found if item.index >= cia.PROFILE_FIRST]


def _rows(objects: Iterable[Object], other: ObjectDictionary) -> Iterator[tuple[str, ...]]:
    """Yield a row for each entry; consecutive members that differ only in name share a row."""
    yield "Object", "Name", "Type", "Access", "Limits", "Default", "One count"
    for item in objects:
        # For consecutive members, sub-index minus position is constant.
        members = enumerate(_members(item, other))
        for _, alike in groupby(members, lambda each: (each[1][0] - each[0], each[1][2])):
            (first, name, columns), *more = [member for _, member in alike]
            if more:
                name = _joined([name, *(member[1] for member in more)])
            span = f"{first}..{more[-1][0]}" if more else f"{first}"
            yield f"{item.index:04X}h:{span}", name, *columns


def _members(item: Object, other: ObjectDictionary) -> Iterator[tuple[int, str, tuple[str, ...]]]:
    structured = item.object_type in (cia.ObjectType.ARRAY, cia.ObjectType.RECORD)
    for entry in item.entries.values():
        if structured and entry.subindex == 0 and not entry.writable:
            continue
        yield (
            entry.subindex,
            entry.name,
            (
                entry.data_type.name,
                f"{entry.access}, PDO" if entry.pdo else entry.access,
                _limits(entry),
                _default(entry, other.entry(entry.index, entry.subindex)),
                str(entry.unit),
            ),
        )


def _joined(names: list[str]) -> str:
    """Return a common name of members: a range of numbers, or a list with the record once."""
    if len({_NUMBER.sub("", name) for name in names}) == 1:
        numbers = "..".join(_NUMBER.findall(names[0]) + _NUMBER.findall(names[-1]))
        return _NUMBER.sub(numbers, names[0])
    record, _, _ = names[0].rpartition(".")
    return ", ".join([names[0], *(name.removeprefix(record) for name in names[1:])])


def _pdo_rows(od: ObjectDictionary, other: ObjectDictionary) -> Iterator[tuple[str, ...]]:
    yield "PDO", "COB-ID", "Type", "Event timer", "Content, bits"
    for kind, first, mapping in _PDOS:
        for index in [i for i in od.objects if first <= i < first + cia.PDO_COUNT]:
            mapped = index - first + mapping
            contents = [od.number(mapped, position) for position in range(1, od.number(mapped) + 1)]
            yield (
                f"{kind} {index - first + 1}",
                _cob_id(od, other, index),
                f"{od.number(index, cia.PDO_TRANSMISSION)}",
                f"{od.number(index, cia.PDO_EVENT)} ms",
                ", ".join(f"{_mapped_name(od, value)} {value & 0xFF}" for value in contents),
            )


def _mapped_name(od: ObjectDictionary, value: int) -> str:
    entry = od.get(value >> 16, value >> 8 & 0xFF)
    if entry is not None:
        return entry.name
    return "dummy" if value >> 16 in od.dummies else f"{value >> 16:04X}h"


def _cob_id(od: ObjectDictionary, other: ObjectDictionary, index: int) -> str:
    entry = od.get(index, cia.PDO_COB_ID)
    if entry is None:
        return ""
    can_id = _default(entry, other.entry(index, cia.PDO_COB_ID))
    if entry.default & cia.COB_INVALID:
        return f"off ({can_id})" if entry.default & cia.CAN_ID_MASK else "off"
    return can_id


def _default(entry: Entry, neighbour: Entry) -> str:
    """Return a default as text; entry and neighbour are those of node-ID 1 and 2."""
    if entry.default == neighbour.default:
        return _number(entry)
    base = entry.default - 1 & ~(cia.COB_INVALID | cia.COB_NO_RTR)
    return f"{base:X}h + node-ID"


def _number(entry: Entry) -> str:
    value = entry.default
    if isinstance(value, bytes):
        return value.hex(" ").upper()
    plain = entry.unit.symbol or entry.data_type is not cia.DataType.UNSIGNED32
    if plain or (value < _HEXADECIMAL_FROM and "COB-ID" not in entry.name):
        return str(value)
    return f"{value:X}h"


def _limits(entry: Entry) -> str:
    whole = (entry.low, entry.high) == bounds(entry.data_type)
    return "" if whole else f"{entry.low}..{entry.high}"
