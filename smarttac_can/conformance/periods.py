"""What comes every period: how long a case listens, and by how much it may be off."""

from __future__ import annotations

from itertools import pairwise

from smarttac_can.conformance.case import Failure
from smarttac_can.conformance.examiner import Arrival, Examiner

SPREAD = 0.4
"""Share by which a period may be off: a bus in use and a computer's clock are in it."""
PERIODS = 8
"""How long a case listens to what comes every period."""
LEAST = 3
"""Arrivals in that time from which their period can be told."""


def mean_gap_ms(arrivals: list[Arrival]) -> float:
    """Return the mean time between two arrivals in ms."""
    gaps = [1000 * (later.time - earlier.time) for earlier, later in pairwise(arrivals)]
    return sum(gaps) / len(gaps)


def periodic(
    examiner: Examiner, can_id: int, name: str, parameter: str, period_ms: int
) -> list[Arrival]:
    """Hear the frames with a CAN-ID for 8 periods, and return them.

    Raises
    ------
    Failure
        If fewer than 3 come, or they do not keep the time; by the names of frame and parameter.
    """
    examiner.drain()
    arrivals = examiner.collect(can_id, 1e-3 * PERIODS * period_ms)
    if len(arrivals) < LEAST:
        raise Failure(f"{len(arrivals)} {name}s in {PERIODS} periods of {period_ms} ms")
    mean = mean_gap_ms(arrivals)
    if abs(mean - period_ms) > SPREAD * period_ms:
        raise Failure(f"{name} every {mean:.0f} ms, {parameter} {period_ms} ms")
    return arrivals
