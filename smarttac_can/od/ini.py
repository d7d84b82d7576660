"""The section and key syntax of EDS files (CiA 306, clause 4.3), tolerant where nothing is lost."""

from __future__ import annotations

import re
from typing import Final

MAX_LINES: Final = 40_000
"""Lines of a file, which a slow machine reads and writes in 2 s; our own have 3 774 at most."""
MAX_ODD: Final = 1000
"""Lines that are left out or merged, with a warning each; a file with more is no EDS."""

_COMMENT: Final = re.compile(r"(?:^|\s);.*$")
_CONTROL: Final = re.compile(r"[\x00-\x08\x0e-\x1f\x7f-\x9f]")


class EDSError(ValueError):
    """An EDS that cannot be interpreted; the message is one line."""


def read_sections(text: str, warnings: list[str]) -> dict[str, dict[str, str]]:
    """Read the sections of a file, names and keys in lower case, values stripped.

    A section that comes twice is merged. Lines that are neither section, key nor comment are left
    out with a warning.

    Raises
    ------
    EDSError
        A key has two different values, a line has a control character, or there are more than
        `MAX_LINES`, or `MAX_ODD` odd ones.
    """
    sections: dict[str, dict[str, str]] = {}
    current: dict[str, str] | None = None
    name = ""
    for number, raw in enumerate(text.removeprefix("\ufeff").splitlines(), 1):
        line = _COMMENT.sub("", raw).strip()
        if not line:
            continue
        if number > MAX_LINES:
            raise EDSError(f"there are more than {MAX_LINES} lines")
        if len(warnings) > MAX_ODD:
            raise EDSError(f"line {number}: more than {MAX_ODD} lines before it are odd")
        # A name is shown on terminals, which obey such characters.
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
