"""Rules of CiA 306 for objects: their type, and their members against what they state."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from smarttac_can.od.cia import LAST_SUBINDEX, DataType, ObjectType
from smarttac_can.od.entry_rules import check_entry, check_keys, integer
from smarttac_can.od.finding import MEMBER, OBJECT, Finding, Sections

_LISTS: Final = ("name", "value", "denotation", "objectlinks")
_DATA: Final = (ObjectType.VAR, ObjectType.DOMAIN)
_STRUCTURES: Final = (ObjectType.ARRAY, ObjectType.RECORD, ObjectType.DEFSTRUCT)


def check_objects(sections: Sections) -> Iterator[Finding]:
    """Check every object and its members, and that no member is without its object."""
    members: dict[str, dict[int, str]] = {}
    for name in sections:
        if found := MEMBER.match(name):
            members.setdefault(found[1], {})[int(found[2], 16)] = name
    for name, section in sections.items():
        if OBJECT.match(name):
            yield from check_keys(name, section)
            yield from _check_object(name, sections, members.pop(name, {}))
    for names in members.values():
        for name in names.values():
            yield Finding(name, "belongs to no object")


def _check_object(name: str, sections: Sections, members: dict[int, str]) -> Iterator[Finding]:
    section = sections[name]
    index = int(name, 16)
    code = integer(section.get("objecttype", "7"))
    if code is None or code not in set(ObjectType):
        yield Finding(name, f"ObjectType={section['objecttype']} is no object type")
        return
    kind = ObjectType(code)
    if kind in _DATA:
        if members or integer(section.get("subnumber", "0")):
            yield Finding(name, f"is a {kind.name}, but has sub-indices")
        yield from check_entry(name, section, index, 0)
    elif kind in _STRUCTURES:
        compact = section.get("compactsubobj", "")
        if compact and integer(compact) != 0:
            yield from _check_compact(name, sections, index)
        else:
            yield from _check_members(name, section, kind, members, sections)
        for subindex, member in sorted(members.items()):
            yield from check_keys(member, sections[member])
            if integer(sections[member].get("objecttype", "7")) not in _DATA:
                yield Finding(member, "ObjectType is neither VAR nor DOMAIN")
            yield from check_entry(member, sections[member], index, subindex)


def _check_members(
    name: str,
    section: dict[str, str],
    kind: ObjectType,
    members: dict[int, str],
    sections: Sections,
) -> Iterator[Finding]:
    stated = section.get("subnumber", "")
    if not stated:
        yield Finding(name, f"SubNumber of this {kind.name} is missing")
    elif integer(stated) != len(members):
        yield Finding(name, f"SubNumber={stated}, but {len(members)} are described")
    if 0 not in members:
        yield Finding(name, f"sub-index 0 of this {kind.name} is missing")
        return
    yield from _check_highest(members[0], sections[members[0]], max(members))
    types = {
        integer(sections[member].get("datatype", ""))
        for subindex, member in members.items()
        if subindex not in (0, 0xFF)
    }
    if kind is ObjectType.ARRAY and len(types) > 1:
        yield Finding(name, "is an ARRAY of members that differ in DataType")


def _check_highest(name: str, section: dict[str, str], highest: int) -> Iterator[Finding]:
    if integer(section.get("datatype", "")) != DataType.UNSIGNED8:
        yield Finding(name, "sub-index 0 is not UNSIGNED8")
    default = integer(section.get("defaultvalue", ""))
    fixed = section.get("accesstype", "").lower() in ("const", "ro")
    if default is None:
        if fixed:
            yield Finding(name, "DefaultValue of sub-index 0 is missing")
    elif default > highest or (fixed and default != highest):
        yield Finding(name, f"DefaultValue {default}, but the highest sub-index is {highest}")


def _check_compact(name: str, sections: Sections, index: int) -> Iterator[Finding]:
    section = sections[name]
    count = integer(section["compactsubobj"])
    if count is None or not 1 <= count <= LAST_SUBINDEX:
        yield Finding(name, f"CompactSubObj={section['compactsubobj']} is outside 1..254")
        return
    yield from check_entry(name, section, index, 1)
    for suffix in _LISTS[:2]:
        values = sections.get(name + suffix)
        if values is None:
            continue
        numbers = [int(key) for key in values if key.isdigit()]
        if integer(values.get("nrofentries", "")) != len(numbers):
            yield Finding(name + suffix, f"NrOfEntries is not the {len(numbers)} that are there")
        for number in numbers:
            if not 1 <= number <= count:
                yield Finding(name + suffix, f"{number} is outside 1..{count}")
