"""When the machine itself stood still, seen by a sleeper of high priority on each core."""

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
    """A span in which a core did not run what it had to, in s since the epoch."""

    begin: float
    end: float


class Machine:
    """What the sleepers have seen; `watching_machine` makes one.

    Parameters
    ----------
    cores
        Processors that are watched.
    """

    def __init__(self, cores: list[int]) -> None:
        self.cores = cores
        self.fifo = False
        """Whether the sleepers were given their priority: without it they show the load."""
        self._latest = _FORK.RawArray("q", len(cores))
        self._count = _FORK.RawArray("q", len(cores))
        self._times = [_FORK.RawArray("q", 2 * _MOST) for _ in cores]

    def forget(self) -> None:
        """Forget all standstills and delays up to now."""
        for at in range(len(self.cores)):
            self._latest[at] = self._count[at] = 0

    @property
    def longest_s(self) -> list[float]:
        """How late the sleeper on each core was at worst, in s."""
        return [late * 1e-9 for late in self._latest]

    @property
    def standstills(self) -> list[Standstill]:
        """Those of more than 1 ms, in turn; of each core the first 65 536."""
        return sorted(
            Standstill(times[2 * at] * 1e-9, times[2 * at + 1] * 1e-9)
            for count, times in zip(self._count, self._times, strict=True)
            for at in range(min(count, _MOST))
        )

    def stood_s(self, begin: float, end: float) -> float:
        """Return the longest standstill in s that touches a span of time, 0.0 if none did."""
        return max(
            (s.end - s.begin for s in self.standstills if s.end >= begin and s.begin <= end),
            default=0.0,
        )

    def sleep_by_the_ms(self, at: int, priority: int) -> None:
        """Wake each ms on a core for good, and note when that was late."""
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
    """Run a function as a process until the block ends; it does not outlive its parent either.

    Fork before there are threads, which a fork does not take along.
    """
    process = _FORK.Process(target=_as_a_child, args=(work, arguments), daemon=True)
    process.start()
    try:
        yield process
    finally:
        process.kill()
        process.join()


def _as_a_child(work: Callable[..., None], arguments: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # its parent ends it
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    end_with_parent()
    work(*arguments)


@contextmanager
def watching_machine(realtime: int | None = None) -> Iterator[Machine]:
    """Have a sleeper on each processor until the block ends.

    Parameters
    ----------
    realtime
        Priority of what is measured in SCHED_FIFO; the sleepers are above it.
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
