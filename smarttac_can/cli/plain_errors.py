"""What a person did wrong, in one line on stderr and a non-zero exit; and what is only odd."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import click

from smarttac_can.bench.errors import in_shell_words
from smarttac_can.bench.traces import require_matplotlib
from smarttac_can.host.bus import BusError
from smarttac_can.host.file_errors import trouble
from smarttac_can.master.errors import BenchError
from smarttac_can.od.ini import EDSError

_LONGEST_LINE: Final = 500
_MOST_WARNINGS: Final = 20


@contextmanager
def plain_errors(*others: type[Exception]) -> Iterator[None]:
    """Turn the errors of bus, bench, EDS, files, killed processes and others into one line."""
    plain: tuple[type[Exception], ...] = (BenchError, BusError, EDSError, *others)
    try:
        yield
    except KeyboardInterrupt:  # that of a run is an error of the bench as well
        raise
    except plain as error:
        texts = map(in_shell_words, (error, *getattr(error, "__notes__", ())))
        raise click.ClickException(one_line("; ".join(filter(None, texts)))) from error
    except BrokenProcessPool as error:
        raise click.ClickException("a process that shared the work was killed") from error
    except OSError as error:
        raise click.ClickException(one_line(trouble(error))) from error


@contextmanager
def naming(file: str | Path, *others: type[Exception]) -> Iterator[None]:
    """Put the name of the file in front of what is wrong with an EDS, or of other errors."""
    wrong: tuple[type[Exception], ...] = (EDSError, *others)
    try:
        yield
    except wrong as error:
        raise click.ClickException(one_line(f"{file}: {error}")) from error


def warn(file: str | Path, warnings: Sequence[str]) -> None:
    """Say on stderr what is odd about a file; beyond 20 lines only how many more there are."""
    for warning in warnings[:_MOST_WARNINGS]:
        click.echo(one_line(f"{file}: {warning}"), err=True)
    if more := len(warnings[_MOST_WARNINGS:]):
        click.echo(one_line(f"{file}: {more} more warnings"), err=True)


def need_matplotlib() -> None:
    """Refuse a command that draws, before its work begins, if matplotlib is missing."""
    with plain_errors():
        require_matplotlib()


def one_line(text: object) -> str:
    """Make a line of at most 500 characters that a terminal only shows, whatever a file holds."""
    line = " ".join(str(text).split())
    if len(line) > _LONGEST_LINE:
        line = f"{line[:_LONGEST_LINE]}..."
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)
