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

_HANGUP: Final = getattr(signal, "SIGHUP", None)
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

    A SIGHUP that is ignored, as by nohup, stays ignored.

    Yields
    ------
    Callable
        Returns whether one of them has come. Only for the main thread, as Python requires.
    """
    caught: list[int] = []

    def remember(number: int, _frame: FrameType | None) -> None:
        caught.append(number)

    caught_here = [number for number in _ENDING if not _is_ignored_hangup(number)]
    previous = {number: signal.signal(number, remember) for number in caught_here}
    try:
        yield lambda: bool(caught)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _is_ignored_hangup(number: int) -> bool:
    return number == _HANGUP and signal.getsignal(number) is signal.SIG_IGN


@contextmanager
def endings_interrupt() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the block like Ctrl-C, by `KeyboardInterrupt`, with its clean-up.

    It does nothing outside the main thread, or for a signal that is ignored or has a handler.
    """
    main = threading.current_thread() is threading.main_thread()
    endings = [signal.SIGTERM] if _HANGUP is None else [signal.SIGTERM, _HANGUP]
    free = [number for number in endings if signal.getsignal(number) is signal.SIG_DFL]
    if not main:
        free = []
    for number in free:
        signal.signal(number, signal.default_int_handler)
    try:
        yield
    finally:
        for number in free:
            signal.signal(number, signal.SIG_DFL)


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
