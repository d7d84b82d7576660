"""The EDS of a device with every data type, object type and service, and changes of its text."""

import re
from pathlib import Path
from typing import Final

RICH_EDS: Final = Path(__file__).parent / "eds" / "rich.eds"
RICH: Final = RICH_EDS.read_text()


def changed(section: str, *edits: str) -> str:
    """Rich EDS with keys of a section set (``Key=Value``) or left out (``Key``)."""
    head, found, rest = f"\n{RICH}".partition(f"\n[{section}]\n")
    assert found, section
    body, gap, tail = rest.partition("\n\n")
    for edit in edits:
        key, equals, _ = edit.partition("=")
        body, count = re.subn(rf"(?m)^{key}=.*\n?", "", body)
        assert count <= 1
        body = f"{body.rstrip()}\n{edit}" if equals else body.rstrip()
    return head + found + body + gap + tail


def without(section: str) -> str:
    """Rich EDS without a section."""
    head, found, rest = RICH.partition(f"\n[{section}]\n")
    assert found, section
    return head + "\n" + rest.partition("\n\n")[2]
