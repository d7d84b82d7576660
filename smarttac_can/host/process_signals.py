"""Signals that end a process as a question a loop can ask, so that it ends in its own time."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_ENDING = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGXCPU")  # Windows has the first two
    if hasattr(signal, name)
]
"""SIGXCPU is for a process of real-time priority that does not wait any more."""


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
