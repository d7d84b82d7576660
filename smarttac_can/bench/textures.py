"""Textures as a person makes them: gratings, profiles, rows of a picture, recordings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.extras import require_matplotlib
from smarttac_can.bench.named_objects import truth
from smarttac_can.bench.texture_files import read_grey_row
from smarttac_can.bench.texture_samples import Samples
from smarttac_can.bench.texture_tables import (
    NM_PER_MM,
    US_PER_S,
    Floats,
    cof_bounds,
    over_position,
    over_time,
    profile_point,
    table_of,
    within,
)
from smarttac_can.host.files import in_words
from smarttac_can.vocabulary.textures import COF_COUNT, Axis, TextureTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLATE_MM: Final = 76.0
"""Length of the plate along which a finger strokes."""
_PERIOD_VALUES: Final = 500
_PROFILES: Final = {
    "step": ((0.0, 0.0), (0.5, 0.0), (0.5, 1.0), (1.0, 1.0)),
    "ramp": ((0.0, 0.0), (1.0, 1.0)),
    "trapezoid": ((0.0, 0.0), (1 / 3, 1.0), (2 / 3, 1.0), (1.0, 0.0)),
    "sine": tuple((t, 0.5 - 0.5 * float(np.cos(2.0 * np.pi * t))) for t in np.linspace(0, 1, 201)),
}
"""Time over the whole, and the share of the way from low to high."""


@dataclass(frozen=True)
class Texture:
    """COF over position or time, to be played by a stimulator: ``bench.texture = texture``.

    Made by `grating`, `profile`, `from_png` and `from_csv`, with a COF of 0.05..2 everywhere, the
    bounds of the EDS.
    """

    table: TextureTable
    """As the stimulator has it."""

    @classmethod
    def grating(
        cls,
        period_mm: float,
        low: float,
        high: float,
        duty: float = 0.5,
        shape: str = "square",
    ) -> Self:
        """Make a grating over the whole plate; at its middle a ridge, of the higher COF, begins.

        Parameters
        ----------
        period_mm
            Distance of two ridges in mm, 0.1..76.
        low, high
            COF between the ridges and on them.
        duty
            Share of a ridge of the period, 0.01..0.99; 0.5 with a sine.
        shape
            ``square`` or ``sine``.

        Raises
        ------
        ValueError
            If a number is outside its range, or there is no such shape.
        """
        period = within("period_mm", period_mm, 0.1, PLATE_MM)
        ridge = within("duty", duty, 0.01, 0.99)
        if shape not in ("square", "sine"):
            raise ValueError(f"shape {shape!r} is none of square, sine")
        if shape == "sine" and ridge != 0.5:  # noqa: PLR2004 - half of the period
            raise ValueError(f"duty {duty} of a sine is not 0.5")
        low, high = _levels(low, high)
        # The middles of the steps, so that a ridge is as wide as it should be.
        phase = np.arange(_PERIOD_VALUES) / _PERIOD_VALUES
        if shape == "sine":
            share = 0.5 + 0.5 * np.sin(2.0 * np.pi * phase)
        else:
            share = np.where(phase < ridge, 1.0, 0.0)
        step = round(period * NM_PER_MM / _PERIOD_VALUES)
        return cls(table_of(Axis.POSITION, True, 0, step, low + (high - low) * share))

    @classmethod
    def profile(
        cls,
        shape: str | Iterable[tuple[float, float]],
        low: float | None = None,
        high: float | None = None,
        seconds: float = 1.0,
        *,
        repeats: bool = False,
    ) -> Self:
        """Make a profile over the time from when it begins to be played.

        Parameters
        ----------
        shape
            ``step`` (in the middle), ``ramp``, ``trapezoid`` (in thirds), ``sine`` (one period,
            from low to high and back); or points (time in s, COF) with straight lines between
            them, two at one time for a step.
        low, high
            COF of a shape by name.
        seconds
            Length of a shape by name in s, 0.002..1000.
        repeats
            Whether it begins anew at its end; else its last COF stays.

        Raises
        ------
        ValueError
            If there is no such shape, the times fall, a number is outside its range, or `repeats`
            is neither True nor False.
        """
        if isinstance(shape, str):
            if shape not in _PROFILES:
                raise ValueError(f"shape {shape!r} is none of {', '.join(_PROFILES)}")
            if low is None or high is None:
                raise ValueError(f"shape {shape!r} needs low and high")
            low, high = _levels(low, high)
            whole = within("seconds", seconds, 0.002, 1000.0)
            shares = _PROFILES[shape]
            points = [(whole * t, low + (high - low) * share) for t, share in shares]
        else:
            if not isinstance(shape, Iterable):
                raise ValueError(f"shape {shape!r} is neither a name nor points (time in s, COF)")
            points = [profile_point(point) for point in shape]
            if low is not None or high is not None:
                raise ValueError("points have their own COF: low and high belong to a name")
        return cls(over_time(points, truth("repeats", repeats)))

    @classmethod
    def from_png(
        cls, path: Path | str, row: int, low: float, high: float, width_mm: float = PLATE_MM
    ) -> Self:
        """Make a texture of a row of a grey picture: black is low, white is high.

        Needs the extra ``report``; raises BenchError without it.

        Parameters
        ----------
        path
            PNG of grey values.
        row
            Number of the row from the top, from 0.
        low, high
            COF of black and white.
        width_mm
            Width of the picture on the plate, about its middle, 1..76.

        Raises
        ------
        ValueError
            If it is no grey picture, has no such row, or a number is outside its range.
        OSError
            If it cannot be read.
        """
        low, high = _levels(low, high)
        width = within("width_mm", width_mm, 1.0, PLATE_MM)
        grey = read_grey_row(Path(path), row)
        pixel = width / len(grey)
        middles = np.asarray((np.arange(len(grey)) + 0.5) * pixel - 0.5 * width)
        return cls(over_position(middles, low + (high - low) * grey))

    @classmethod
    def from_csv(
        cls,
        path: Path | str,
        *,
        position: str = "",
        time: str = "",
        cof: str = "",
        lateral: str = "",
        normal: str = "",
        step_mm: float = 0.05,
        least_force: float = 0.05,
    ) -> Self:
        """Make a texture of a recording: COF, or lateral and normal force, over position or time.

        Positions may be irregular, come more than once and go back and forth: the mean of all
        samples near a place counts. Where there are none, the line between their neighbours does.

        Parameters
        ----------
        path
            CSV with a header, before which lines that begin with ``#`` are left out.
        position, time
            Name of the column that it goes over, in mm from the middle of the plate or in s.
        cof
            Name of the column of the COF.
        lateral, normal
            Names of the columns of the forces, instead, in one unit; of the lateral one the sign
            does not count.
        step_mm
            Distance of two values over position in mm, 0.01..10.
        least_force
            Samples of a lower normal force are left out.

        Raises
        ------
        ValueError
            If columns are missing or contradict each other, or a number is none or cannot be
            played; names the line.
        OSError
            If it cannot be read.
        """
        if bool(position) == bool(time):
            raise ValueError("give one of position and time, the column that it goes over")
        if bool(cof) == bool(lateral and normal) or bool(lateral) != bool(normal):
            raise ValueError("give cof, or both lateral and normal, the columns of the COF")
        step = within("step_mm", step_mm, 0.01, 10.0)
        samples = (
            Samples.of_cof(Path(path), position or time, cof)
            if cof
            else Samples.of_forces(Path(path), position or time, lateral, normal, least_force)
        )
        return cls(samples.over_time() if time else samples.over_position(step))

    def __repr__(self) -> str:
        """Return it in one line: a table has up to 4096 values."""
        first, last = self.extent
        over = f"time, {first:g} to {last:g} s" if self.over_time else "position"
        low, high = (
            COF_COUNT * count for count in (min(self.table.values), max(self.table.values))
        )
        many = len(self.table.values)
        return f"<Texture over {over}: {many} values, COF {low:g} to {high:g}>"

    def cof(self, place: npt.ArrayLike) -> Floats:
        """Return the COF at places in mm from the middle of the plate, or times in s."""
        counts = np.atleast_1d(np.asarray(place, dtype=np.float64)) * self._counts_per_unit
        return np.array([self.table.at(count) for count in counts.tolist()])

    @property
    def over_time(self) -> bool:
        """Whether it goes over time, not over position."""
        return self.table.axis is Axis.TIME

    @property
    def _counts_per_unit(self) -> float:
        return US_PER_S if self.over_time else NM_PER_MM

    @property
    def extent(self) -> tuple[float, float]:
        """From where to where it goes: the plate in mm, or its time in s, twice if it repeats."""
        if not self.over_time:
            return -0.5 * PLATE_MM, 0.5 * PLATE_MM
        table = self.table
        if table.repeats:
            return 0.0, 2.0 * table.step * len(table.values) / US_PER_S
        return 0.0, table.step * max(1, len(table.values) - 1) / US_PER_S

    def figure(self) -> Figure:
        """Draw the COF over the plate or the time; BenchError without the extra ``report``."""
        require_matplotlib()
        # Who plays textures needs no pictures.
        from smarttac_can.bench.figures import texture_figure  # noqa: PLC0415

        return texture_figure(self)

    def save_figure(self, path: Path | str) -> None:
        """Draw it into a file, PNG or SVG by its ending; needs what `figure` does."""
        figure = self.figure()
        with in_words(path):
            figure.savefig(Path(path))


def _levels(low: float, high: float) -> tuple[float, float]:
    low, high = (
        within(name, value, *cof_bounds()) for name, value in (("low", low), ("high", high))
    )
    if low > high:
        raise ValueError(f"low {low:g} is above high {high:g}")
    return low, high
