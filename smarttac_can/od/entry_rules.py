"""Rules of CiA 306 for one entry: name, data type, access, limits, default, `$NODEID`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, Final

from smarttac_can.od.cia import DataType, ObjectType
from smarttac_can.od.communication_profile import standard_type
from smarttac_can.od.data_types import TEXT, bounds
from smarttac_can.od.eds_values import parse_integer, parse_value
from smarttac_can.od.entry import ACCESS
from smarttac_can.od.finding import Finding
from smarttac_can.od.ini import EDSError

LONGEST_NAME: Final = 241
_KEYS: Final = frozenset({
    "parametername", "objecttype", "datatype", "accesstype", "defaultvalue", "lowlimit",
    "highlimit", "pdomapping", "subnumber", "compactsubobj", "objflags", "parametervalue",
    "denotation", "uploadfile", "downloadfile",
})  # fmt: skip
_FORMULA: Final = re.compile(r"\$nodeid(\s*\+\s*[0-9a-fx]+)?", re.IGNORECASE)


def check_keys(name: str, section: dict[str, str]) -> Iterator[Finding]:
    """Check what every section of an object has: its name, and no key out of place."""
    title = section.get("parametername", "")
    if not title:
        yield Finding(name, "ParameterName is missing")
    elif len(title) > LONGEST_NAME:
        yield Finding(name, f"ParameterName is longer than {LONGEST_NAME} characters")
    for key in section.keys() - _KEYS:
        yield Finding(name, f"{key} is not known", error=False)
    if section.get("objflags", "") and integer(section["objflags"]) not in range(4):
        yield Finding(name, f"ObjFlags={section['objflags']} is outside 0..3")


def check_entry(name: str, section: dict[str, str], index: int, subindex: int) -> Iterator[Finding]:
    """Check data type, access, mapping flag, limits and default of a VAR or a member."""
    access = section.get("accesstype", "").lower()
    domain = integer(section.get("objecttype", "")) == ObjectType.DOMAIN
    if access not in ACCESS and not (domain and not access):
        given = f"AccessType={access}" if access else "AccessType is missing: it"
        yield Finding(name, f"{given} is none of {', '.join(ACCESS)}")
    if section.get("pdomapping", "0") not in ("0", "1", "0x0", "0x1"):
        yield Finding(name, f"PDOMapping={section['pdomapping']} is neither 0 nor 1")
    text = section.get("datatype", "")
    if domain and not text:
        return
    code = integer(text)
    if code is None or code not in set(DataType):
        yield Finding(name, f"DataType={text} is no data type" if text else "DataType is missing")
        return
    data_type = DataType(code)
    wanted = standard_type(index, subindex)
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
    # A node-ID at each end shows whether formulas keep their limits for all.
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


def integer(text: str) -> int | None:
    """Read an integer; None for anything else."""
    try:
        return parse_integer(text, "")
    except EDSError:
        return None
