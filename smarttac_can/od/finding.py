"""What a check of an EDS has found."""

from __future__ import annotations

import re
from typing import Final, NamedTuple

Sections = dict[str, dict[str, str]]
"""An EDS: sections and their keys, both in lower case."""

OBJECT: Final = re.compile(r"^[0-9a-f]{4}$")
MEMBER: Final = re.compile(r"^([0-9a-f]{4})sub([0-9a-f]{1,2})$")


class Finding(NamedTuple):
    """One thing wrong with an EDS."""

    section: str
    """Section in lower case; empty for the file as a whole."""
    message: str
    error: bool = True
    """False for what tools put up with."""

    def __str__(self) -> str:
        """Return the line that is shown."""
        where = f"[{shown(self.section)}] " if self.section else ""
        return f"{where}{'' if self.error else 'warning: '}{self.message}"


def shown(section: str) -> str:
    """Return the name of a section as EDS files write it."""
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
