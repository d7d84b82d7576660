"""What is wrong with a file that a person named, in words, with the folder that is to be made."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def reason(error: OSError) -> str:
    """Say what hinders, without the name of the file."""
    if error.filename is not None and isinstance(error, FileNotFoundError | NotADirectoryError):
        folders = list(reversed(Path(error.filename).parents))
        for folder in folders:
            if not folder.exists():
                return f"the folder {folder} does not exist"
            if not folder.is_dir():
                return f"{folder} is a file, not a folder"
        if isinstance(error, FileNotFoundError):
            return "there is no such file"
    if isinstance(error, IsADirectoryError):
        return "that is a folder, not a file"
    return error.strerror or str(error)


def trouble(error: OSError) -> str:
    """Say it after the name of the file, if there is one."""
    return reason(error) if error.filename is None else f"{error.filename}: {reason(error)}"


@contextmanager
def in_words(path: Path | str | None = None) -> Iterator[None]:
    """Have an error of a file say it so; what class it is stays.

    Parameters
    ----------
    path
        The file that is meant where an error names none, as one of writing; None for no such.

    Raises
    ------
    OSError
        Whose text is one line, as from `trouble`.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None:
            if path is None or not error.errno:
                raise
            error.filename = str(path)
        raise type(error)(trouble(error)) from None
