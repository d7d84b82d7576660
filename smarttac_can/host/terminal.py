"""Output on a terminal: progress of a long run, and lines that may have no reader."""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from html import escape
from math import inf
from multiprocessing import parent_process
from select import select
from time import monotonic
from typing import Any, Final, Protocol

from smarttac_can.host.background import Background

# Progress is a bar on a terminal or in a notebook. Elsewhere, as in a log file, it is a few lines,
# so that a run of minutes is not taken for one that hangs. Both go to stderr, because stdout is for
# the results.


_STEPS: Final = 1000
_EVERY_S: Final = 0.1
_LINE_EVERY_S: Final = 10.0
"""Least time in s before the first line of progress, and between two."""
_LINE_SHARE: Final = 0.1
"""Least progress between two lines."""
_NO_TERMINAL: Final = (OSError, ValueError)
"""Errors of a stream that is gone, closed, or cannot encode the characters."""
_SHOWN: Final = threading.Lock()
"""Held while a bar may be shown, so that there is only one at a time."""


class _Bar(Protocol):
    def draw(self, share: float) -> None:
        """Show the fraction that is done, 0..1."""

    def end(self) -> None:
        """Leave the bar as it is."""


@contextmanager
def progress_bar(label: str, after: float = 0.0) -> Iterator[Callable[[float], None]]:
    """Show a bar during the block; yields a function to call with the fraction done, 0..1.

    Without a terminal or notebook a run of more than 10 s prints a line then, and at most ten
    others. Nothing is shown in a worker process, and while another bar is shown. If the terminal
    fails, the bar ends and the block goes on.

    Parameters
    ----------
    label
        Text beside the bar.
    after
        Time in s after which the bar is shown.
    """
    bar = _bar(label)
    if bar is None or not _SHOWN.acquire(blocking=False):
        yield lambda _share: None
        return
    begins, next_at = monotonic() + after, 0.0

    def progress(share: float) -> None:
        nonlocal next_at
        now = monotonic()
        if now < begins or (now < next_at and share < 1.0):
            return
        next_at = now + _EVERY_S
        try:
            bar.draw(share)
        except _NO_TERMINAL:
            next_at = inf

    try:
        if not after:
            progress(0.0)
        yield progress
    finally:
        if 0.0 < next_at < inf:
            with suppress(*_NO_TERMINAL):
                bar.end()
        _SHOWN.release()


def _bar(label: str) -> _Bar | None:
    if parent_process() is not None:
        return None
    if _in_notebook():
        return _NotebookBar(label)
    with suppress(*_NO_TERMINAL):
        if sys.stderr is not None:
            return _TerminalBar(label) if sys.stderr.isatty() else _Lines(label)
    return None


def _in_notebook() -> bool:
    """Return whether a Jupyter kernel runs this process; IPython on a terminal has no kernel."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return getattr(shell, "kernel", None) is not None


class _TerminalBar:
    def __init__(self, label: str) -> None:
        import click  # noqa: PLC0415 - loaded only when a bar is shown

        self._bar = click.progressbar(range(_STEPS), label=label, file=sys.stderr)

    def draw(self, share: float) -> None:
        self._bar.make_step(round(share * _STEPS) - self._bar.pos)
        self._bar.render_progress()

    def end(self) -> None:
        self._bar.render_finish()


class _Lines:
    """Progress where a bar cannot be drawn anew, such as a file or the pipe of another program."""

    def __init__(self, label: str) -> None:
        self._label = label
        self._begun = monotonic()
        self._next_at, self._next_share = self._begun + _LINE_EVERY_S, 0.0

    def draw(self, share: float) -> None:
        now = monotonic()
        if now < self._next_at or share < self._next_share or share >= 1.0:
            return
        self._next_at, self._next_share = now + _LINE_EVERY_S, share + _LINE_SHARE
        passed = now - self._begun
        left = f", about {passed * (1.0 / share - 1.0):.0f} s left" if share else ""
        sys.stderr.write(f"{self._label}: {share:.0%} after {passed:.0f} s{left}\n")
        sys.stderr.flush()

    def end(self) -> None:
        pass


class _NotebookBar:
    def __init__(self, label: str) -> None:
        self._label = escape(label)
        self._handle: Any = None

    def draw(self, share: float) -> None:
        from IPython.display import HTML, display  # noqa: PLC0415 - imported already by a notebook

        text = f'{self._label} <progress value="{share:.3f}" max="1"></progress> {share:.0%}'
        if self._handle is None:
            self._handle = display(HTML(text), display_id=True)
        else:
            self._handle.update(HTML(text))

    def end(self) -> None:
        pass


_MOST_LINES: Final = 1000
_PARTING_S: Final = 0.1


class LineWriter(Background):
    """Writes lines in a separate thread, so that the caller never waits.

    It is a context manager that leaves within 0.1 s.

    If no process reads the lines, the newest ones are dropped and counted. The count precedes the
    next line that is read.

    Parameters
    ----------
    descriptor
        File descriptor of a pipe, file or terminal. It is duplicated and not changed: making a
        terminal non-blocking would affect every program on it.

    Attributes
    ----------
    dropped
        Number of lines dropped because the earlier ones were not read.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = os.dup(descriptor)
        self._lines: deque[str] = deque()
        self._more = threading.Semaphore(0)
        self._reported = 0
        self.dropped = 0
        super().__init__("line writer", self._run, self._part, _PARTING_S)

    def write(self, line: str) -> None:
        """Queue a line, which must not be empty."""
        if len(self._lines) >= _MOST_LINES:
            self.dropped += 1
            return
        self._lines.append(line)
        self._more.release()

    def _part(self) -> None:
        self._lines.append("")
        self._more.release()

    def _run(self) -> None:
        try:
            while True:
                self._more.acquire()
                line = self._lines.popleft()
                if not line:
                    return
                dropped = self.dropped - self._reported
                if dropped:
                    self._reported += dropped
                    line = f"({dropped} lines dropped: nobody read them)\n{line}"
                self._put(f"{line}\n".encode())
        except OSError:
            # The terminal is closed. Without it the node still goes on, and ends at 0 V.
            pass
        finally:
            os.close(self._descriptor)

    def _put(self, data: bytes) -> None:
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:  # another program has made the terminal non-blocking
                select((), (self._descriptor,), ())
