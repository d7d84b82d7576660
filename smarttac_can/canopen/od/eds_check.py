"""Rules for an EDS: CiA 306 for text, lists and objects, CiA 301 for PDOs and services."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import chain, islice
from typing import Any, Final, NamedTuple

from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import DataType, ObjectType
from smarttac_can.canopen.od.data_types import SIZES, TEXT, bounds
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import (
    LONGEST_NAME,
    MEMBER,
    OBJECT,
    EDSError,
    Sections,
    load_eds,
    node_id_of,
    parse_integer,
    parse_value,
    read_sections,
)
from smarttac_can.canopen.od.entry import ACCESS, Entry


class Finding(NamedTuple):
    """One error or warning about an EDS."""

    section: str
    """Name of the section in lower case; empty for the file as a whole."""
    message: str
    error: bool = True
    """Whether it is an error; False for a warning, which tools tolerate."""

    def __str__(self) -> str:
        """Return the finding as a line of text."""
        where = f"[{shown(self.section)}] " if self.section else ""
        return f"{where}{'' if self.error else 'warning: '}{self.message}"


def shown(section: str) -> str:
    """Return the name of a section in the spelling of EDS files."""
    if found := MEMBER.match(section):
        return f"{found[1].upper()}sub{found[2].upper()}"
    return section.upper() if OBJECT.match(section) else _TITLES.get(section, section)


_TITLES: Final = {
    title.lower(): title
    for title in (
        "FileInfo", "DeviceInfo", "DummyUsage", "Comments",
        "MandatoryObjects", "OptionalObjects", "ManufacturerObjects",
    )
}  # fmt: skip

# Rules of CiA 306 for one entry: name, data type, access, limits, default, `$NODEID`.


_KEYS: Final = frozenset({
    "parametername", "objecttype", "datatype", "accesstype", "defaultvalue", "lowlimit",
    "highlimit", "pdomapping", "subnumber", "compactsubobj", "objflags", "parametervalue",
    "denotation", "uploadfile", "downloadfile",
})  # fmt: skip
_FORMULA: Final = re.compile(r"\$nodeid(\s*\+\s*[0-9a-fx]+)?", re.IGNORECASE)


def _check_keys(name: str, section: dict[str, str]) -> Iterator[Finding]:
    title = section.get("parametername", "")
    if not title:
        yield Finding(name, "ParameterName is missing")
    elif len(title) > LONGEST_NAME:
        yield Finding(name, f"ParameterName is longer than {LONGEST_NAME} characters")
    for key in section.keys() - _KEYS:
        yield Finding(name, f"{key} is not known", error=False)
    if section.get("objflags", "") and _integer(section["objflags"]) not in range(4):
        yield Finding(name, f"ObjFlags={section['objflags']} is outside 0..3")


def _check_entry(
    name: str, section: dict[str, str], index: int, subindex: int
) -> Iterator[Finding]:
    access = section.get("accesstype", "").lower()
    domain = _integer(section.get("objecttype", "")) == ObjectType.DOMAIN
    if access not in ACCESS and not (domain and not access):
        given = f"AccessType={access}" if access else "AccessType is missing: it"
        yield Finding(name, f"{given} is none of {', '.join(ACCESS)}")
    if section.get("pdomapping", "0") not in ("0", "1", "0x0", "0x1"):
        yield Finding(name, f"PDOMapping={section['pdomapping']} is neither 0 nor 1")
    text = section.get("datatype", "")
    if domain and not text:
        return
    code = _integer(text)
    if code is None or code not in set(DataType):
        yield Finding(name, f"DataType={text} is no data type" if text else "DataType is missing")
        return
    data_type = DataType(code)
    wanted = cia.standard_type(index, subindex)
    if wanted not in (None, data_type):
        yield Finding(name, f"is {data_type.name}, not the {wanted.name} of CiA 301")
    yield from _check_values(name, section, data_type)
    default = section.get("defaultvalue", "")
    if access == "const" and not default and data_type is not DataType.DOMAIN:
        yield Finding(name, "is const without DefaultValue", error=False)


def _check_values(name: str, section: dict[str, str], data_type: DataType) -> Iterator[Finding]:
    keys = ("LowLimit", "HighLimit", "DefaultValue", "ParameterValue")
    texts = {key: section.get(key.lower(), "") for key in keys}
    ordered = bounds(data_type) != (0, 0)
    for key in ("LowLimit", "HighLimit"):
        if texts[key] and not ordered:
            yield Finding(name, f"{key} of a {data_type.name} means nothing", error=False)
            texts[key] = ""
    for key, text in texts.items():
        if "$nodeid" in text.lower() and data_type not in TEXT:
            if not _FORMULA.fullmatch(text):
                yield Finding(name, f"{key}={text}: a formula begins with $NODEID", error=False)
            if not ordered:
                yield Finding(name, f"{key}={text} is no {data_type.name}")
                return
    # The lowest and the highest node-ID show whether formulas stay within the limits for all.
    for node_id in (1, 127):
        try:
            values = {
                key: parse_value(data_type, text, node_id, f"{key}={text}")
                for key, text in texts.items()
                if text
            }
        except EDSError as error:
            yield Finding(name, str(error))
            return
        found = list(_check_order(name, values)) if ordered else []
        if found:
            yield from found
            return


def _check_order(name: str, values: dict[str, Any]) -> Iterator[Finding]:
    low, high = values.get("LowLimit"), values.get("HighLimit")
    if low is not None and high is not None and low > high:
        yield Finding(name, f"LowLimit {low} is above HighLimit {high}")
        return
    for key in ("DefaultValue", "ParameterValue"):
        value = values.get(key)
        if value is None:
            continue
        if low is not None and value < low:
            yield Finding(name, f"{key} {value} is below LowLimit {low}")
        if high is not None and value > high:
            yield Finding(name, f"{key} {value} is above HighLimit {high}")


def _integer(text: str) -> int | None:
    try:
        return parse_integer(text, "")
    except EDSError:
        return None


# Rules of CiA 306 for objects: their type, and whether their members agree with it.


_COMPACT: Final = ("name", "value", "denotation", "objectlinks")
_DATA: Final = (ObjectType.VAR, ObjectType.DOMAIN)
_STRUCTURES: Final = (ObjectType.ARRAY, ObjectType.RECORD, ObjectType.DEFSTRUCT)


def _check_objects(sections: Sections) -> Iterator[Finding]:
    members: dict[str, dict[int, str]] = {}
    for name in sections:
        if found := MEMBER.match(name):
            members.setdefault(found[1], {})[int(found[2], 16)] = name
    for name, section in sections.items():
        if OBJECT.match(name):
            yield from _check_keys(name, section)
            yield from _check_object(name, sections, members.pop(name, {}))
    for names in members.values():
        for name in names.values():
            yield Finding(name, "belongs to no object")


def _check_object(name: str, sections: Sections, members: dict[int, str]) -> Iterator[Finding]:
    section = sections[name]
    index = int(name, 16)
    code = _integer(section.get("objecttype", "7"))
    if code is None or code not in set(ObjectType):
        yield Finding(name, f"ObjectType={section['objecttype']} is no object type")
        return
    kind = ObjectType(code)
    if kind in _DATA:
        if members or _integer(section.get("subnumber", "0")):
            yield Finding(name, f"is a {kind.name}, but has sub-indices")
        yield from _check_entry(name, section, index, 0)
    elif kind in _STRUCTURES:
        compact = section.get("compactsubobj", "")
        if compact and _integer(compact) != 0:
            yield from _check_compact(name, sections, index)
        else:
            yield from _check_members(name, section, kind, members, sections)
        for subindex, member in sorted(members.items()):
            yield from _check_keys(member, sections[member])
            if _integer(sections[member].get("objecttype", "7")) not in _DATA:
                yield Finding(member, "ObjectType is neither VAR nor DOMAIN")
            yield from _check_entry(member, sections[member], index, subindex)


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
    elif _integer(stated) != len(members):
        yield Finding(name, f"SubNumber={stated}, but {len(members)} are described")
    if 0 not in members:
        yield Finding(name, f"sub-index 0 of this {kind.name} is missing")
        return
    yield from _check_highest(members[0], sections[members[0]], max(members))
    types = {
        _integer(sections[member].get("datatype", ""))
        for subindex, member in members.items()
        if subindex not in (0, 0xFF)
    }
    if kind is ObjectType.ARRAY and len(types) > 1:
        yield Finding(name, "is an ARRAY of members that differ in DataType")


def _check_highest(name: str, section: dict[str, str], highest: int) -> Iterator[Finding]:
    if _integer(section.get("datatype", "")) != DataType.UNSIGNED8:
        yield Finding(name, "sub-index 0 is not UNSIGNED8")
    default = _integer(section.get("defaultvalue", ""))
    fixed = section.get("accesstype", "").lower() in ("const", "ro")
    if cia.is_mapping(int(name[:4], 16)) and default in cia.MULTIPLEXED:
        return
    if default is None:
        if fixed:
            yield Finding(name, "DefaultValue of sub-index 0 is missing")
    elif default > highest or (fixed and default != highest):
        yield Finding(name, f"DefaultValue {default}, but the highest sub-index is {highest}")


def _check_compact(name: str, sections: Sections, index: int) -> Iterator[Finding]:
    section = sections[name]
    count = _integer(section["compactsubobj"])
    if count is None or not 1 <= count <= cia.LAST_SUBINDEX:
        yield Finding(name, f"CompactSubObj={section['compactsubobj']} is outside 1..254")
        return
    yield from _check_entry(name, section, index, 1)
    for suffix in _COMPACT[:2]:
        values = sections.get(name + suffix)
        if values is None:
            continue
        numbers = [int(key) for key in values if key.isdigit()]
        if _integer(values.get("nrofentries", "")) != len(numbers):
            yield Finding(name + suffix, f"NrOfEntries is not the {len(numbers)} that are there")
        for number in numbers:
            if not 1 <= number <= count:
                yield Finding(name + suffix, f"{number} is outside 1..{count}")


# Rules of CiA 306 for a file as a whole: its text, its information, its lists of objects.


LONGEST_LINE: Final = 255
LISTS: Final = {
    "mandatoryobjects": "mandatory objects",
    "optionalobjects": "optional objects",
    "manufacturerobjects": "manufacturer-specific objects",
}
_MANDATORY: Final = frozenset({cia.DEVICE_TYPE, cia.ERROR_REGISTER, cia.IDENTITY})
_BAUD_RATES: Final = tuple(f"BaudRate_{rate}" for rate in (10, 20, 50, 125, 250, 500, 800, 1000))
_TIME: Final = r"(0[1-9]|1[0-2]):[0-5]\d(AM|PM)"
_DATE: Final = r"(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])-\d{4}"
_NUMBER: Final = r"(0x[0-9A-Fa-f]+|\d+)"
_SWITCH: Final = r"[01]|0x[01]"
_FORMATS: Final = {
    "fileinfo": {
        "FileName": r".+",
        "FileVersion": _NUMBER,
        "FileRevision": _NUMBER,
        "EDSVersion": r"\d\.\d",
        "Description": r".{0,243}",
        "CreationTime": _TIME,
        "CreationDate": _DATE,
        "CreatedBy": r".{0,245}",
        "ModificationTime": _TIME,
        "ModificationDate": _DATE,
        "ModifiedBy": r".{0,244}",
    },
    "deviceinfo": {
        "VendorName": r".{0,244}",
        "VendorNumber": _NUMBER,
        "ProductName": r".{0,243}",
        "ProductNumber": _NUMBER,
        "RevisionNumber": _NUMBER,
        "OrderCode": r".{0,245}",
        **dict.fromkeys(_BAUD_RATES, _SWITCH),
        "SimpleBootUpMaster": _SWITCH,
        "SimpleBootUpSlave": _SWITCH,
        "Granularity": _NUMBER,
        "DynamicChannelsSupported": _NUMBER,
        "GroupMessaging": _SWITCH,
        "NrOfRXPDO": _NUMBER,
        "NrOfTXPDO": _NUMBER,
        "LSS_Supported": _SWITCH,
    },
    "dummyusage": {f"Dummy{number:04X}": _SWITCH for number in range(1, 8)},
}
_MAY_LACK: Final = frozenset({
    "EDSVersion", "CreatedBy", "ModificationTime", "ModificationDate", "ModifiedBy", "OrderCode",
    "ProductNumber", "RevisionNumber", "VendorNumber", *_FORMATS["dummyusage"],
})  # fmt: skip


_OTHER: Final = re.compile(
    r"fileinfo|deviceinfo|dummyusage|comments|devicecomm?issioning|(mandatory|optional|manufacturer)"
    r"objects|dynamicchannels|supportedmodules|m\d+[a-z]+\d*|tools|tool\d+"
    r"|[0-9a-f]{4}(sub[0-9a-f]{1,2}|name|value|denotation|objectlinks)?"
)


def _check_text(text: str) -> Iterator[Finding]:
    for number, line in enumerate(text.splitlines(), 1):
        if not line.isascii():
            odd = next(character for character in line if not character.isascii())
            yield Finding("", f"line {number}: {odd!r} is not ASCII")
        if len(line) > LONGEST_LINE:
            yield Finding("", f"line {number} is longer than {LONGEST_LINE} characters")


def _check_information(sections: Sections, file_name: str) -> Iterator[Finding]:
    """Check [FileInfo], [DeviceInfo], [DummyUsage] and [Comments], and for unknown sections."""
    for name in sections:
        if not _OTHER.fullmatch(name):
            yield Finding(name, "is no section of an EDS", error=False)
    for name, formats in _FORMATS.items():
        section = sections.get(name)
        if section is None:
            yield Finding(name, "is missing", error=name != "dummyusage")
            continue
        for key, pattern in formats.items():
            value = section.get(key.lower())
            if value is None:
                yield Finding(name, f"{key} is missing", error=key not in _MAY_LACK)
            elif not re.fullmatch(pattern, value):
                yield Finding(name, f"{key}={value} is not in the form it should have")
    stated = sections.get("fileinfo", {}).get("filename", file_name)
    if stated != file_name:
        yield Finding("fileinfo", f"FileName={stated}, but it is {file_name}", error=False)
    yield from _check_device(sections)
    yield from _check_comments(sections.get("comments", {}))


def _check_device(sections: Sections) -> Iterator[Finding]:
    section = sections.get("deviceinfo", {})
    if all(_integer(section.get(rate.lower(), "")) in (0, None) for rate in _BAUD_RATES):
        yield Finding("deviceinfo", "no BaudRate is supported")
    if (_integer(section.get("granularity", "")) or 0) > 8 * cia.FRAME_BYTES:
        yield Finding("deviceinfo", "Granularity is above 64")
    for key, subindex in (("VendorNumber", 1), ("ProductNumber", 2), ("RevisionNumber", 3)):
        stated = _integer(section.get(key.lower(), ""))
        member = sections.get(f"{cia.IDENTITY:04x}sub{subindex}", {})
        actual = _integer(member.get("defaultvalue", ""))
        if stated is not None and actual is not None and stated != actual:
            where = f"{cia.IDENTITY:04X}sub{subindex}"
            yield Finding("deviceinfo", f"{key} 0x{stated:X} is not the 0x{actual:X} of [{where}]")
    for key, first in (
        ("NrOfRXPDO", cia.RPDO_COMMUNICATION),
        ("NrOfTXPDO", cia.TPDO_COMMUNICATION),
    ):
        stated = _integer(section.get(key.lower(), ""))
        indices = (int(name, 16) for name in sections if OBJECT.match(name))
        count = sum(first <= index < first + cia.PDO_COUNT for index in indices)
        compact = _integer(section.get("compactpdo", "")) and (stated or 0) > count
        if stated is not None and stated != count and not compact:
            yield Finding("deviceinfo", f"{key}={stated}, but {count} are described")


def _check_comments(section: dict[str, str]) -> Iterator[Finding]:
    count = sum(key.startswith("line") and key != "lines" for key in section)
    stated = _integer(section.get("lines", "0"))
    if stated != count:
        yield Finding("comments", f"Lines={section.get('lines')}, but there are {count}")


def _check_lists(sections: Sections) -> Iterator[Finding]:
    described = {int(name, 16) for name in sections if OBJECT.match(name)}
    listed: dict[int, str] = {}
    for name, what in LISTS.items():
        section = sections.get(name)
        if section is None:
            yield Finding(name, "is missing")
            continue
        yield from _check_count(name, section)
        for key, text in section.items():
            index = _integer(text)
            if not key.isdigit():
                if key != "supportedobjects":
                    yield Finding(name, f"{key} is not known", error=False)
            elif index is None:
                yield Finding(name, f"{key}={text} is no index")
            elif index in listed:
                yield Finding(name, f"{key}={text} is listed twice")
            else:
                listed[index] = name
                if _right_list(index) != name:
                    yield Finding(name, f"{key}={text} is not one of the {what}")
                if index not in described:
                    yield Finding(name, f"{key}={text} is not described")
    for index in sorted(described - listed.keys()):
        yield Finding(f"{index:04x}", "is in no list of objects")
    for index in sorted(_MANDATORY - described):
        yield Finding("mandatoryobjects", f"{index:04X}h is missing")


def _check_count(name: str, section: dict[str, str]) -> Iterator[Finding]:
    numbers = sorted(int(key) for key in section if re.fullmatch(r"[0-9]{1,9}", key))
    text = section.get("supportedobjects", "")
    if _integer(text) != len(numbers):
        yield Finding(name, f"SupportedObjects={text}, but {len(numbers)} are listed")
    elif numbers != list(range(1, len(numbers) + 1)):
        yield Finding(name, f"is not numbered from 1 to {len(numbers)}")


def _right_list(index: int) -> str:
    if index in _MANDATORY:
        return "mandatoryobjects"
    manufacturer = cia.MANUFACTURER_FIRST <= index < cia.PROFILE_FIRST
    return "manufacturerobjects" if manufacturer else "optionalobjects"


# Rules for the PDOs of an EDS: every default mapping must be valid, fit, and have its direction.


_BITS: Final = 64
_MOST_ENTRIES: Final = 64
_KINDS: Final = (
    ("RPDO", cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING),
    ("TPDO", cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING),
)


def check_pdos(od: ObjectDictionary) -> Iterator[Finding]:
    """Yield what is wrong with the PDOs that a device has by default, by CiA 301."""
    used: dict[int, str] = {}
    synchronous = False
    for kind, communication, mapping in _KINDS:
        for number in range(cia.PDO_COUNT):
            index, mapped = communication + number, mapping + number
            if index in od.objects:
                yield from _check_communication(od, kind, index, used)
                transmission = od.number(index, cia.PDO_TRANSMISSION)
                synchronous |= transmission <= cia.CYCLIC_LAST and od.number(mapped) > 0
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
    if count in cia.MULTIPLEXED:
        text = f"maps {count:X}h, so it is a multiplexed PDO: each frame names its object"
        yield Finding(f"{mapped:04x}sub0", text, error=False)
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


MAX_FINDINGS: Final = 1000
"""Most findings that are reported for a file."""
_HEADS: Final = {"fileinfo", "deviceinfo", "mandatoryobjects"}


def check_eds(text: str, file_name: str) -> list[Finding]:
    """Check an EDS by CiA 306, and its PDOs and services by CiA 301.

    Parameters
    ----------
    text
        Content of the file.
    file_name
        Name of the file, without its folder.

    Returns
    -------
    list of Finding
        Errors and warnings in the order of the rules, the first 1000; empty for a file without
        errors.
    """
    findings = list(islice(_findings(text, file_name), MAX_FINDINGS + 1))
    if len(findings) > MAX_FINDINGS:
        findings[-1] = Finding("", f"there are more than {MAX_FINDINGS} findings")
    return findings


def _findings(text: str, file_name: str) -> Iterator[Finding]:
    odd: list[str] = []
    try:
        sections = read_sections(text, odd)
    except EDSError as error:
        if "XML" not in str(error):
            yield from _check_text(text)
        yield Finding("", str(error))
        return
    if not _HEADS & sections.keys():
        yield Finding("", "it is no EDS: neither [FileInfo], [DeviceInfo] nor [MandatoryObjects]")
        return
    failed = False
    for finding in chain(
        _check_text(text),
        (Finding("", line) for line in odd),
        _check_information(sections, file_name),
        _check_lists(sections),
        _check_objects(sections),
    ):
        failed |= finding.error
        yield finding
    try:
        od = load_eds(text, node_id_of(sections) or 1)
    except EDSError as error:
        # An earlier finding already shows why it cannot be loaded; otherwise report the error
        # itself.
        if not failed:
            yield Finding("", str(error))
        return
    yield from check_pdos(od)
    yield from _check_services(od)


def _check_services(od: ObjectDictionary) -> Iterator[Finding]:
    guarding = {cia.GUARD_TIME, cia.LIFE_TIME_FACTOR} <= od.objects.keys()
    if cia.HEARTBEAT_PRODUCER not in od.objects and not guarding:
        yield Finding("", "the device has neither heartbeat nor node guarding")
    if cia.ERROR_FIELD in od.objects and cia.EMCY_COB_ID not in od.objects:
        message = f"is an error history without EMCY {cia.EMCY_COB_ID:04X}h"
        yield Finding(f"{cia.ERROR_FIELD:04x}", message, error=False)
    produces_sync = od.number(cia.SYNC_COB_ID) & cia.COB_SYNC_PRODUCER
    if produces_sync and cia.SYNC_PERIOD not in od.objects:
        yield Finding("", f"it produces SYNC, but there is no period {cia.SYNC_PERIOD:04X}h")
