"""Tables of COF through what a person gives: places on the plate, or points in time."""

from __future__ import annotations

from functools import cache
from math import ceil
from typing import Final, cast

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.named_objects import finite
from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.vocabulary.textures import (
    COF_COUNT,
    MAX_START,
    MAX_STEP,
    MAX_VALUES,
    Axis,
    TextureTable,
)

Floats = npt.NDArray[np.float64]

NM_PER_MM: Final = 1e6
US_PER_S: Final = 1e6
MOST_MM: Final = MAX_START / NM_PER_MM
"""Largest distance of a place from the middle of the plate in mm."""
_MOST_STEP_MM: Final = MAX_STEP / NM_PER_MM
_MS_US: Final = 1000
_LEAST_POINTS: Final = 2


@cache
def cof_bounds() -> tuple[float, float]:
    """Return the lowest and the highest COF that a stimulator plays, by its EDS."""
    entry = stimulator_od()["Setpoint.COF left"]
    low, high = (float(int(bound) * entry.unit.number) for bound in (entry.low, entry.high))
    return low, high


def over_position(places: Floats, cof: Floats) -> TextureTable:
    """Return the table through COF at rising places in mm, in as many values as they are."""
    first, last = float(places[0]), float(places[-1])
    count = min(max(2, len(places)), MAX_VALUES)
    if count > len(places):
        return table_of(Axis.POSITION, False, round(first * NM_PER_MM), 1, cof)
    nearest = float(np.diff(places).min())
    steps = max(round((last - first) / nearest), ceil((last - first) / _MOST_STEP_MM))
    count = min(steps + 1, MAX_VALUES)
    grid = np.linspace(first, last, count)
    step = round((last - first) / (count - 1) * NM_PER_MM)
    start = round(first * NM_PER_MM)
    return table_of(Axis.POSITION, False, start, step, np.interp(grid, places, cof))


def profile_point(point: object) -> tuple[float, float]:
    """Return a point of a profile, time in s and COF; a ValueError says what is none."""
    try:
        time, cof = cast("tuple[object, object]", point)
    except (TypeError, ValueError):
        raise ValueError(f"point {point!r} of a profile is no (time in s, COF)") from None
    return finite("time", time), finite("COF", cof)


def over_time(points: list[tuple[float, float]], repeats: bool) -> TextureTable:
    """Return the table through points (time in s, COF), in steps of 1 ms or a multiple."""
    if len(points) < _LEAST_POINTS:
        raise ValueError(
            f"a profile goes through 2 points (time in s, COF) or more, not {len(points)}"
        )
    times = np.array([t for t, _ in points])
    if points[0][0] < 0.0 or np.any(np.diff(times) < 0.0):
        raise ValueError("the times of a profile are below 0, or fall")
    end = within("length of the profile in s", float(times[-1]), 0.0, 40_000.0)
    steps = max(1, round(end * US_PER_S / _MS_US))
    step = -(-steps // (MAX_VALUES - 1))
    grid = np.arange(0.0, steps + (not repeats), step) * _MS_US / US_PER_S
    cof = np.interp(grid, times, [value for _, value in points])
    return table_of(Axis.TIME, repeats, 0, step * _MS_US, cof)


def table_of(axis: Axis, repeats: bool, start: int, step: int, cof: Floats) -> TextureTable:
    """Return the table of COF at equal steps in counts of its axis."""
    for value in (cof.min(), cof.max()):
        within("COF", float(value), *cof_bounds())
    counts = np.round(cof / COF_COUNT).astype(np.int64)
    return TextureTable(axis, repeats, start, step, tuple(counts.tolist()))


def within(name: str, value: float, low: float, high: float) -> float:
    """Return a finite number within its bounds; a ValueError names it and them."""
    number = finite(name, value)
    if not low <= number <= high:
        raise ValueError(f"{name} {number:g} is outside {low:g}..{high:g}")
    return number
