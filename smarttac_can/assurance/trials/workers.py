"""Worker processes that share work, and end with the process that started them."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from typing import Any, TypeVar

from smarttac_can.host.process_signals import end_with_parent

Submit = Callable[..., "Future[Any]"]
"""Function that passes a function of a module, and its arguments, to one of the processes."""
Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


@contextmanager
def sharing(jobs: int) -> Iterator[Submit]:
    """Share work between processes in a block.

    The processes are killed when the block ends early, by Ctrl-C or by an error, and when this
    process is killed. Their work must tolerate that: it opens no files.

    Parameters
    ----------
    jobs
        Number of processes, 1 or more.

    Yields
    ------
    Callable
        Function that submits work, as `ProcessPoolExecutor.submit` does.
    """
    others = set(active_children())
    # Spawned, as a fork would copy the threads of the caller in an unknown state.
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), end_with_parent)

    def submit(work: Callable[..., Any], *args: Any) -> Future[Any]:
        with _interrupts_held():
            return pool.submit(work, *args)

    whole = False
    try:
        yield submit
        whole = True
    finally:
        # An interrupt here would leave processes without a parent that waits for them.
        with _interrupts_held():
            if not whole:
                for process in set(active_children()) - others:
                    process.kill()
            pool.shutdown(cancel_futures=True)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Hold SIGINT back until the end of the block, also in processes that are started meanwhile.

    These inherit the mask. Here the mask alone is not enough: the signal may go to another thread,
    such as one of numpy, and Python then calls the handler in this one.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    came = False

    def hold(*_: object) -> None:
        nonlocal came
        came = True

    is_main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, hold) if is_main else None
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if is_main:
            signal.signal(signal.SIGINT, handler)
        if came:
            signal.raise_signal(signal.SIGINT)


def in_order(
    run: Callable[[Item], Outcome],
    items: Sequence[Item],
    jobs: int,
    progress: Callable[[float], None] = lambda _share: None,
) -> Iterator[Outcome]:
    """Run items in this or in several processes, and yield their results in order.

    Parameters
    ----------
    run
        Function to call with each item; a function of a module, or a `partial` of one.
    items
        Items, which must be picklable unless ``jobs`` is 1.
    jobs
        Number of processes that share the items; with 1 only this process works.
    progress
        Function that is called with the fraction that is done, 0..1.
    """
    for number, outcome in enumerate(_outcomes(run, items, jobs), 1):
        progress(number / len(items))
        yield outcome


def _outcomes(
    run: Callable[[Item], Outcome], items: Sequence[Item], jobs: int
) -> Iterator[Outcome]:
    if jobs == 1:
        yield from map(run, items)
        return
    with sharing(jobs) as submit:
        outcomes = [submit(run, item) for item in items]
        outcomes.reverse()
        while outcomes:
            yield outcomes.pop().result()
