"""What a person did wrong, in one line on stderr and a non-zero exit."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import click

from smarttac_can.host.bus import BusError
from smarttac_can.master.errors import BenchError
from smarttac_can.od.ini import EDSError


@contextmanager
def plain_errors() -> Iterator[None]:
    """Turn the errors of bus, bench, EDS and files into click's one line."""
    try:
        yield
    except (BenchError, BusError, EDSError) as error:
        raise click.ClickException(_one_line(error)) from error
    except OSError as error:
        what = f"{error.filename}: {error.strerror}" if error.filename else str(error)
        raise click.ClickException(what) from error


@contextmanager
def naming(file: str | Path) -> Iterator[None]:
    """Put the name of the file in front of what is wrong with an EDS."""
    try:
        yield
    except EDSError as error:
        raise click.ClickException(f"{file}: {_one_line(error)}") from error


def need_matplotlib() -> None:
    """Refuse a command that draws, before its work begins, if matplotlib is missing."""
    if find_spec("matplotlib") is None:
        raise click.ClickException(
            "the pictures need matplotlib: pip install 'smarttac-can[report]'"
        )


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
