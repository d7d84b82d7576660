"""What ends a process in its own time: signals, as a question a loop can ask, and its parent's end.

Whatever this project begins as a process calls `end_with_parent` there.
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
"""SIGXCPU is for a process of real-time priority that does not wait any more."""

_PARTING_S: Final = 5.0
_SOME_BYTES: Final = 4096


def end_with_parent() -> None:
    """End this process with the one that began it, even if that is killed, as SIGTERM does.

    It ends in 5 s in any case. A process of `multiprocessing` knows its parent; any other has for
    its standard input a pipe whose other end the parent holds.
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
    """Catch SIGINT, SIGTERM, a closed terminal and SIGXCPU in the block, then let go of them.

    Yields
    ------
    Callable
        Whether one of them has come. To be used in the main thread, as Python asks for.
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
    """Have SIGTERM end the block as Ctrl-C does, by `KeyboardInterrupt`, so that it is cleaned up.

    Outside of the main thread, or where somebody else handles SIGTERM, it does nothing.
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
    """Have Ctrl-C wait until the block asks for it, so that nothing is torn; a second one acts.

    Outside of the main thread, or where somebody else handles Ctrl-C, it does nothing.

    Yields
    ------
    Callable
        Whether Ctrl-C has come.
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
