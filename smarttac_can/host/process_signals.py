"""End a process properly: by signals that a loop can poll, and together with its parent.

Each process that this project starts calls `end_with_parent`.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from time import sleep
from types import FrameType
from typing import Final

_ENDING = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGXCPU")  # Windows has the first two
    if hasattr(signal, name)
]
"""SIGXCPU comes to a process of real-time priority that does not wait any more."""

_PARTING_S: Final = 5.0
_SOME_BYTES: Final = 4096


def end_with_parent() -> None:
    """End this process when its parent ends, even if that is killed, by SIGTERM.

    It ends within 5 s in any case. A process of `multiprocessing` knows its parent. Any other one
    needs a pipe as its standard input whose other end the parent holds.
    """
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
    else:
        while os.read(0, _SOME_BYTES):
            pass
    os.kill(os.getpid(), signal.SIGTERM)
    sleep(_PARTING_S)
    os._exit(1)


@contextmanager
def stop_on_signals() -> Iterator[Callable[[], bool]]:
    """Catch SIGINT, SIGTERM, SIGHUP (closed terminal) and SIGXCPU during the block.

    Yields
    ------
    Callable
        Returns whether one of them has come. Only for the main thread, as Python requires.
    """
    caught: list[int] = []

    def remember(number: int, _frame: FrameType | None) -> None:
        caught.append(number)

    previous = {number: signal.signal(number, remember) for number in _ENDING}
    try:
        yield lambda: bool(caught)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def sigterm_interrupts() -> Iterator[None]:
    """Let SIGTERM end the block like Ctrl-C, by `KeyboardInterrupt`, so that it is cleaned up.

    It does nothing outside the main thread, or if SIGTERM has another handler.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def interrupt_waits() -> Iterator[Callable[[], bool]]:
    """Delay Ctrl-C until the block polls for it, so that no step is cut; a second one acts at once.

    It does nothing outside the main thread, or if Ctrl-C has another handler.

    Yields
    ------
    Callable
        Returns whether Ctrl-C has come.
    """
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield lambda: False
        return
    caught: list[int] = []

    def remember(number: int, _frame: FrameType | None) -> None:
        if caught:
            raise KeyboardInterrupt
        caught.append(number)

    signal.signal(signal.SIGINT, remember)
    try:
        yield lambda: bool(caught)
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
