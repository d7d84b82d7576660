"""Files for the results of a long run: refused before it, or written when all of it is there."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TextIO

import click

result_path = click.Path(dir_okay=False, writable=True, path_type=Path)
"""Parameter type of such a file."""
json_file_option = click.option(
    "--json",
    "json_file",
    type=result_path,
    help="File for the results; - is stdout.",
)
json_option = click.option(
    "--json",
    "json_file",
    type=result_path,
    is_flag=False,
    flag_value="-",
    help="File for the results; - is stdout, and so is none.",
)
"""The same for a command whose results are all that it prints."""


def opened_results(stack: ExitStack, json_file: Path | None) -> TextIO | None:
    """Open the file for the results before the run; None for none."""
    if json_file is None:
        return None
    if json_file == Path("-"):
        return sys.stdout
    return stack.enter_context(result_file(json_file))


def report_results(results: object, lines: Iterable[str], file: TextIO | None) -> None:
    """Write results to their file, and lines to stdout unless it has the results."""
    if file is not None:
        click.echo(json.dumps(results, indent=2), file)
    if file is not sys.stdout and (text := "\n".join(lines)):
        click.echo(text)


@contextmanager
def result_file(path: Path) -> Iterator[TextIO]:
    """Open a file that takes the place of an old one when all of it is written.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    if path.exists() and not path.is_file():  # such as /dev/stdout, or a pipe
        with path.open("w", encoding="utf-8") as file:
            yield file
        return
    path = path.resolve()
    part = path.with_name(f"{path.name}.part")
    try:
        file = part.open("w", encoding="utf-8")
    except OSError as error:
        error.filename = str(path)
        raise
    try:
        with file:
            yield file
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
