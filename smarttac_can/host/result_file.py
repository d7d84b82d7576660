"""A file for results, whose errors name it, and which replaces an old one as a whole."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedWriter, FileIO, TextIOWrapper
from pathlib import Path
from typing import Any, TextIO


@contextmanager
def result_file(path: Path) -> Iterator[TextIO]:
    r"""Open a file that takes the place of an old one when all of it is written.

    It is UTF-8 with lines that end in ``\n``. A block that fails leaves the old one.

    Raises
    ------
    OSError
        If it cannot be written; names it.
    """
    if path.exists() and not path.is_file():  # such as /dev/stdout, or a pipe
        with _opened(path, path) as file:
            yield file
        return
    behind_links = path.resolve()
    part = behind_links.with_name(f"{behind_links.name}.part")
    try:
        with _opened(part, path) as file:
            yield file
        part.replace(behind_links)
    finally:
        with suppress(OSError):  # why it could not be opened is the reason to tell
            part.unlink()


def _opened(path: Path, name: Path) -> TextIO:
    raw = _NamedFile(path, name)
    return TextIOWrapper(BufferedWriter(raw), encoding="utf-8", newline="\n")


class _NamedFile(FileIO):
    """A file whose errors, also of writing, have the name that a person gave.

    Parameters
    ----------
    path
        The file.
    name
        What it is called.
    """

    def __init__(self, path: Path, name: Path) -> None:
        self._named = str(name)
        try:
            super().__init__(path, "w")
        except OSError as error:
            error.filename = self._named
            raise

    def write(self, data: Any) -> int:
        """Write some of it."""
        try:
            return super().write(data)
        except OSError as error:
            error.filename = self._named
            raise
