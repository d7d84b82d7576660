"""A few fingers of a campaign in a row: what a worker is given at a time."""

from __future__ import annotations

from threading import Lock
from time import perf_counter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from smarttac_can.population.compiled import can_compile
from smarttac_can.population.outcome import Figures
from smarttac_can.population.trial import Campaign, outcome_of

Rows = NDArray[np.float64]
"""A row a finger: the true figures, the measured ones, and how long it ran in s."""
COLUMNS: Final = (*Figures._fields, *(f"measured_{name}" for name in Figures._fields), "seconds")
SIZE: Final = 25
"""Fingers of a chunk: a quarter of a second compiled, so that a stop does not wait long."""
_compiling = Lock()


def parameters(campaign: Campaign) -> dict[str, Any]:
    """Return what all fingers have in common, for JSON."""
    return {
        "seed": campaign.seed,
        "law": campaign.law.name.lower(),
        "vibration_law": campaign.vibration_law.name.lower(),
        "dead_time_us": campaign.dead_time * 1e6,
        "case": campaign.case,
    }


def prepare() -> float:
    """Compile what can be, once in a process; return how long that took in s."""
    begin = perf_counter()
    with _compiling:
        outcome_of(Campaign(), 0)
    return perf_counter() - begin


def run_chunk(campaign: Campaign, numbers: range, compiled: bool) -> tuple[range, Rows]:
    """Run fingers by their numbers.

    Raises
    ------
    RuntimeError
        If this process does not compile where the others do, or the other way round: the last bits
        would depend on who does the work.
    """
    if can_compile() != compiled:
        raise RuntimeError(f"a worker {'lacks' if compiled else 'has'} numba, unlike this process")
    rows = []
    for number in numbers:
        (true, measured), seconds = outcome_of(campaign, number)
        rows.append([*true, *measured, seconds])
    return numbers, np.array(rows)


def chunks_of(missing: NDArray[np.intp]) -> list[range]:
    """Divide rising numbers of fingers into chunks of neighbours."""
    chunks = []
    for stretch in np.split(missing, np.flatnonzero(np.diff(missing) != 1) + 1):
        if len(stretch):
            first, end = int(stretch[0]), int(stretch[-1]) + 1
            chunks += [range(n, min(n + SIZE, end)) for n in range(first, end, SIZE)]
    return chunks
