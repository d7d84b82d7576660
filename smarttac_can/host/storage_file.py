"""A file that holds either the old bytes or the new ones, wherever the power fails."""

from __future__ import annotations

import os
from pathlib import Path


class StorageFile:
    """Storage of a device in one file.

    Parameters
    ----------
    path
        The file; it need not exist, its directory must.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self) -> bytes | None:
        """Content of the file, None if there is none; raises `OSError` if it cannot be read."""
        try:
            return self._path.read_bytes()
        except FileNotFoundError:
            return None

    def write(self, data: bytes) -> None:
        """Replace the file as a whole; on `OSError` the old one is still there."""
        written = self._path.with_name(self._path.name + ".new")
        with written.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        written.replace(self._path)
        _sync_directory(self._path.parent)


def _sync_directory(path: Path) -> None:
    """Make the new name last; Windows cannot open directories and does it by itself."""
    if os.name == "nt":
        return
    directory = os.open(path, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)
