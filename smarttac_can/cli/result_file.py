"""Files for the results of a long run: refused before it, or written when all of it is there."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import click

result_path = click.Path(dir_okay=False, writable=True, path_type=Path)
"""Parameter type of such a file."""


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
