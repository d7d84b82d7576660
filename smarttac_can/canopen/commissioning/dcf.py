"""Device configuration files (CiA 306): an EDS with node-ID, bit rate and values of one device."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from configparser import ConfigParser, SectionProxy
from configparser import Error as ConfigError
from contextlib import suppress
from datetime import datetime
from difflib import get_close_matches
from io import StringIO
from itertools import product
from typing import Any, Final

from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, DataType, ObjectType
from smarttac_can.canopen.od.data_types import UNSIGNED
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import (
    COMMISSIONING,
    EDSError,
    load_eds,
    parse_integer,
    parse_value,
    read_sections,
)
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.units import Quantity

_BIT_RATES: Final = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
"""Bit rates in bit/s for which an EDS has a key."""
_COMMISSIONING: Final = "DeviceComissioning"
"""Name of the section, with the spelling of the standard."""

_SECTION: Final = re.compile(r"^([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?$", re.IGNORECASE)

_VALUES: Final = re.compile(r"^[0-9a-f]{4}value$", re.IGNORECASE)
_NUMBER_AND_UNIT: Final = re.compile(r"([-+]?[\d.,]+(?:[eE][-+]?\d+)?)\s*(.*)", re.ASCII)
_HINTS: Final = 3


def make_dcf(
    text: str,
    *,
    node_id: int,
    bit_rate: int,
    values: Mapping[str, str],
    eds_name: str,
    dcf_name: str,
    now: datetime,
) -> str:
    """Return a DCF: an EDS completed for one device.

    Besides the given values, every default with ``$NODEID`` gets its number as ParameterValue, so
    that readers of the file need not compute it.

    Parameters
    ----------
    text
        Text of the EDS, or of a DCF to change.
    node_id
        Node-ID, 1..127.
    bit_rate
        Bit rate in bit/s, one of those that the EDS lists for the device; any of CiA 301 if the
        EDS lists none.
    values
        Values by name (``Setpoint.Voltage``) or section (``1017``, ``2010sub1``): raw values as
        in an EDS, or quantities with a unit, such as ``80 V``.
    eds_name, dcf_name
        File names for ``[FileInfo]``.
    now
        Date of modification for ``[FileInfo]``.

    Raises
    ------
    EDSError
        If the EDS cannot be interpreted.
    ValueError
        If an object does not exist, has no value or refuses this one, or the EDS does not list
        the bit rate.
    """
    od = load_eds(text, node_id)
    known = bit_rates(od) or _BIT_RATES
    if bit_rate not in known:
        listed = ", ".join(map(str, known))
        raise ValueError(f"bit rate {bit_rate} is none of the device's: {listed}")
    file = _parsed(text)
    _resolve_node_id(file, od)
    for name, value in values.items():
        entry = find_entry(od, name)
        raw = _raw(entry, value)
        _check(entry, raw, node_id, value)
        _set_value(file, od, entry, raw)
    serial = od.number(cia.IDENTITY, 4)
    return _completed(file, od, bit_rate, serial, names=(eds_name, dcf_name), now=now)


def save_dcf(
    text: str,
    values: Mapping[Entry, Any],
    *,
    od: ObjectDictionary,
    bit_rate: int | None,
    serial: int,
    unread: Iterable[str],
    eds_name: str,
    dcf_name: str,
    now: datetime,
) -> tuple[str, list[Entry]]:
    """Return a DCF with the values that a device has.

    Parameters
    ----------
    text
        Text of the EDS, or of a DCF.
    values
        Raw values of the entries that were read.
    od
        Object dictionary of the text, loaded for the node-ID of the device.
    bit_rate
        Bit rate in bit/s; None to leave it as it is in the text.
    serial
        Serial number of the device, for ``LSS_SerialNumber``.
    unread
        Lines about what could not be read, written as comments.
    eds_name, dcf_name, now
        As for `make_dcf`.

    Returns
    -------
    str
        The DCF.
    list of Entry
        Entries whose values a DCF cannot have, as an empty text or one with control characters.
        Comments name them, too.
    """
    file = _parsed(text)
    _resolve_node_id(file, od)
    left = []
    for entry, value in values.items():
        raw = text_of(entry, value)
        if raw is not None:
            _set_value(file, od, entry, raw)
        elif value != entry.default:
            left.append(entry)
    made = _completed(file, od, bit_rate, serial, names=(eds_name, dcf_name), now=now)
    lines = [*unread, *(f"{_where(entry)}: its value has no form in a DCF" for entry in left)]
    return made + "".join(f"; {line}\n" for line in lines), left


def text_of(entry: Entry, value: Any) -> str | None:
    """Return the text that stands for a raw value in an EDS; None if there is none."""
    if isinstance(value, bytes):
        text = value.hex(" ")
    elif (
        isinstance(value, int)
        and entry.data_type in UNSIGNED
        and entry.index <= cia.COMMUNICATION_LAST
    ):
        text = f"0x{value:X}"
    else:
        text = str(value)
    with suppress(EDSError):
        (found,) = read_sections(f"[a]\nb={text}", []).values()
        kept = found.get("b") == text and text.isascii() and entry.data_type is not DataType.DOMAIN
        if text and kept and parse_value(entry.data_type, text, 1, entry.name) == value:
            return text
    return None


def _where(entry: Entry) -> str:
    return f"{entry.index:04X}h:{entry.subindex} {entry.name}"


def _completed(
    file: ConfigParser,
    od: ObjectDictionary,
    bit_rate: int | None,
    serial: int,
    *,
    names: tuple[str, str],
    now: datetime,
) -> str:
    """Return the text of a file with node-ID, bit rate and date of a DCF."""
    info = _section(file, "FileInfo")
    _put(info, "FileName", names[1])
    _put(info, "LastEDS", names[0])
    _put(info, "ModificationTime", now.strftime("%I:%M%p"))
    _put(info, "ModificationDate", now.strftime("%m-%d-%Y"))
    commissioning = _commissioning(file)
    for key, number in {
        "NodeID": od.node_id,
        "NodeName": od.info.get("productname", ""),
        "NetNumber": 0,
        "NetworkName": "",
        "CANopenManager": 0,
        "LSS_SerialNumber": serial,
    }.items():
        _put(commissioning, key, str(number))
    if bit_rate is not None:
        _put(commissioning, "Baudrate", str(bit_rate // 1000))
    written = StringIO()
    file.write(written, space_around_delimiters=False)
    return written.getvalue().rstrip("\n") + "\n"


def bit_rates(od: ObjectDictionary) -> list[int]:
    """Return the bit rates in bit/s that an EDS lists for the device, none in some files."""
    listed = {rate: od.info.get(f"baudrate_{rate // 1000}", "") for rate in _BIT_RATES}
    return [rate for rate, text in listed.items() if text.lower() not in ("", "0", "0x0")]


def _parsed(text: str) -> ConfigParser:
    # Not strict, because some tools write a section in two parts.
    file = ConfigParser(
        delimiters=("=",),
        comment_prefixes=(";",),
        inline_comment_prefixes=(";",),
        strict=False,
        interpolation=None,
    )
    file.optionxform = str  # type: ignore[assignment,method-assign]  # keep the case of keys
    try:
        # Stripped, because an indented line would continue the line before.
        file.read_string("\n".join(line.strip() for line in text.splitlines()))
    except ConfigError as error:
        raise EDSError(str(error).splitlines()[0]) from error
    return file


def _section(file: ConfigParser, name: str) -> SectionProxy:
    """Return a section by its name, ignoring case; create it if it is missing."""
    for section in file.sections():
        if section.lower() == name.lower():
            return file[section]
    file.add_section(name)
    return file[name]


def _commissioning(file: ConfigParser) -> SectionProxy:
    """Return the section of node-ID and bit rate, which many files spell right."""
    other = (name for name in file.sections() if name.lower() in COMMISSIONING)
    return _section(file, next(other, _COMMISSIONING))


def _put(section: SectionProxy, key: str, value: str) -> None:
    """Set a key, in the spelling that it already has."""
    section[next((k for k in section if k.lower() == key.lower()), key)] = value


def _lowered(section: SectionProxy) -> dict[str, str]:
    return {key.lower(): value for key, value in section.items()}


def _resolve_node_id(file: ConfigParser, od: ObjectDictionary) -> None:
    """Write the numbers of ``$NODEID`` formulas, but keep values configured otherwise."""
    before = _lowered(_commissioning(file)).get("nodeid", "")
    for name in file.sections():
        if _VALUES.match(name):
            _resolve(file[name], file[name], od)
        found = _SECTION.match(name)
        if found is None:
            continue
        _resolve(file[name], ("ParameterValue",), od)
        keys = _lowered(file[name])
        formula = keys.get("defaultvalue", "")
        if "$nodeid" not in formula.lower() or "compactsubobj" in keys:
            continue
        entry = od.get(int(found[1], 16), int(found[2] or "0", 16))
        if entry is None:
            continue
        present = keys.get("parametervalue")
        if present and before:
            where = f"[{name}]"
            old = parse_value(entry.data_type, formula, parse_integer(before, where), where)
            if parse_value(entry.data_type, present, od.node_id, where) != old:
                continue
        elif present:
            continue
        number = parse_value(entry.data_type, formula, od.node_id, f"[{name}]")
        _put(file[name], "ParameterValue", f"0x{number:X}")


def _resolve(section: SectionProxy, keys: Iterable[str], od: ObjectDictionary) -> None:
    """Write the numbers of ``$NODEID`` formulas in values that the file gives already."""
    values = _lowered(section)
    for key in list(keys):
        text = values.get(key.lower(), "")
        if "$nodeid" in text.lower():
            where = f"[{section.name}] {key}={text}"
            number = parse_value(DataType.UNSIGNED32, text, od.node_id, where)
            _put(section, key, f"0x{number:X}")


def value_of(entry: Entry, given: str, node_id: int) -> Any:
    """Return the raw value of an entry for a text: raw as in an EDS, or with a unit as ``80 V``.

    Raises
    ------
    ValueError
        It is no value of the entry, or outside its limits.
    """
    raw = _raw(entry, given)
    _check(entry, raw, node_id, given)
    return parse_value(entry.data_type, raw, node_id, entry.name)


def find_entry(od: ObjectDictionary, name: str) -> Entry:
    """Return the entry with a name, or of a section such as ``2010sub1``.

    Raises
    ------
    ValueError
        There is none, or more than one.
    """
    if (called := od.called(name)) is not None:
        return called
    found = _SECTION.match(name)
    if found is None:
        near = get_close_matches(name, [entry.name for entry in od], _HINTS)
        hint = f"; perhaps {' or '.join(near)}" if near else ""
        raise ValueError(f"{name!r} is not in the EDS, or stands for several objects{hint}")
    entry = od.get(int(found[1], 16), int(found[2] or "0", 16))
    if entry is None:
        raise ValueError(f"{name} is not in the EDS")
    return entry


def _raw(entry: Entry, text: str) -> str:
    """Return the raw value as in an EDS for a quantity with a unit; a raw value unchanged."""
    if not text or "$" in text or not isinstance(entry.default, int):
        return text
    with suppress(EDSError):
        parse_integer(text.replace(" ", ""), entry.name)
        return text
    symbol = entry.unit.symbol or ("%" if entry.unit.number < 1 else "")
    if not symbol:
        raise ValueError(f"{entry.name} {text!r} is no raw integer, {entry.low}..{entry.high}")
    with suppress(ValueError):
        if Quantity.parse(text).symbol:
            return str(entry.counts(text))
    raise ValueError(
        f"{entry.name} {text!r} is neither a raw integer nor a number with a unit like {symbol}"
        f"{_perhaps(entry, text)}"
    )


def _perhaps(entry: Entry, text: str) -> str:
    """Return a guess at the meaning: with a decimal point, or with a similar unit; else ""."""
    found = _NUMBER_AND_UNIT.fullmatch(text)
    if found is None or not found[2]:
        return ""
    units = {unit.lower(): unit for unit in _units(entry)}
    for near in get_close_matches(found[2].lower(), units, 1):
        guess = f"{found[1].replace(',', '.')} {units[near]}"
        with suppress(ValueError):
            counts = entry.counts(guess)
            # A guess that would be rounded to 0 is not useful.
            if counts and entry.low <= counts <= entry.high:
                return f"; perhaps {guess!r}"
    return ""


def _units(entry: Entry) -> Iterator[str]:
    """Yield units of the kind of an entry, its own last."""
    symbol = entry.unit.symbol
    for prefix, base in product(("G", "M", "k", "", "u", "n", "m"), (symbol, symbol[1:])):
        with suppress(ValueError):
            entry.counts(f"1 {prefix}{base}")
            yield prefix + base
    yield symbol or "%"


def _check(entry: Entry, text: str, node_id: int, given: str) -> None:
    """Refuse an invalid raw value, with its bounds as raw values and in the unit of the object."""
    if not entry.writable:
        raise ValueError(f"{entry.name} is {entry.access}: it takes no value")
    if not text:
        raise ValueError(f"{entry.name} is given no value")
    if entry.data_type is DataType.DOMAIN:
        raise ValueError(f"{entry.name} is a DOMAIN: its value is a file, not a text")
    where = f"{entry.name} value {text!r}"
    try:
        value = parse_value(entry.data_type, text, node_id, where)
    except EDSError:
        if "$" in text or not isinstance(entry.default, int):
            raise
        # The value is outside the range of its type, and so outside its bounds.
        value = parse_integer(text.replace(" ", ""), where)
    if isinstance(value, int | float) and not entry.low <= value <= entry.high:
        raise ValueError(_outside(entry, value, given, with_unit=given != text))
    if given != text:
        entry.require_kept(value, Quantity.parse(given), entry.name)
    try:
        entry.check(value)
    except Abort as error:
        raise ValueError(f"{entry.name} takes no {text!r}: {error}") from error


def _outside(entry: Entry, raw: float, given: str, *, with_unit: bool) -> str:
    symbol = entry.unit.symbol
    bounds = f"{entry.low}..{entry.high}"
    if not symbol:
        return f"{entry.name} {given} is outside {bounds}"
    low, high = (f"{bound * float(entry.unit.number):.12g}" for bound in (entry.low, entry.high))
    if with_unit:
        return f"{entry.name} {given} is outside {low}..{high} {symbol}"
    text = f"{entry.name} {given} is outside the raw values {bounds}, {low}..{high} {symbol}"
    meant = f"{raw} {symbol}"
    return f"{text}; perhaps {meant!r}" if entry.low <= entry.counts(meant) <= entry.high else text


def _set_value(file: ConfigParser, od: ObjectDictionary, entry: Entry, value: str) -> None:
    """Set the value of an entry in its section, or in the list of a CompactSubObj.

    That list has no sub-index 0, as the number of mapped objects, which gets a section of its own.
    """
    plain = od.objects[entry.index].object_type is ObjectType.VAR
    for name in file.sections():
        found = _SECTION.match(name)
        if found is None or int(found[1], 16) != entry.index:
            continue
        if found[2] is None if plain else found[2] and int(found[2], 16) == entry.subindex:
            _put(file[name], "ParameterValue", value)
            return
    if not entry.subindex:
        own = _section(file, f"{entry.index:04X}sub0")
        _put(own, "ParameterName", entry.name.rpartition(".")[2])
        _put(own, "ObjectType", f"0x{int(ObjectType.VAR):X}")
        _put(own, "DataType", f"0x{int(entry.data_type):04X}")
        _put(own, "AccessType", entry.access)
        _put(own, "ParameterValue", value)
        return
    values = _section(file, f"{entry.index:04X}Value")
    _put(values, str(entry.subindex), value)
    _put(values, "NrOfEntries", str(sum(key.isdigit() for key in values)))
