"""Where the EDS files that describe the nodes are."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Final

from smarttac_can.host.bounded_file import read_bounded

MAX_BYTES: Final = 4 << 20
"""Of an EDS: those of our own have 57 KB at most."""


def read_eds(name: str) -> str:
    """Return the text of an EDS file of this package.

    Parameters
    ----------
    name
        Name of the file, e.g. ``plate.eds``.

    Raises
    ------
    FileNotFoundError
        If neither the installed package nor the source tree has it.
    """
    packaged = resources.files("smarttac_can") / "eds" / name
    source_tree = Path(__file__).parents[2] / "eds" / name
    for place in (packaged, source_tree):
        if place.is_file():
            return place.read_text(encoding="ascii")
    raise FileNotFoundError(f"there is no EDS file {name} in the package or its source tree")


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
