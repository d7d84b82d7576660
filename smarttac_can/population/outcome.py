"""What came out of a finger's run: steps, static error and chatter of the true and measured COF."""

from __future__ import annotations

from math import inf, nan, sqrt
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from smarttac_can.population.steps import (
    AFTER_MS,
    BEFORE_MS,
    SETTLED_MS,
    Floats,
    Step,
    UndefinedError,
    overshoot_percent,
    rise_time,
    static_error_percent,
)

Flags = NDArray[np.bool_]
LEARNING: Final = 4
"""Switches of the reference that are not judged: a law may learn the finger there."""
NO_STEP: Final = 100.0
"""Overshoot in % that a finger without a step counts as."""
_TIME_MS: Final = np.arange(-BEFORE_MS, AFTER_MS + 1, dtype=np.float64)


class Figures(NamedTuple):
    """Of one curve of the COF."""

    rise_time_ms: float
    """Infinite without a step."""
    overshoot_percent: float
    static_error_percent: float
    """NaN without a usable touch."""
    chatter: float
    """Standard deviation while the reference and the finger's pace are constant; NaN if never."""


class Traces(NamedTuple):
    """A run, one element a tick."""

    mu_true: Floats
    mu: Floats
    """Measured; 0 without contact."""
    right: Floats
    """1.0 where the reference is that right of the boundary."""
    steady: Flags
    """Whether force and speed of the finger are constant."""


class Outcome(NamedTuple):
    """What is kept of a finger."""

    true: Figures
    measured: Figures


def outcome(run: Traces, mu_left: float, mu_right: float) -> Outcome:
    """Judge a run between these references."""
    switches = np.flatnonzero(np.diff(run.right)) + 1
    touching = run.mu > 0.0
    judged = switches[LEARNING:]
    up = [n for n in judged.tolist() if run.right[n] and _whole(n, touching, run.right)]
    around = np.array(up, dtype=np.intp)[:, None] + np.arange(-BEFORE_MS, AFTER_MS + 1)
    settled = run.steady & touching
    settled[: judged[0] if len(judged) else None] = False
    for begin in (*judged.tolist(), *(np.flatnonzero(touching[1:] & ~touching[:-1]) + 1).tolist()):
        settled[begin : begin + SETTLED_MS] = False
    true, measured = (
        _figures(mu, around, settled, (mu_left, mu_right)) for mu in (run.mu_true, run.mu)
    )
    return Outcome(true, measured)


def _whole(switch: int, touching: Flags, right: Floats) -> bool:
    """Whether a touch is there from 20 ms before to 80 ms after, with one switch."""
    window = slice(switch - BEFORE_MS, switch + AFTER_MS + 1)
    alone = np.count_nonzero(np.diff(right[window])) == 1
    return bool(alone and len(right) >= window.stop and touching[window].all())


def _figures(
    mu: Floats, around: NDArray[np.intp], settled: Flags, references: tuple[float, float]
) -> Figures:
    """Judge a curve of the COF by the ticks around each up-step, and by those that are settled."""
    chatter = _chatter(mu, settled)
    if not len(around):
        return Figures(inf, NO_STEP, nan, chatter)
    step = Step(_TIME_MS, mu[around].mean(axis=0), *references)
    static = static_error_percent(step)
    try:
        return Figures(rise_time(step), overshoot_percent(step), static, chatter)
    except UndefinedError:
        return Figures(inf, NO_STEP, static, chatter)


def _chatter(mu: Floats, settled: Flags) -> float:
    """Return the standard deviation within stretches of settled ticks, each about its own mean."""
    edges = np.flatnonzero(np.diff(settled, prepend=False, append=False))
    if not len(edges):
        return nan
    lengths = edges[1::2] - edges[::2]
    padded = np.append(mu, 0.0)
    means = np.add.reduceat(padded, edges)[::2] / lengths
    deviations = mu[settled] - np.repeat(means, lengths)
    return sqrt(float(np.mean(deviations * deviations)))
