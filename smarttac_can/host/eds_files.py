"""Where the EDS files that describe the nodes are."""

from __future__ import annotations

from importlib import resources
from pathlib import Path


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
    """Return the text of an EDS or DCF of any maker: ASCII by rule, UTF-8 or Latin-1 in practice.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    data = path.read_bytes()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")
