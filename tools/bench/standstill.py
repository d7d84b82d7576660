"""Standstills of the machine itself, detected by a process of high priority on each core."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from time import sleep, time_ns
from typing import Any, Final, NamedTuple

from smarttac_can.host.process_signals import end_with_parent

_PRIORITY: Final = 60
_TICK_NS: Final = 1_000_000
_STALLED_NS: Final = 1_000_000
_MOST: Final = 1 << 16
_SETTLING_S: Final = 0.2
_FORK: Final = multiprocessing.get_context("fork")


class Standstill(NamedTuple):
    """A time span in which a core did not run its process, in s since the epoch."""

    begin: float
    end: float


class Machine:
    """Standstills that the processes of `watching_machine` have detected.

    Parameters
    ----------
    cores
        Numbers of the watched processors.
    """

    def __init__(self, cores: list[int]) -> None:
        self.cores = cores
        self.fifo = False
        """Whether the processes have their priority; without it they measure the load."""
        self._latest = _FORK.RawArray("q", len(cores))
        self._count = _FORK.RawArray("q", len(cores))
        self._times = [_FORK.RawArray("q", 2 * _MOST) for _ in cores]

    def forget(self) -> None:
        """Discard all standstills and delays until now."""
        for at in range(len(self.cores)):
            self._latest[at] = self._count[at] = 0

    @property
    def longest_s(self) -> list[float]:
        """Largest delay of the process on each core in s."""
        return [late * 1e-9 for late in self._latest]

    @property
    def standstills(self) -> list[Standstill]:
        """Standstills of more than 1 ms in order of time, the first 65 536 of each core."""
        return sorted(
            Standstill(times[2 * at] * 1e-9, times[2 * at + 1] * 1e-9)
            for count, times in zip(self._count, self._times, strict=True)
            for at in range(min(count, _MOST))
        )

    def stood_s(self, begin: float, end: float) -> float:
        """Return the longest standstill in s that overlaps a time span; 0.0 if there is none."""
        return max(
            (s.end - s.begin for s in self.standstills if s.end >= begin and s.begin <= end),
            default=0.0,
        )

    def sleep_by_the_ms(self, at: int, priority: int) -> None:
        """Wake every 1 ms on a core, endlessly, and record when that was late."""
        os.sched_setaffinity(0, {self.cores[at]})
        with suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        gc.disable()
        times = self._times[at]
        due = time_ns()
        while True:
            due += _TICK_NS
            sleep(max(0, due - time_ns()) * 1e-9)
            now = time_ns()
            late = now - due
            self._latest[at] = max(self._latest[at], late)
            if late > _STALLED_NS:
                count = self._count[at]
                if count < _MOST:
                    times[2 * count], times[2 * count + 1] = due, now
                self._count[at] = count + 1
                due += late // _TICK_NS * _TICK_NS


@contextmanager
def forked(work: Callable[..., None], *arguments: Any) -> Iterator[Any]:
    """Run a function as a process until the block ends; the process also ends with its parent.

    Call it before there are threads, because a fork does not copy them.
    """
    process = _FORK.Process(target=_as_a_child, args=(work, arguments), daemon=True)
    process.start()
    try:
        yield process
    finally:
        process.kill()
        process.join()


def _as_a_child(work: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    end_with_parent()
    work(*arguments)


@contextmanager
def watching_machine(realtime: int | None = None) -> Iterator[Machine]:
    """Run a process on each processor during the block, to detect standstills.

    Parameters
    ----------
    realtime
        SCHED_FIFO priority of the measured processes; the watching ones have a higher priority.
    """
    machine = Machine(sorted(os.sched_getaffinity(0)))
    priority = min(max(_PRIORITY, (realtime or 0) + 1), 99)
    with ExitStack() as stack:
        sleepers = [
            stack.enter_context(forked(machine.sleep_by_the_ms, at, priority))
            for at in range(len(machine.cores))
        ]
        sleep(_SETTLING_S)
        machine.fifo = all(os.sched_getscheduler(s.pid) == os.SCHED_FIFO for s in sleepers)
        machine.forget()
        yield machine
