"""Load electronic data sheets (CiA 306) into an object dictionary.

The parser is our own: python-canopen's silently drops what it does not understand, sign-extends
only four of the eight signed types, and does not support `$NODEID` in the limits.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Iterator
from itertools import islice, takewhile
from numbers import Integral
from typing import Any, Final, TypeVar

from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import DataType, ObjectType
from smarttac_can.canopen.od.data_types import (
    REAL,
    SIGNED,
    SIZES,
    TEXT,
    UNSIGNED,
    bounds,
    visible,
    zero,
)
from smarttac_can.canopen.od.dictionary import Object, ObjectDictionary
from smarttac_can.canopen.od.entry import ACCESS, Entry
from smarttac_can.canopen.od.units import ONE, Quantity, split_name

# Section and key syntax of EDS files (CiA 306, clause 4.3), tolerant if no information is lost.


MAX_LINES: Final = 40_000
"""Most lines of a file; a slow machine reads and writes them in 2 s. Our own have up to 3 774."""
MAX_ODD: Final = 1000
"""Most lines that are ignored or merged, with a warning each; a file with more is no EDS."""

_COMMENT: Final = re.compile(r"(?:^|\s);.*$")
_CONTROL: Final = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]")


Section = dict[str, str]
Sections = dict[str, Section]
"""Sections and their keys, both in lower case."""


class EDSError(ValueError):
    """An EDS that cannot be interpreted; the message is one line."""


def read_sections(text: str, warnings: list[str]) -> Sections:
    """Read the sections of a file, with names and keys in lower case and values stripped.

    A repeated section is merged. Lines that are neither section, key nor comment are ignored with a
    warning.

    Raises
    ------
    EDSError
        A key has two different values, a line has a control character, or there are more than
        `MAX_LINES` lines, or `MAX_ODD` warnings.
    """
    if text.removeprefix("\ufeff").lstrip().startswith(("<?xml", "<ISO15745")):
        raise EDSError("it is XML, as an XDD of CiA 311, and no EDS: export an EDS from its editor")
    sections: Sections = {}
    current: Section | None = None
    name = ""
    for number, raw in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        line = _COMMENT.sub("", raw).strip()
        if not line:
            continue
        if number > MAX_LINES:
            raise EDSError(f"there are more than {MAX_LINES} lines")
        if len(warnings) > MAX_ODD:
            raise EDSError(f"line {number}: more than {MAX_ODD} lines before it are odd")
        # Names are shown on terminals, which interpret control characters.
        if found := _CONTROL.search(line):
            raise EDSError(f"line {number}: {found[0]!r} is a control character")
        if line.startswith("[") and line.endswith("]"):
            name = line[1:-1].strip().lower()
            if name in sections:
                warnings.append(f"line {number}: section [{name}] comes again, merged")
            current = sections.setdefault(name, {})
            continue
        key, equals, value = line.partition("=")
        key, value = key.strip().lower(), value.strip()
        if current is None or not equals or not key:
            warnings.append(f"line {number}: {line!r} is no key of a section, ignored")
            continue
        if current.get(key, value) != value:
            raise EDSError(f"line {number}: [{name}] {key} is both {current[key]} and {value}")
        current[key] = value
    return sections


# Syntax of values in an EDS: numbers, `$NODEID` formulas, texts and octets (CiA 306, 4.3).


_INTEGER: Final = re.compile(r"^([+-]?)(0x[0-9a-f]{1,32}|[0-9]{1,32})$")
_NODE_ID: Final = re.compile(r"^(?:\$nodeid\+)(.+)$|^(.+)\+\$nodeid$|^\$nodeid()$")


def parse_value(data_type: DataType, text: str, node_id: int, where: str) -> Any:
    """Read a default, a limit or another value of an entry.

    Parameters
    ----------
    text
        Text of the value, not empty.
    node_id
        Node-ID that replaces ``$NODEID``.
    where
        Beginning of an error message.

    Raises
    ------
    EDSError
        The text is no value of the type.
    """
    if data_type in TEXT:
        return text
    if data_type in REAL:
        return _real(data_type, text, where)
    if bounds(data_type) == (0, 0):
        return _octets(data_type, text, where)
    lowered = text.replace(" ", "").lower()
    if found := _NODE_ID.match(lowered):
        value = node_id + parse_integer(next((g for g in found.groups() if g), "0"), where)
    else:
        value = parse_integer(lowered, where)
    low, high = bounds(data_type)
    if data_type in SIGNED and lowered.startswith("0x") and high < value <= 2 * high + 1:
        value -= 2 * int(high) + 2
    if not low <= value <= high:
        raise EDSError(f"{where} is outside {data_type.name}")
    return value


def parse_integer(text: str, where: str) -> int:
    """Read a decimal number, a hexadecimal one with 0x or an octal one with a leading 0.

    Raises
    ------
    EDSError
        The text is no such number; the message begins with ``where``.
    """
    found = _INTEGER.match(text.strip().lower())
    if found is None:
        raise EDSError(f"{where} is no integer")
    digits = found[2]
    octal = len(digits) > 1 and digits.startswith("0") and not digits.startswith("0x")
    try:
        value = int(digits, 8 if octal else 0)
    except ValueError:
        raise EDSError(f"{where} is no octal number") from None
    return -value if found[1] == "-" else value


def _real(data_type: DataType, text: str, where: str) -> float:
    """Read a decimal number, or its bits in hexadecimal, as some tools write it."""
    low, high = bounds(data_type)
    try:
        if text.lower().startswith("0x"):
            raw = int(text, 16).to_bytes(SIZES[data_type], "big")
            value = float(struct.unpack(">f" if data_type == DataType.REAL32 else ">d", raw)[0])
        else:
            value = float(text)
    except (ValueError, OverflowError):
        raise EDSError(f"{where} is no {data_type.name}") from None
    if not low <= value <= high:
        raise EDSError(f"{where} is outside {data_type.name}")
    return value


def _octets(data_type: DataType, text: str, where: str) -> bytes:
    """Read bytes in hexadecimal; a single 0 means zero bytes only."""
    size = SIZES.get(data_type, 0)
    if text.lower() in ("0", "0x0"):
        return bytes(size)
    try:
        data = bytes.fromhex(text.lower().removeprefix("0x"))
    except ValueError:
        raise EDSError(f"{where} is no hexadecimal string") from None
    if size and len(data) != size:
        raise EDSError(f"{where} is not {size} bytes long")
    return data


COMMISSIONING: Final = ("devicecomissioning", "devicecommissioning")
"""Section of a DCF in lower case, with the spelling of the standard and with the right one."""
_NO_NODE_ID: Final = (0, cia.UNCONFIGURED)
"""Node-IDs of files of a device that has none yet."""


def node_id_of(sections: Sections, given: int | None = None) -> int | None:
    """Return the node-ID for which a file is to be loaded.

    Parameters
    ----------
    given
        Node-ID that the user asks for; None for that of the file.

    Returns
    -------
    int or None
        `given`, or that of a DCF; None for an EDS, which has none.

    Raises
    ------
    EDSError
        A DCF is of another node: its values would address that one.
    """
    name = next((name for name in COMMISSIONING if name in sections), COMMISSIONING[0])
    own = _number(sections, name, "nodeid")
    if own in _NO_NODE_ID:
        return given
    if not 1 <= own <= cia.LAST_NODE_ID:
        raise EDSError(f"[{name}] nodeid {own} is outside 1..{cia.LAST_NODE_ID}")
    if given not in (None, own):
        raise EDSError(
            f"the DCF is of node {own}, not of {given}: leave the node-ID out, or make a DCF of "
            f"node {given} by 'smarttac eds dcf'"
        )
    return own


OBJECT: Final = re.compile(r"^[0-9a-f]{4}$")
MEMBER: Final = re.compile(r"^([0-9a-f]{4})sub([0-9a-f]{1,2})$")
_COMPACT: Final = re.compile(r"^([0-9a-f]{4})(name|value|denotation|objectlinks)$")
_OTHER: Final = re.compile(
    r"^(fileinfo|deviceinfo|dummyusage|comments|devicecomm?issioning|dynamicchannels"
    r"|(mandatory|optional|manufacturer)objects|supportedmodules|tools?\d*)$"
)
_LISTS: Final = ("mandatoryobjects", "optionalobjects", "manufacturerobjects")

LONGEST_NAME: Final = 241
MAX_ENTRIES: Final = 32_768
"""Most sub-indices of a device; one line with CompactSubObj makes 255."""

# Compact forms of CiA 306, written out as the sections for which they stand, before anything else
# is read: a compact object then cannot behave otherwise than one that is written out.

_OF_EACH: Final = (
    "datatype", "accesstype", "defaultvalue", "lowlimit", "highlimit", "pdomapping", "objflags",
)  # fmt: skip
"""Keys that a compact object has for each of its sub-indices."""
_COMMUNICATION: Final = {
    cia.PDO_COB_ID: "COB-ID",
    cia.PDO_TRANSMISSION: "Transmission type",
    cia.PDO_INHIBIT: "Inhibit time",
    cia.PDO_RESERVED: "Reserved",
    cia.PDO_EVENT: "Event timer",
    cia.PDO_SYNC_START: "SYNC start value",
}
"""Sub-indices of a communication record; bit n of CompactPDO stands for sub-index n + 1."""
_PDOS: Final = (
    ("nrofrxpdo", "RPDO", cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING, cia.RPDO_IDS),
    ("nroftxpdo", "TPDO", cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING, cia.TPDO_IDS),
)


def write_out(sections: Sections) -> set[int]:
    """Add the sections for which CompactSubObj and CompactPDO stand.

    Returns
    -------
    set of int
        Indices of the objects that were added.

    Raises
    ------
    EDSError
        One of them is no number or out of range, or they stand for more than `MAX_ENTRIES`
        sub-indices.
    """
    described = [name for name in sections if OBJECT.match(name)]
    _write_out_pdos(sections)
    added = 0
    for name in described:
        kind = _number(sections, name, "objecttype", ObjectType.RECORD)
        count = _number(sections, name, "compactsubobj")
        if not count or kind not in (ObjectType.ARRAY, ObjectType.RECORD):
            continue
        if not 1 <= count <= cia.LAST_SUBINDEX:
            raise EDSError(f"[{name}] CompactSubObj {count} is outside 0..{cia.LAST_SUBINDEX}")
        added += count + 1
        if added > MAX_ENTRIES:
            raise EDSError(f"there are more than {MAX_ENTRIES} sub-indices")
        for subindex, section in _members_of_compact(int(name, 16), count, sections):
            if f"{name}sub{subindex:02x}" not in sections:
                sections.setdefault(f"{name}sub{subindex:x}", section)
    return {int(name, 16) for name in sections.keys() - {*described} if OBJECT.match(name)}


def _members_of_compact(
    index: int, count: int, sections: Sections
) -> Iterator[tuple[int, Section]]:
    """Yield the sub-indices of a CompactSubObj (CiA 306, 4.6.3.4).

    Sub-index 0 is read-only, except where CiA 301 lets it count what is in use: the number of
    errors, which 0 clears, and that of mapped objects.
    """
    name = f"{index:04x}"
    keys = sections[name]
    each = {key: keys[key] for key in _OF_EACH if key in keys}
    title = keys.get("parametername") or name.upper()
    whole, opened, unit = title.rpartition("[")
    title, unit = (whole.rstrip(), f" [{unit}") if opened and unit[-1:] == "]" else (title, "")
    first = {"parametername": "NrOfObjects", "datatype": "5", "accesstype": "ro"}
    if cia.is_mapping(index):
        first["accesstype"] = each.get("accesstype", "")
    elif index == cia.ERROR_FIELD:
        first["accesstype"] = "rw"
    else:
        first["defaultvalue"] = f"{count}"
    yield 0, first
    names = sections.get(f"{name}name", {})
    values = sections.get(f"{name}value", {})
    for number in range(1, count + 1):
        member = names.get(str(number)) or f"{title}{number}"
        section = each | {"parametername": member if member[-1:] == "]" else member + unit}
        if (wanted := cia.standard_type(index, number)) is not None:
            section["datatype"] = f"{int(wanted)}"
        if value := values.get(str(number)):
            section["parametervalue"] = value
        yield number, section


def _write_out_pdos(sections: Sections) -> None:
    """Add the PDOs that ``[DeviceInfo]`` counts, but that have no section (CompactPDO)."""
    mask = _number(sections, "deviceinfo", "compactpdo")
    present = [sub for sub in _COMMUNICATION if mask >> sub - 1 & 1]
    for key, kind, communication, mapping, can_ids in _PDOS if present else ():
        wanted = _number(sections, "deviceinfo", key)
        if not 0 <= wanted <= cia.PDO_COUNT:
            raise EDSError(f"[deviceinfo] {key} {wanted} is outside 0..{cia.PDO_COUNT}")
        described = {
            number
            for number in range(cia.PDO_COUNT)
            if {f"{communication + number:04x}", f"{mapping + number:04x}"} & sections.keys()
        }
        free = (number for number in range(cia.PDO_COUNT) if number not in described)
        for number in sorted({*described, *islice(free, max(wanted - len(described), 0))}):
            cob_id = f"$NODEID+0x{can_ids[number]:X}" if number < len(can_ids) else "0x80000000"
            title = f"{kind} {number + 1}"
            _add_record(sections, communication + number, title, present, cob_id)
            _add_record(
                sections, mapping + number, f"{title} mapping", range(1, cia.MOST_MAPPED + 1)
            )


def _add_record(
    sections: Sections, index: int, title: str, subindices: Iterable[int], cob_id: str = ""
) -> None:
    """Add a record of a PDO, whose entries can be written; one with a section of its own stays."""
    name = f"{index:04x}"
    if name in sections:
        return
    values = sections.get(f"{name}value", {})
    sections[name] = {"parametername": title, "objecttype": f"{int(ObjectType.RECORD)}"}
    count = {"parametername": "Number of objects", "datatype": "5", "accesstype": "const"}
    sections.setdefault(f"{name}sub0", count | ({} if cob_id else {"accesstype": "rw"}))
    for subindex in subindices:
        member = _COMMUNICATION[subindex] if cob_id else f"Object {subindex}"
        section = {
            "parametername": member,
            "datatype": f"{cia.standard_type(index, subindex):d}",
            "accesstype": "rw",
        }
        if cob_id and subindex == cia.PDO_COB_ID:
            section["defaultvalue"] = cob_id
        if value := values.get(str(subindex)):
            section["parametervalue"] = value
        sections[f"{name}sub{subindex:x}"] = section


def _number(sections: Sections, name: str, key: str, absent: int = 0) -> int:
    text = sections.get(name, {}).get(key, "")
    return parse_integer(text, f"[{name}] {key}") if text else absent


_Kind = TypeVar("_Kind", DataType, ObjectType)


def load_eds(text: str, node_id: int) -> ObjectDictionary:
    """Load an EDS, or a DCF, in which ParameterValue replaces the default.

    Parameters
    ----------
    text
        Content of the file.
    node_id
        Node-ID that replaces ``$NODEID``, 1..127.

    Returns
    -------
    ObjectDictionary
        Dictionary, whose `warnings` list errors of the file that could be corrected.

    Raises
    ------
    EDSError
        The file cannot be interpreted; one line naming the section.
    ValueError
        `node_id` is no integer, or out of range.
    """
    if not (isinstance(node_id, Integral) and 1 <= node_id <= cia.LAST_NODE_ID):
        raise ValueError(f"node_id {node_id!r} is no integer of 1..127")
    warnings: list[str] = []
    sections = read_sections(text, warnings)
    _warn_about_characters(text, warnings)
    try:
        implied = write_out(sections)
        reader = _Reader(sections, node_id, warnings)
        objects = [
            item
            for name in sections
            if OBJECT.match(name) and (item := reader.object(name)) is not None
        ]
    except EDSError as error:
        raise EDSError(f"{_line_of(text, str(error))}{error}") from error.__cause__
    if not objects:
        raise EDSError("the file has no objects")
    reader.warn_about_leftovers({item.index for item in objects}, implied)
    usage = sections.get("dummyusage", {})
    dummies = frozenset(n for n in range(1, 8) if usage.get(f"dummy{n:04x}", "0") not in ("0", ""))
    return ObjectDictionary(
        node_id, objects, dummies, sections.get("deviceinfo", {}), warnings, text
    )


class _Reader:
    def __init__(self, sections: Sections, node_id: int, warnings: list[str]) -> None:
        self.sections = sections
        self.node_id = node_id
        self.warnings = warnings
        self.entries = 0
        self.members: dict[int, dict[int, str]] = {}
        for name in sections:
            if found := MEMBER.match(name):
                subs = self.members.setdefault(int(found[1], 16), {})
                subindex = int(found[2], 16)
                if subindex in subs:
                    raise EDSError(f"[{name}] and [{subs[subindex]}] are the same sub-index")
                subs[subindex] = name

    def object(self, name: str) -> Object | None:
        """Return the object at an index; None for object types without data."""
        section = self.sections[name]
        index = int(name, 16)
        compact = self._integer(name, "compactsubobj") != 0
        members = self.members.get(index, {})
        if "objecttype" in section:
            object_type = self._enumerated(name, "objecttype", ObjectType)
        else:
            object_type = ObjectType.RECORD if members else ObjectType.VAR
        if object_type in (ObjectType.NULL, ObjectType.DEFTYPE, ObjectType.DEFSTRUCT):
            self.warnings.append(f"[{name}] is of object type {object_type.name}, ignored")
            return None
        title, unit = self._title(name, name.upper())
        if object_type in (ObjectType.VAR, ObjectType.DOMAIN):
            entries = {0: self._entry(name, index, 0, title, unit)}
        else:
            entries = {}
        structured = object_type in (ObjectType.ARRAY, ObjectType.RECORD)
        for subindex, member in sorted(members.items() if structured else ()):
            sub_title, sub_unit = self._title(member, f"{subindex:02X}")
            full = f"{title}.{sub_title}"
            entries[subindex] = self._entry(member, index, subindex, full, sub_unit)
        if not entries:
            raise EDSError(f"[{name}] has no sub-indices")
        if structured and 0 in entries:
            self._set_count(members.get(0, name), entries)
        if index == cia.SDO_SERVER_FIRST:
            self._follow_node_id(entries)
        self._warn_about_count(name, object_type, len(entries), compact)
        return Object(index, title, object_type, entries)

    def _set_count(self, section: str, entries: dict[int, Entry]) -> None:
        """Set sub-index 0 without a value to the number of entries, or to the number in use."""
        keys, count = self.sections[section], entries[0]
        if keys.get("parametervalue") or keys.get("defaultvalue") or count.size != 1:
            return
        highest = max(subindex for subindex in entries if subindex <= cia.LAST_SUBINDEX)
        if count.index == cia.ERROR_FIELD:
            highest = 0
        elif cia.is_mapping(count.index):
            used = takewhile(lambda n: n in entries and entries[n].default, range(1, highest + 1))
            highest = len(list(used))
        count.default = count.value = min(max(highest, int(count.low)), int(count.high))

    def _follow_node_id(self, entries: dict[int, Entry]) -> None:
        """Set the COB-IDs of the default SDO, which CiA 301 derives from the node-ID alone."""
        for subindex, base in ((1, cia.SDO_RX_ID), (2, cia.SDO_TX_ID)):
            entry = entries.get(subindex)
            if entry is None or entry.data_type is not DataType.UNSIGNED32:
                continue
            right = base + self.node_id
            if entry.default not in (0, right):
                self.warnings.append(
                    f"[{entry.index:04X}sub{subindex}] value 0x{entry.default:X} is not that of "
                    f"node-ID {self.node_id}, 0x{right:X} is taken instead"
                )
            entry.default = entry.value = right
            entry.low, entry.high = bounds(entry.data_type)
            entry.per_node = ("default",)

    def _warn_about_count(self, name: str, kind: ObjectType, count: int, compact: bool) -> None:
        if kind in (ObjectType.VAR, ObjectType.DOMAIN):
            if self.members.get(int(name, 16)):
                self.warnings.append(f"[{name}] is a {kind.name}: its sub-indices are ignored")
            return
        stated = self._integer(name, "subnumber", count)
        if stated != count and not compact:
            self.warnings.append(f"[{name}] says SubNumber={stated} but has {count}")

    def _title(self, section: str, absent: str) -> tuple[str, Quantity]:
        title = self.sections[section].get("parametername", "")
        if not title:
            self.warnings.append(f"[{section}] has no ParameterName")
        _require_short(title, f"[{section}] ParameterName")
        try:
            return split_name(title or absent)
        except ValueError as error:
            self.warnings.append(f"[{section}] {error}, taken as part of the name")
            return title, ONE

    def _entry(self, name: str, index: int, subindex: int, title: str, unit: Quantity) -> Entry:
        self.entries += 1
        if self.entries > MAX_ENTRIES:
            raise EDSError(f"there are more than {MAX_ENTRIES} sub-indices")
        section = self.sections[name]
        domain = self._integer(name, "objecttype", ObjectType.VAR) == ObjectType.DOMAIN
        if domain and not section.get("datatype"):
            data_type = DataType.DOMAIN
        else:
            data_type = self._enumerated(name, "datatype", DataType)
        data_type = self._of_standard(name, index, subindex, data_type)
        access = section.get("accesstype", "").lower() or ("rw" if domain else "")
        if access not in ACCESS:
            raise EDSError(f"[{name}] AccessType {access!r} is none of {', '.join(ACCESS)}")
        text = section.get("parametervalue") or section.get("defaultvalue", "")
        default = self._value(name, data_type, text) if text else zero(data_type)
        low, high = (self._limit(name, data_type, key) for key in ("lowlimit", "highlimit"))
        least, most = bounds(data_type)
        if (least if low is None else low) > (most if high is None else high):
            self.warnings.append(f"[{name}] LowLimit {low} is above HighLimit {high}, both ignored")
            low = high = None
        if not text and bounds(data_type) != (0, 0):
            default = min(
                max(default, least if low is None else low), most if high is None else high
            )
        if (low is not None and default < low) or (high is not None and default > high):
            self.warnings.append(f"[{name}] default {default} is outside its limits {low}..{high}")
        pdo = self._integer(name, "pdomapping") != 0
        entry = Entry(
            index, subindex, title, data_type, access,
            low=low, high=high, default=default, pdo=pdo, unit=unit,
        )  # fmt: skip
        if data_type not in TEXT:
            values = {"default": text, "low": section.get("lowlimit", "")}
            values["high"] = section.get("highlimit", "")
            entry.per_node = tuple(key for key, value in values.items() if _per_node(value))
        return entry

    def warn_about_leftovers(self, known: set[int], implied: set[int]) -> None:
        """Warn about sections without an object, and differences to the lists of objects."""
        for name in self.sections:
            found = MEMBER.match(name) or _COMPACT.match(name)
            if found is not None:
                if int(found[1], 16) not in known:
                    self.warnings.append(f"[{name}] belongs to no object, ignored")
            elif not OBJECT.match(name) and not _OTHER.match(name):
                self.warnings.append(f"section [{name}] is not known, ignored")
        listed = {
            self._integer(name, key)
            for name in _LISTS
            for key in self.sections.get(name, {})
            if key.isdigit()
        }
        for index in sorted(listed - known):
            self.warnings.append(f"[{index:04X}] is listed but not described")
        for index in sorted(known - listed - implied):
            self.warnings.append(f"[{index:04X}] is described but not listed")

    def _of_standard(self, name: str, index: int, subindex: int, stated: DataType) -> DataType:
        """Return the data type of an entry, for an object of CiA 301 one with which it can work.

        Unsigned integers of another size are left as they are, as a device may have them.
        """
        wanted = cia.standard_type(index, subindex)
        if wanted is None and not subindex and MEMBER.match(name):
            known = cia.COMMUNICATION_FIRST <= index <= cia.COMMUNICATION_LAST
            wanted = DataType.UNSIGNED8 if known else None
        if wanted not in UNSIGNED or stated in UNSIGNED or stated is DataType.BOOLEAN:
            return stated
        same = (kind for kind, size in UNSIGNED.items() if SIGNED.get(stated) == size)
        taken = DataType(next(same, wanted))
        self.warnings.append(f"[{name}] is {stated.name}, and taken as {taken.name}, as in CiA 301")
        return taken

    def _integer(self, section: str, key: str, absent: int = 0) -> int:
        return _number(self.sections, section, key, absent)

    def _enumerated(self, section: str, key: str, kind: type[_Kind]) -> _Kind:
        value = self._integer(section, key)
        try:
            return kind(value)
        except ValueError:
            raise EDSError(f"[{section}] {key} 0x{value:X} is not supported") from None

    def _limit(self, section: str, data_type: DataType, key: str) -> float | None:
        text = self.sections[section].get(key, "")
        if not text or data_type in TEXT or bounds(data_type) == (0, 0):
            return None
        value: float = self._value(section, data_type, text)
        return value

    def _value(self, section: str, data_type: DataType, text: str) -> Any:
        if data_type is DataType.VISIBLE_STRING and (taken := visible(text)) != text:
            self.warnings.append(
                f"[{section}] value {text!r} is no VISIBLE_STRING, {taken!r} is taken instead"
            )
            text = taken
        return parse_value(data_type, text, self.node_id, f"[{section}] value {text!r}")


def _line_of(text: str, message: str) -> str:
    """Return ``line 7: `` for a message that begins with a section, and perhaps a key of it."""
    found = re.match(r"\[(\w+)\]\s+(\w*)", message)
    inside, where = False, ""
    for number, raw in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        line = raw.strip().lower()
        if line.startswith("["):
            inside = found is not None and line.startswith(f"[{found[1].lower()}]")
            where = f"line {number}: " if inside and not where else where
        elif inside and found and line.partition("=")[0].strip() == found[2].lower():
            return f"line {number}: "
    return where


def _warn_about_characters(text: str, warnings: list[str]) -> None:
    lines = text.removeprefix("\ufeff").splitlines()
    odd = [number for number, line in enumerate(lines, 1) if not line.isascii()]
    if odd:
        more = f" and of {len(odd) - 1} more" if len(odd) > 1 else ""
        warnings.append(f"line {odd[0]}{more}: not all characters are ASCII")


def _require_short(name: str, what: str) -> None:
    if len(name) > LONGEST_NAME:
        raise EDSError(f"{what} is longer than {LONGEST_NAME} characters")


def _per_node(text: str) -> bool:
    return "$nodeid" in text.lower()
