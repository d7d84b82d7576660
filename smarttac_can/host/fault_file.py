"""A file for lines that change now and then: who has them never waits for it."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from typing import Final

from smarttac_can.host.background import Background
from smarttac_can.host.storage_file import StorageFile

_LONGEST: Final = 500
_UNPRINTABLE: Final = re.compile("[^ -~]")
PERIOD_S: Final = 1.0
"""The file is written at most that often."""


class FaultFile(Background):
    """Keeps lines in a file, in a thread of its own; a context manager that ends with a last look.

    Parameters
    ----------
    file
        Replaced as a whole whenever the lines have changed.
    lines
        Returns them; called in the thread.
    failed
        Called in the thread with the first `OSError`; the lines are tried again.
    period
        Time in s between two looks at the lines, above 0.
    """

    def __init__(
        self,
        file: StorageFile,
        lines: Callable[[], tuple[str, ...]],
        failed: Callable[[OSError], None],
        period: float = PERIOD_S,
    ) -> None:
        self._file = file
        self._lines = lines
        self._failed: Callable[[OSError], None] | None = failed
        self._period = period
        self._kept = lines()
        self._over = threading.Event()
        super().__init__("fault file", self._keep, self._over.set)

    def _keep(self) -> None:
        while not self._over.wait(self._period):
            self._save()
        self._save()

    def _save(self) -> None:
        lines = self._lines()
        if lines == self._kept:
            return
        try:
            self._file.write("".join(f"{line}\n" for line in lines).encode("ascii", "replace"))
        except OSError as error:
            if self._failed is not None:
                self._failed(error)
            self._failed = None
            return
        self._kept = lines


def read_lines(file: StorageFile) -> tuple[str, ...]:
    """Return the lines of a file, none if there is none; raises `OSError`.

    What is no printable ASCII becomes a question mark, and of a line 500 characters are enough.
    """
    lines = (file.read() or b"").decode("latin-1").splitlines()
    return tuple(_UNPRINTABLE.sub("?", line[:_LONGEST]) for line in lines)
