"""A long soak in independent parts, which may run side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from ctypes import c_double
from itertools import pairwise
from multiprocessing.sharedctypes import RawArray
from typing import Any, Final, NamedTuple

from smarttac_can.trials.soak import CYCLES_PER_HOUR, Soak
from smarttac_can.trials.soak_report import SoakReport, merged
from smarttac_can.trials.workers import sharing

_GOLDEN: Final = 0x9E3779B9
"""Step between the seeds of two parts: 2^32 over the golden ratio, so that none comes twice."""
_SEEDS: Final = 1 << 32
_POLL_S: Final = 0.2

Progress = Callable[[float], None]


class Part(NamedTuple):
    """A part of a soak, a `Soak` of its own."""

    cycles: int
    seed: int


def parts(cycles: int, seed: int) -> list[Part]:
    """Divide a soak into equal parts of an hour at most; the first has the seed of the whole.

    Parameters
    ----------
    cycles
        How long it is, in cycles of 1 ms, 1 or more.
    seed
        Of everything, 0..2^32 - 1.
    """
    count = max(1, -(-cycles // CYCLES_PER_HOUR))
    ends = [cycles * n // count for n in range(count + 1)]
    return [
        Part(end - begin, (seed + n * _GOLDEN) % _SEEDS)
        for n, (begin, end) in enumerate(pairwise(ends))
    ]


def soak_in_parts(
    chosen: Sequence[Part], *, jobs: int = 1, progress: Progress | None = None
) -> SoakReport:
    """Let every part happen; the report is the same whatever the number of processes.

    Parameters
    ----------
    chosen
        One or more.
    jobs
        Processes that share the parts; 1 keeps them in this one.
    progress
        Called with the share that is done, 0..1.

    Raises
    ------
    ValueError
        If a part is shorter than a cycle.
    BrokenProcessPool
        If one of the processes was killed.
    """
    tell = progress or (lambda _share: None)
    if jobs == 1 or len(chosen) == 1:
        return merged(list(_one_by_one(chosen, tell)))
    return merged(_side_by_side(chosen, jobs, tell))


def _one_by_one(chosen: Sequence[Part], tell: Progress) -> Iterator[SoakReport]:
    count = len(chosen)
    for n, part in enumerate(chosen):
        yield Soak(*part, lambda share, n=n: tell((n + share) / count)).run()  # type: ignore[misc]


def _side_by_side(chosen: Sequence[Part], jobs: int, tell: Progress) -> list[SoakReport]:
    shares = RawArray(c_double, len(chosen))
    with sharing(min(jobs, len(chosen)), _tell, shares) as submit:
        results = [submit(_part, n, part) for n, part in enumerate(chosen)]
        pending: set[Future[SoakReport]] = set(results)
        while pending:
            done, pending = wait(pending, _POLL_S)
            for result in done:
                result.result()
            tell(sum(shares) / len(chosen))
        return [result.result() for result in results]


_told: Final[list[Any]] = []
"""Where a process of several tells how far its parts are."""


def _tell(shares: Any) -> None:
    _told.append(shares)


def _part(n: int, part: Part) -> SoakReport:
    (shares,) = _told

    def tell(share: float) -> None:
        shares[n] = share

    return Soak(*part, tell).run()
