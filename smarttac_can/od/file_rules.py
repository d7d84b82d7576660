"""Rules of CiA 306 for a file as a whole: its text, its information, its lists of objects."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from smarttac_can.od import cia
from smarttac_can.od.entry_rules import integer
from smarttac_can.od.finding import OBJECT, Finding, Sections

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


def check_text(text: str) -> Iterator[Finding]:
    """Check characters and lengths of the lines."""
    for number, line in enumerate(text.splitlines(), 1):
        if not line.isascii():
            odd = next(character for character in line if not character.isascii())
            yield Finding("", f"line {number}: {odd!r} is not ASCII")
        if len(line) > LONGEST_LINE:
            yield Finding("", f"line {number} is longer than {LONGEST_LINE} characters")


def check_information(sections: Sections, file_name: str) -> Iterator[Finding]:
    """Check [FileInfo], [DeviceInfo], [DummyUsage] and [Comments], and that others are known."""
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
    if all(integer(section.get(rate.lower(), "")) in (0, None) for rate in _BAUD_RATES):
        yield Finding("deviceinfo", "no BaudRate is supported")
    if (integer(section.get("granularity", "")) or 0) > 8 * cia.FRAME_BYTES:
        yield Finding("deviceinfo", "Granularity is above 64")
    for key, subindex in (("VendorNumber", 1), ("ProductNumber", 2), ("RevisionNumber", 3)):
        stated = integer(section.get(key.lower(), ""))
        member = sections.get(f"{cia.IDENTITY:04x}sub{subindex}", {})
        actual = integer(member.get("defaultvalue", ""))
        if stated is not None and actual is not None and stated != actual:
            where = f"{cia.IDENTITY:04X}sub{subindex}"
            yield Finding("deviceinfo", f"{key} 0x{stated:X} is not the 0x{actual:X} of [{where}]")
    for key, first in (
        ("NrOfRXPDO", cia.RPDO_COMMUNICATION),
        ("NrOfTXPDO", cia.TPDO_COMMUNICATION),
    ):
        stated = integer(section.get(key.lower(), ""))
        indices = (int(name, 16) for name in sections if OBJECT.match(name))
        count = sum(first <= index < first + cia.PDO_COUNT for index in indices)
        if stated is not None and stated != count:
            yield Finding("deviceinfo", f"{key}={stated}, but {count} are described")


def _check_comments(section: dict[str, str]) -> Iterator[Finding]:
    count = sum(key.startswith("line") and key != "lines" for key in section)
    stated = integer(section.get("lines", "0"))
    if stated != count:
        yield Finding("comments", f"Lines={section.get('lines')}, but there are {count}")


def check_lists(sections: Sections) -> Iterator[Finding]:
    """Check that the lists of objects and their sections agree."""
    described = {int(name, 16) for name in sections if OBJECT.match(name)}
    listed: dict[int, str] = {}
    for name, what in LISTS.items():
        section = sections.get(name)
        if section is None:
            yield Finding(name, "is missing")
            continue
        yield from _check_count(name, section)
        for key, text in section.items():
            index = integer(text)
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
    if integer(text) != len(numbers):
        yield Finding(name, f"SupportedObjects={text}, but {len(numbers)} are listed")
    elif numbers != list(range(1, len(numbers) + 1)):
        yield Finding(name, f"is not numbered from 1 to {len(numbers)}")


def _right_list(index: int) -> str:
    if index in _MANDATORY:
        return "mandatoryobjects"
    manufacturer = cia.MANUFACTURER_FIRST <= index < cia.PROFILE_FIRST
    return "manufacturerobjects" if manufacturer else "optionalobjects"
