"""Where the EDS files that describe the nodes are."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from smarttac_can.host.bounded_file import read_bounded

MAX_BYTES: Final = 4 << 20
"""Of an EDS: those of our own have 57 KB at most."""
_PACKAGE: Final = Path(__file__).parents[1]
PLACES: Final = (_PACKAGE / "eds", _PACKAGE.parent / "eds")
"""In an installed package, and in the source tree."""


def packaged_eds(name: str) -> Path:
    """Find an EDS file of this package.

    Parameters
    ----------
    name
        Name of the file, e.g. ``plate.eds``.

    Raises
    ------
    FileNotFoundError
        If neither the installed package nor the source tree has it.
    """
    for place in PLACES:
        if (place / name).is_file():
            return place / name
    raise FileNotFoundError(f"there is no EDS file {name} in the package or its source tree")


def read_eds(name: str) -> str:
    """Return the text of an EDS file of this package.

    Raises
    ------
    FileNotFoundError
        As `packaged_eds`.
    """
    return packaged_eds(name).read_text(encoding="ascii")


def read_eds_file(path: Path) -> str:
    """Return the text of an EDS or DCF of any maker: ASCII by rule, UTF-8 or Windows' in practice.

    Raises
    ------
    OSError
        If it is no regular file, longer than `MAX_BYTES`, or cannot be read.
    """
    data = read_bounded(path, MAX_BYTES)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")
