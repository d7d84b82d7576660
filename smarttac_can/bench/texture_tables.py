"""Tables of at most 4096 values out of samples, curves and pixels, by means.

A value of a table stands for a cell, the step around its place. Whatever falls into the cell is
averaged. A single sample of a fine texture, picked in each cell, would beat with the step and play
a coarse texture that is in no source (aliasing). There are three kinds of sources:

Pixels and curves have one value at a place. Each sample is a box that reaches halfway to its
neighbours, and a cell is the mean of what it overlaps. Samples at the very step of the table are
kept as they are. Where a curve has no sample for longer than a step, it is linear. A curve may
jump: two samples at one time.

Scattered samples, of a finger that goes to and fro, have many values at one place. They are first
averaged in bins of an eighth of a step. Empty bins take the next sample or, in gaps wider than a
step, lie on a line. A cell is the mean of its eight bins. A finger that rests, with a thousand
samples at one place, hence weighs no more than one that passes.

What is averaged away is said: `Averaged.lost` is the share of the swing, as a standard deviation,
that the source has and the table has not.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import ceil
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.given import finite
from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.bench.traces import Floats
from smarttac_can.vocabulary.textures import (
    COF_COUNT,
    MAX_START,
    MAX_STEP,
    MAX_VALUES,
    Axis,
    TextureTable,
)

PLATE_MM: Final = 76.0
"""Length of the plate in mm along the stroke of a finger."""
NM_PER_MM: Final = 1e6
US_PER_S: Final = 1e6
MOST_MM: Final = MAX_START / NM_PER_MM
"""Largest distance of a position from the middle of the plate in mm."""
MOST_S: Final = 40_000.0
"""Longest texture over time in s."""
LEAST_VALUES: Final = 10
"""Least number of values of a texture that is made of a recording over position."""
_LEAST_POINTS: Final = 2
_MOST_STEP_MM: Final = MAX_STEP / NM_PER_MM
_MS_US: Final = 1000
_BINS: Final = 8
"""Bins of scattered samples in a step."""
_MOST_FINE: Final = 1 << 16
"""Most points of the spectrum of a source."""
_EDGE: Final = 1e-6
"""Distance from the border of a bin, in bins, at which a sample counts half on either side."""
_LOST_SAID: Final = 0.1
"""Least share of the swing of which the loss is said."""
_LOST_KEPT: Final = 0.01
"""Share of the swing below which the spectrum of the table is that of its source."""
_SCATTER: Final = 0.005
"""Standard deviation of the COF measured at a steady finger; a mean of passes rightly loses it."""
CURE: Final = "; leave out rows where the finger turns, rests or hardly touches"
_CURE_OF_MOST: Final = (
    "; {:.0%} of the rows are outside: is the COF in percent, or has a force the wrong sign?"
)


class Averaged(NamedTuple):
    """A table, and what of its source it does not hold."""

    table: TextureTable
    lost: float = 0.0
    """Share of the swing of the source, as a standard deviation, that is averaged away, 0..1."""
    half_power: float | None = None
    """Frequency per mm or in Hz below which half of the power of the source lies; None if it is
    that of the table."""
    cut: str = ""
    """Which part of the source the table does not reach, in words; empty if it reaches all."""

    def loss(self) -> str:
        """Return in words what the table does not hold; an empty text if it holds nearly all."""
        said = [self.cut] if self.cut else []
        if self.lost >= _LOST_SAID:
            counts, unit = (NM_PER_MM, "mm") if self.table.axis is Axis.POSITION else (1e3, "ms")
            said.append(
                f"{self.lost:.0%} of the swing of the COF (as a standard deviation) is averaged "
                f"away: it is finer than the step of {self.table.step / counts:g} {unit}, or "
                "differs from pass to pass"
            )
        return "; ".join(said)


class SampleError(ValueError):
    """A sample that cannot be played.

    Parameters
    ----------
    number
        Number of the sample, from 0.
    reason
        What is wrong with it.
    """

    def __init__(self, number: int, reason: str) -> None:
        super().__init__(f"sample {number}: {reason}")
        self.number = number
        self.reason = reason


@cache
def cof_bounds() -> tuple[float, float]:
    """Return the lowest and the highest COF that a stimulator plays, from its EDS."""
    entry = stimulator_od()["Setpoint.COF left"]
    low, high = (float(entry.unit.times(int(n), "")) for n in (entry.low, entry.high))
    return low, high


def within(name: str, value: float, low: float, high: float) -> float:
    """Return a finite number within its bounds; otherwise raise ValueError with name and bounds."""
    number = finite(name, value)
    if not low <= number <= high:
        raise ValueError(f"{name} {number:g} is outside {low:g}..{high:g}")
    return number


def table_of(axis: Axis, repeats: bool, start: int, step: int, cof: Floats) -> TextureTable:
    """Return the table of COF at equal steps, in counts of its axis."""
    for value in (cof.min(), cof.max()):
        within("COF", float(value), *cof_bounds())
    counts = np.round(cof / COF_COUNT).astype(np.int64)
    return TextureTable(axis, repeats, start, step, tuple(counts.tolist()))


def half_power(values: Floats, step: float) -> float:
    """Return the frequency below which half of the power of equidistant values lies; 0 if constant.

    Parameters
    ----------
    values
        Values, the mean of which does not count.
    step
        Distance between two; the frequency is per unit of it.
    """
    power = np.abs(np.fft.rfft(values - values.mean())) ** 2
    total = float(power.sum())
    if total == 0.0:
        return 0.0
    return int(np.searchsorted(np.cumsum(power), 0.5 * total)) / (len(values) * step)


def of_pixels(cof: Floats, width_mm: float) -> Averaged:
    """Return the table of pixels of equal width, centred on the plate."""
    count = len(cof)
    borders = np.linspace(-0.5 * width_mm, 0.5 * width_mm, count + 1)
    if count > MAX_VALUES:
        cells = np.linspace(borders[0], borders[-1], MAX_VALUES + 1)
        values, pixel = _overlapped(borders, cof, cells), width_mm / MAX_VALUES
        lost = _lost(cof, np.ones(count), values, np.ones(MAX_VALUES))
        finest = _overlapped(borders, cof, np.linspace(borders[0], borders[-1], _MOST_FINE + 1))
        fine = half_power(finest, width_mm / _MOST_FINE)
    else:
        # A step is 10 mm at most: few pixels are joined by lines with more values.
        pixel, lost, fine = width_mm / count, 0.0, 0.0
        many = max(ceil((width_mm - pixel) / _MOST_STEP_MM), count - 1) + 1
        middles = 0.5 * (borders[:-1] + borders[1:])
        places = np.linspace(middles[0], middles[-1], many)
        values = cof if many == count else np.interp(places, middles, cof)
        pixel = (width_mm - pixel) / (many - 1) if many > 1 else _MOST_STEP_MM
    first = -0.5 * width_mm + 0.5 * width_mm / min(count, MAX_VALUES)
    start, step = round(first * NM_PER_MM), round(pixel * NM_PER_MM)
    table = table_of(Axis.POSITION, False, start, step, values)
    return Averaged(table, lost, fine if lost > _LOST_KEPT else None)


def of_samples(places: Floats, cof: Floats, step_mm: float) -> Averaged:
    """Return the table of scattered samples, with values at multiples of a step.

    Parameters
    ----------
    places
        Positions in mm, in any order, as often as the finger came by.
    cof
        Their COF.
    step_mm
        Distance between two values in mm; it is kept, and a table of 4096 values that does not
        reach all of the plate is cut.

    Raises
    ------
    SampleError
        If a position, or the mean around it, cannot be played.
    ValueError
        If there is no sample on the plate, or the table has fewer than `LEAST_VALUES` values.
    """
    far = np.abs(places) > MOST_MM
    if far.any():
        worst = int(far.argmax())
        raise SampleError(worst, f"position {places[worst]:g} mm is outside ±{MOST_MM:g} mm")
    least, most = float(places.min()), float(places.max())
    if least > 0.5 * PLATE_MM or most < -0.5 * PLATE_MM:
        raise ValueError(
            f"positions {least:g}..{most:g} mm are all beside the plate, -38..38 mm: count them "
            "from its middle"
        )
    first_bin, bins, weights = _binned(places, cof, step_mm / _BINS)
    # A cell is the bins half a step before and after a multiple of the step.
    first, last = ((edge + _BINS // 2) // _BINS for edge in (first_bin, first_bin + len(bins) - 1))
    if last - first + 1 < LEAST_VALUES:
        raise ValueError(
            f"positions {least:g}..{most:g} mm give a table of {last - first + 1} at a step of "
            f"{step_mm:g} mm, and a texture has {LEAST_VALUES} values or more; convert positions "
            "that are not in mm (from_csv: unit='m')"
        )
    before = first_bin - (first * _BINS - _BINS // 2)
    after = (last - first + 1) * _BINS - len(bins) - before
    bins = _filled(np.pad(bins, (before, after), constant_values=np.nan), _BINS)
    weights = np.pad(weights, (before, after))
    means = bins.reshape(-1, _BINS).mean(axis=1)
    _require_playable(
        means, cof, lambda: np.floor(places / step_mm + 0.5).astype(np.intp) - first, CURE
    )
    lost = _lost(cof, np.ones(1), means, weights.reshape(-1, _BINS).sum(axis=1), _SCATTER)
    fine = half_power(bins, step_mm / _BINS) if lost > _LOST_KEPT else None
    cut = ""
    if len(means) > MAX_VALUES:
        middle = min(max(-first - MAX_VALUES // 2, 0), len(means) - MAX_VALUES)
        first, means = first + middle, means[middle : middle + MAX_VALUES]
        ends = (first * step_mm, (first + MAX_VALUES - 1) * step_mm)
        whole = (most - least) / (MAX_VALUES - 1)
        cut = (
            f"the table of {MAX_VALUES} values every {step_mm:g} mm holds {ends[0]:.4g}.."
            f"{ends[1]:.4g} mm of {least:.4g}..{most:.4g} mm, and its ends hold beyond: "
            f"step_mm={ceil(whole * 1e4) / 1e4:g} holds all"
        )
    start = round(first * step_mm * NM_PER_MM)
    table = table_of(Axis.POSITION, False, start, round(step_mm * NM_PER_MM), means)
    return Averaged(table, lost, fine, cut)


def of_curve(times: Floats, cof: Floats, repeats: bool, cure: str = "") -> Averaged:
    """Return the table of a curve over time, in steps of a multiple of 1 ms.

    Parameters
    ----------
    times
        Times in s from 0, which do not fall; two at the same time are a jump.
    cof
        Their COF, joined by straight lines.
    repeats
        Whether it begins anew after its last time; otherwise the last COF holds.
    cure
        What to do if a sample cannot be played, for the message.

    Raises
    ------
    SampleError
        If the mean around a sample cannot be played.
    ValueError
        If there is one point only, a time falls, or the last one is too late.
    """
    if len(times) < _LEAST_POINTS:
        raise ValueError(
            f"a profile goes through 2 points (time in s, COF) or more, not {len(times)}"
        )
    if times[0] < 0.0 or np.any(np.diff(times) < 0.0):
        raise ValueError("the times of a profile are below 0, or fall")
    end = within("length of the profile in s", float(times[-1]), 0.0, MOST_S)
    whole = max(1, round(end * US_PER_S / _MS_US))
    step_ms = -(-whole // (MAX_VALUES - 1))
    count = ceil(whole / step_ms) + (not repeats)
    grid = np.arange(count) * (step_ms * 1e-3)
    curve = _Curve.through(times, cof, step_ms * 1e-3, repeats)
    means = curve.means(grid, step_ms * 1e-3)
    _require_playable(
        means,
        cof,
        lambda: np.minimum(times / (step_ms * 1e-3) + 0.5, count - 1).astype(np.intp),
        cure,
    )
    table = table_of(Axis.TIME, repeats, 0, step_ms * _MS_US, means)
    lost = curve.lost(means)
    if lost <= _LOST_KEPT:
        return Averaged(table, lost)
    many = min(_BINS * count, _MOST_FINE)
    finest = end / many
    fine = half_power(curve.means(np.arange(many) * finest, finest), finest)
    return Averaged(table, lost, fine)


class _Curve(NamedTuple):
    """A curve as boxes side by side."""

    borders: Floats
    """Borders of the boxes, one more than there are; a box may have no width."""
    values: Floats

    @classmethod
    def through(cls, times: Floats, cof: Floats, step: float, repeats: bool) -> _Curve:
        """Return the boxes of samples, with points on the line through gaps wider than a step."""
        if times[0] > 0.0:
            times, cof = np.append(0.0, times), np.append(cof[0], cof)
        if repeats:
            period = times[-1]
            times = np.concatenate([times - period, times, times + period])
            cof = np.tile(cof, 3)
        gaps = np.flatnonzero(np.diff(times) > step * (1.0 + _EDGE))
        if len(gaps):
            grid = step * np.arange(np.ceil(times[0] / step), np.floor(times[-1] / step) + 1)
            after = np.searchsorted(times, grid, side="right")
            inside = np.isin(after - 1, gaps) & (grid > times[np.maximum(after - 1, 0)])
            lines = np.interp(grid[inside], times, cof)
            cof = np.insert(cof, after[inside], lines)
            times = np.insert(times, after[inside], grid[inside])
        middles = 0.5 * (times[:-1] + times[1:])
        return cls(np.concatenate([times[:1], middles, times[-1:]]), cof)

    def means(self, grid: npt.NDArray[Any], step: float) -> Floats:
        """Return the means in cells of a step around the points of a grid; the ends hold beyond."""
        first, last = self.borders[0], self.borders[-1]
        edges = np.clip(np.append(grid, grid[-1] + step) - 0.5 * step, first, last)
        width = np.diff(edges)
        area = np.diff(_integral(self.borders, self.values, edges))
        means = np.full(len(grid), self.values[-1])
        np.divide(area, width, out=means, where=width > _EDGE * step)
        inside: Floats = np.clip(means, self.values.min(), self.values.max())
        return inside

    def lost(self, means: Floats) -> float:
        """Return the share of the swing that these means have not."""
        return _lost(self.values, np.diff(self.borders), means, np.ones(len(means)))


def _overlapped(borders: Floats, values: Floats, cells: Floats) -> Floats:
    """Return the means of boxes, by their borders, in cells, by theirs."""
    means = np.diff(_integral(borders, values, cells)) / np.diff(cells)
    inside: Floats = np.clip(means, values.min(), values.max())
    return inside


def _integral(borders: Floats, values: Floats, places: Floats) -> Floats:
    """Return the integral of boxes from the first border to places."""
    # From the mean, so that the integral of a long recording stays small and its rounding errors.
    mean = values.mean()
    whole = np.concatenate([[0.0], np.cumsum((values - mean) * np.diff(borders))])
    integral: Floats = np.interp(places, borders, whole) + mean * (places - borders[0])
    return integral


def _binned(places: Floats, cof: Floats, width: float) -> tuple[int, Floats, Floats]:
    """Return the number of the first bin, the mean in each (NaN if empty), and its samples."""
    numbers = [np.floor(places / width + side * _EDGE).astype(np.intp) for side in (-1, 1)]
    first, last = int(numbers[0].min()), int(numbers[1].max())
    size = last - first + 1
    count, total = np.zeros(size), np.zeros(size)
    for number in numbers:
        count += 0.5 * np.bincount(number - first, minlength=size)
        total += 0.5 * np.bincount(number - first, cof, minlength=size)
    means = np.full(size, np.nan)
    np.divide(total, count, out=means, where=count > 0.0)
    # The mean of equal samples is this sample, in spite of rounding.
    return first, np.clip(means, cof.min(), cof.max()), count


def _filled(bins: Floats, narrow: int) -> Floats:
    """Fill empty bins: by the next occupied one, in gaps wider than `narrow` by a line."""
    there = np.flatnonzero(~np.isnan(bins))
    every = np.arange(len(bins))
    after = np.clip(np.searchsorted(there, every), 0, len(there) - 1)
    right = there[after]
    left = there[np.maximum(np.where(right > every, after - 1, after), 0)]
    right = np.maximum(right, left)
    near = np.where(every - left < right - every, bins[left], bins[right])
    tie = (every - left == right - every) & (left != right)
    near[tie] = 0.5 * (bins[left] + bins[right])[tie]
    lines = np.interp(every, there, bins[there])
    return np.where(right - left > narrow, lines, near)


def _lost(
    source: Floats, widths: Floats, means: Floats, weights: Floats, least: float = COF_COUNT
) -> float:
    """Return the share of the standard deviation of a source that its means have not, 0..1.

    It is 0 if what is lost deviates by less than `least`.
    """
    had, kept = _deviation(source, widths), _deviation(means, weights)
    if had**2 - kept**2 < least**2:
        return 0.0
    return 1.0 - kept / had


def _deviation(values: Floats, weights: Floats) -> float:
    if len(weights) != len(values):
        return float(values.std())
    total = weights.sum()
    mean = float(weights @ values) / total
    return float(np.sqrt(weights @ (values - mean) ** 2 / total))


def _require_playable(
    means: Floats, cof: Floats, cells: Callable[[], npt.NDArray[np.intp]], cure: str
) -> None:
    """Raise SampleError for the first sample out of bounds whose cell has such a mean, too."""
    low, high = cof_bounds()
    wrong = (means < low) | (means > high)
    if not wrong.any():
        return
    samples = (cof < low) | (cof > high)
    at = cells()
    there = samples & wrong[np.clip(at, 0, len(means) - 1)]
    if cure and 2 * samples.sum() > samples.size:
        cure = _CURE_OF_MOST.format(samples.mean())
    number = int((there if there.any() else samples).argmax())
    raise SampleError(number, f"COF {cof[number]:g} is outside {low:g}..{high:g}{cure}")
