"""Files that a person names: read if they are files, and not larger than they can sensibly be."""

from __future__ import annotations

import errno
import os
import stat
import sys
from io import BufferedReader, BufferedWriter
from pathlib import Path
from typing import Final

if sys.platform == "win32":
    _FLAGS: Final = os.O_RDONLY | os.O_BINARY
    _NEW: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_BINARY
else:
    _FLAGS: Final = os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY
    _NEW: Final = os.O_WRONLY | os.O_CREAT | os.O_EXCL


def open_regular(path: Path) -> BufferedReader:
    """Open a regular file, or a link to one; never wait for it.

    Raises
    ------
    OSError
        If it is something else, such as a pipe, a device or a directory, or cannot be opened.
    """
    # Looked at before as well, because opening alone makes some devices act.
    _require_regular(path, path.stat())
    file = os.fdopen(os.open(path, _FLAGS), "rb")
    try:
        _require_regular(path, os.fstat(file.fileno()))
    except OSError:
        file.close()
        raise
    return file


def create_regular(path: Path) -> BufferedWriter:
    """Make a new file to write to, in place of what had its name; follow no link, wait for nothing.

    Raises
    ------
    OSError
        If it cannot be made, as in the place of a directory.
    """
    path.unlink(missing_ok=True)
    return os.fdopen(os.open(path, _NEW, 0o666), "wb")


def read_bounded(path: Path, most: int) -> bytes:
    """Return the content of a regular file of `most` bytes at most; of another, read one more.

    Raises
    ------
    OSError
        If it is larger, and as for `open_regular`.
    """
    with open_regular(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise too_large(path, most)
    return data


def too_large(path: Path, most: int) -> OSError:
    """Error that says so, with the bound in bytes."""
    return OSError(errno.EFBIG, f"is larger than {most} bytes", str(path))


def _require_regular(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "is no regular file", str(path))
