"""Lines for a terminal that nobody may be reading: whoever says one never waits."""

from __future__ import annotations

import os
import threading
from collections import deque
from select import select
from typing import Final

from smarttac_can.host.background import Background

_MOST_LINES: Final = 1000
_PARTING_S: Final = 0.1


class LineWriter(Background):
    """Writes lines in a thread of its own; a context manager that leaves within 0.1 s.

    Lines that nobody takes are dropped, the newest first, and counted: the next line that is
    taken is preceded by how many there were.

    Parameters
    ----------
    descriptor
        File descriptor of pipe, file or terminal. It is duplicated, and stays as it is: a terminal
        that is made non-blocking would be so for every program on it.

    Attributes
    ----------
    dropped
        How many lines were dropped because nobody took those before.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = os.dup(descriptor)
        self._lines: deque[str] = deque()
        self._more = threading.Semaphore(0)
        self._told = 0
        self.dropped = 0
        super().__init__("line writer", self._write, self._part, _PARTING_S)

    def say(self, line: str) -> None:
        """Have a line written, which is not empty."""
        if len(self._lines) >= _MOST_LINES:
            self.dropped += 1
            return
        self._lines.append(line)
        self._more.release()

    def _part(self) -> None:
        self._lines.append("")
        self._more.release()

    def _write(self) -> None:
        try:
            while True:
                self._more.acquire()
                line = self._lines.popleft()
                if not line:
                    return
                dropped = self.dropped - self._told
                if dropped:
                    self._told += dropped
                    line = f"({dropped} lines dropped: nobody read them)\n{line}"
                self._put(f"{line}\n".encode())
        except OSError:
            # The terminal is closed. The node goes on, and above all ends at 0 V, without a reader.
            pass
        finally:
            os.close(self._descriptor)

    def _put(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # another program has made it so
                select((), (self._descriptor,), ())
