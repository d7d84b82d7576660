"""The section and key syntax of EDS files (CiA 306, clause 4.3), tolerant where nothing is lost."""

from __future__ import annotations

import re
from typing import Final

_COMMENT: Final = re.compile(r"(?:^|\s);.*$")


class EDSError(ValueError):
    """An EDS that cannot be interpreted; the message is one line."""


def read_sections(text: str, warnings: list[str]) -> dict[str, dict[str, str]]:
    """Read the sections of a file, names and keys in lower case, values stripped.

    A section that comes twice is merged. Lines that are neither section, key nor comment are left
    out with a warning.

    Raises
    ------
    EDSError
        A key has two different values.
    """
    sections: dict[str, dict[str, str]] = {}
    current: dict[str, str] | None = None
    name = ""
    for number, raw in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        line = _COMMENT.sub("", raw).strip()
        if not line:
            continue
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
