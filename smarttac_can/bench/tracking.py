"""How well a COF follows a texture: error, correlation, and gain at each spatial frequency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.textures import Texture
from smarttac_can.bench.traces import Floats

GRID_MM: Final = 0.02
"""Distance of the places at which passes are compared."""
_LEAST_SHARE: Final = 0.05
"""Amplitudes of a texture below this share of its largest one are none of its frequencies."""
_LEAST_ROWS: Final = 8


class Harmonic(NamedTuple):
    """One spatial frequency of a texture."""

    per_mm: float
    """Periods per mm."""
    asked: float
    """Amplitude of the texture there, in COF."""
    gain: float
    """Amplitude of the COF in phase with it, over that of the texture."""
    error: float
    """Amplitude of the difference, in COF."""


@dataclass(frozen=True)
class Tracking:
    """How the COF of one or more passes follows a texture over position; nothing is shifted."""

    passes: int
    """How many there are."""
    rms: float
    """Root mean square of the difference, in COF, over all passes."""
    correlations: tuple[float, ...]
    """Of each pass alone."""
    mean_correlation: float
    """Of the mean over position of the passes in one direction; the lower one of both directions,
    as in the mean of both a delay would cancel. The cycles alone cost a square 0.02 at 60 mm/s."""
    harmonics: tuple[Harmonic, ...]
    """Spatial frequencies of the texture, of the mean of the passes in that direction."""


def track(
    texture: Texture,
    position_mm: npt.ArrayLike,
    cof: npt.ArrayLike,
    *,
    span_mm: tuple[float, float] = (-8.0, 8.0),
) -> Tracking:
    """Compare the COF of a finger that strokes with a texture.

    Parameters
    ----------
    texture
        Over position.
    position_mm, cof
        Position in mm and COF of each cycle, of equal length; measured, or true ones.
    span_mm
        From where to where; a whole number of periods, away from where the finger turns.

    Raises
    ------
    ValueError
        If the texture goes over time, the lengths differ, or no pass goes through all of the span.
    """
    if texture.over_time:
        raise ValueError("a texture over time has no place to compare")
    places = np.asarray(position_mm, dtype=np.float64)
    mu = np.asarray(cof, dtype=np.float64)
    if places.ndim != 1 or places.shape != mu.shape:
        raise ValueError(
            f"position_mm and cof are no two rows of equal length: {places.shape}, {mu.shape}"
        )
    first, last = span_mm
    grid = np.arange(first, last, GRID_MM)
    wanted = texture.cof(grid)
    passes = _passes(places, mu, first, last)
    if not passes:
        raise ValueError(f"no pass goes from {first:g} to {last:g} mm")
    alone = [_correlation(c, texture.cof(x)) for x, c in passes]
    squares = np.concatenate([(c - texture.cof(x)) ** 2 for x, c in passes])
    ways = [[p for p in passes if (p[0][-1] > p[0][0]) == rises] for rises in (True, False)]
    means = [np.mean([_over(grid, x, c) for x, c in way], axis=0) for way in ways if way]
    mean = min(means, key=lambda mean: _correlation(mean, wanted))
    return Tracking(
        len(passes),
        float(np.sqrt(squares.mean())),
        tuple(alone),
        _correlation(mean, wanted),
        _harmonics(mean, wanted),
    )


def _passes(places: Floats, mu: Floats, first: float, last: float) -> list[tuple[Floats, Floats]]:
    """Return position and COF of each way through the whole span, in either direction."""
    inside = np.flatnonzero((places >= first) & (places <= last) & np.isfinite(mu))
    runs = np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1)
    whole = 0.9 * (last - first)
    return [
        (places[run], mu[run])
        for run in runs
        if len(run) >= _LEAST_ROWS and abs(places[run[-1]] - places[run[0]]) > whole
    ]


def _over(grid: Floats, places: Floats, mu: Floats) -> Floats:
    """Return the COF of a pass over places that rise."""
    order = np.argsort(places, kind="stable")
    return np.interp(grid, places[order], mu[order])


def _correlation(one: Floats, other: Floats) -> float:
    if np.ptp(one) == 0.0 or np.ptp(other) == 0.0:
        return float("nan")
    return float(np.corrcoef(one, other)[0, 1])


def _harmonics(mean: Floats, wanted: Floats) -> tuple[Harmonic, ...]:
    count = len(wanted)
    asked = np.fft.rfft(wanted)[1:] * 2.0 / count
    got = np.fft.rfft(mean)[1:] * 2.0 / count
    frequencies = np.fft.rfftfreq(count, GRID_MM)[1:]
    size = np.abs(asked)
    kept = np.flatnonzero(size > _LEAST_SHARE * size.max())
    return tuple(
        Harmonic(
            float(frequencies[n]),
            float(size[n]),
            float((got[n] / asked[n]).real),
            float(abs(got[n] - asked[n])),
        )
        for n in kept
    )
