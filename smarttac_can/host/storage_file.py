"""A file that holds either the old bytes or the new ones, wherever the power fails."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Final

from smarttac_can.host.bounded_file import create_regular, read_bounded, too_large

MAX_BYTES: Final = 4 << 20
"""Of what a device stores; a DOMAIN takes up to 1 MiB of it."""


class StorageFile:
    """Storage of a device in one file.

    Parameters
    ----------
    path
        The file, or a link to it; it need not exist, its directory must.

    Attributes
    ----------
    path
        The file, behind all links.
    """

    def __init__(self, path: Path) -> None:
        # A link is followed now: replacing it would leave the file behind it as it was.
        self.path = Path(os.path.realpath(path))
        self._new = self.path.with_name(self.path.name + ".new")

    def read(self) -> bytes | None:
        """Return the content of the file, None if there is none.

        What a power cut has left half written is removed.

        Raises
        ------
        OSError
            If it is no regular file, longer than `MAX_BYTES`, or cannot be read.
        """
        with suppress(OSError):
            self._new.unlink()
        try:
            return read_bounded(self.path, MAX_BYTES)
        except FileNotFoundError:
            return None

    def require_writable(self) -> None:
        """Make what a write begins with, and remove it.

        Raises
        ------
        OSError
            If it cannot be made, as on a file system that is read-only; names the file itself.
        """
        try:
            create_regular(self._new).close()
            self._new.unlink()
        except OSError as error:
            error.filename = str(self.path)
            raise

    def write(self, data: bytes) -> None:
        """Replace the file as a whole; on `OSError` the old one is still there.

        A pipe or a link in the place of the new one is neither waited for nor followed.
        """
        if len(data) > MAX_BYTES:
            raise too_large(self.path, MAX_BYTES)
        with create_regular(self._new) as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        self._new.replace(self.path)
        _sync_directory(self.path.parent)


def _sync_directory(path: Path) -> None:
    """Make the new name last; Windows cannot open directories and does it by itself."""
    if os.name == "nt":
        return
    directory = os.open(path, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)
