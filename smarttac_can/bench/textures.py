"""Textures for the stimulator from gratings, profiles, rows of a picture and recordings."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self, cast

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.given import finite, truth
from smarttac_can.bench.lab_csv import (
    FORCES_N,
    LENGTHS_MM,
    NUMBERS,
    TIMES_S,
    Columns,
    read_table,
    size_of,
)
from smarttac_can.bench.pictures import read_row
from smarttac_can.bench.texture_tables import (
    CURE,
    LEAST_VALUES,
    NM_PER_MM,
    PLATE_MM,
    US_PER_S,
    Averaged,
    SampleError,
    cof_bounds,
    half_power,
    of_curve,
    of_pixels,
    of_samples,
    table_of,
    within,
)
from smarttac_can.bench.traces import Floats, Integers, require_matplotlib
from smarttac_can.host.files import in_words
from smarttac_can.vocabulary.textures import COF_COUNT, Axis, TextureTable

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

FOLLOWED_HZ: Final = 100.0
"""Highest frequency in Hz at which a finger feels 0.7 of the swing of a texture over time, with the
dead time of a bus and the vibration law ``pi``: docs/reference/bandwidth.md."""
FINEST_MM_N: Final = 0.5
"""Shortest period of a texture over position in mm, times the normal force in N, of which it feels
0.7: the position is off by 0.04 mm at 60 mm/s under 1 N and by 0.06 mm at 120 mm/s."""
Kind = tuple[str, Mapping[str, float]]
"""Name of a column, and the units of what it holds."""
MOST_GAP: Final = 10
"""Longest interval between two positions over which they are interpolated, in median intervals."""
_LEAST_POINTS: Final = 2
_PERIOD_VALUES: Final = 500
_PROFILES: Final = {
    "step": ((0.0, 0.0), (0.5, 0.0), (0.5, 1.0), (1.0, 1.0)),
    "ramp": ((0.0, 0.0), (1.0, 1.0)),
    "trapezoid": ((0.0, 0.0), (1 / 3, 1.0), (2 / 3, 1.0), (1.0, 0.0)),
    "sine": tuple((t, 0.5 - 0.5 * float(np.cos(2.0 * np.pi * t))) for t in np.linspace(0, 1, 201)),
}
"""Points (time as a fraction of the length, COF as a fraction of the way from low to high)."""
_MARGIN: Final = 0.02
_HEADROOM: Final = 0.1
"""Free space in a figure beside and above the curve, as fractions of it."""

GRID_MM: Final = 0.02
"""Grid spacing in mm at which passes are compared."""
_LEAST_SHARE: Final = 0.05
"""Frequencies with an amplitude below this fraction of the texture's largest are ignored."""
_LEAST_ROWS: Final = 8


@dataclass(frozen=True)
class Texture:
    """COF over position or time, to be played by a stimulator: ``bench.texture = texture``.

    Created by `grating`, `profile`, `from_picture`, `from_csv`, `over_position` and `over_time`. A
    table has 4096 values at most: each is the mean of the samples near it. The COF is 0.05..2
    everywhere, as bounded by the EDS.
    """

    table: TextureTable
    """Table as stored in the stimulator."""
    original: float | None = field(default=None, compare=False, repr=False)
    """Frequency per mm or in Hz below which half of the power of the source lies, if the table does
    not hold all of it; None after it was read back from a stimulator."""

    @classmethod
    def grating(
        cls,
        period_mm: float,
        low: float,
        high: float,
        duty: float = 0.5,
        shape: str = "square",
    ) -> Self:
        """Make a grating over the whole plate; a ridge, with the higher COF, begins at its middle.

        Parameters
        ----------
        period_mm
            Distance between two ridges in mm, 0.1..76.
        low, high
            COF between the ridges and on them.
        duty
            Width of a ridge as a fraction of the period, 0.01..0.99; must be 0.5 for a sine.
        shape
            ``square`` or ``sine``.

        Raises
        ------
        ValueError
            If a number is outside its range, or the shape is unknown.
        """
        period = within("period_mm", period_mm, 0.1, PLATE_MM)
        ridge = within("duty", duty, 0.01, 0.99)
        if shape not in ("square", "sine"):
            raise ValueError(f"shape {shape!r} is none of square, sine")
        if shape == "sine" and ridge != 0.5:  # noqa: PLR2004 - half of the period
            raise ValueError(f"duty {duty} of a sine is not 0.5")
        low, high = _levels(low, high)
        # Interpolation puts the edges of a ridge half a step outside its values: width is exact.
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
        strict: bool = False,
    ) -> Self:
        """Make a profile over time, which starts when the stimulator begins to play it.

        Parameters
        ----------
        shape
            ``step`` (in the middle), ``ramp``, ``trapezoid`` (in thirds), ``sine`` (one period,
            from low to high and back); or points (time in s, COF) joined by straight lines, two
            points at the same time for a step.
        low, high
            COF bounds of a named shape.
        seconds
            Length of a named shape in s, 0.002..1000.
        repeats
            Whether the profile restarts at its end; otherwise its last COF is held.
        strict
            As for `over_position`.

        Raises
        ------
        ValueError
            If the shape is unknown, the times decrease, a number is outside its range, or `repeats`
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
        times, mu = np.array(points, dtype=np.float64).reshape(-1, 2).T
        return cls._of(of_curve(times, mu, truth("repeats", repeats)), strict)

    @classmethod
    def over_position(
        cls,
        x_mm: npt.ArrayLike,
        cof: npt.ArrayLike,
        *,
        times: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
        step_mm: float = 0.05,
        strict: bool = False,
    ) -> Self:
        """Make a texture from arrays of positions and COF, as of a recording.

        Positions may be irregular, repeat and go back and forth: the mean of all samples near a
        value is taken. Places without samples are interpolated linearly. Samples that are NaN in
        one of both are left out.

        Parameters
        ----------
        x_mm
            Positions in mm from the middle of the plate.
        cof
            COF at them.
        times
            Times in s of `x_mm` and of `cof`, if these were sampled at different rates; the
            positions are then interpolated at the times of the COF.
        step_mm
            Distance between two values in mm, 0.01..10.
        strict
            Whether to refuse, not to warn, if more than 10 % of the swing is averaged away or the
            table does not reach all positions.

        Raises
        ------
        ValueError
            If the lengths differ, a position or COF cannot be played, or there are fewer than 10
            values.
        """
        step = within("step_mm", step_mm, 0.01, 10.0)
        places, mu = array_of("x_mm", x_mm), array_of("cof", cof)
        if times is not None:
            if not isinstance(times, tuple) or len(times) != 2:  # noqa: PLR2004
                raise ValueError("times are a pair: the times in s of x_mm, and those of cof")
            at = array_of("times of x_mm", times[0]), array_of("times of cof", times[1])
            require_alike("times of x_mm", at[0], "x_mm", places)
            require_alike("times of cof", at[1], "cof", mu)
            places = at_times(at[0], places, at[1])
        require_alike("x_mm", places, "cof", mu)
        there = ~(np.isnan(places) | np.isnan(mu))
        if not there.any():
            raise ValueError("x_mm and cof have no sample in common")
        return cls._of(of_samples(places[there], mu[there], step), strict)

    @classmethod
    def over_time(
        cls,
        t_s: npt.ArrayLike,
        cof: npt.ArrayLike,
        *,
        repeats: bool = False,
        strict: bool = False,
    ) -> Self:
        """Make a texture from arrays of times and COF; the first time is its start.

        Samples that are NaN in one of both are left out.

        Parameters
        ----------
        t_s
            Times in s, which do not fall; 40000 s at most.
        cof
            COF at them, joined by straight lines.
        repeats
            Whether it begins anew at its end; otherwise the last COF is held.
        strict
            As for `over_position`.

        Raises
        ------
        ValueError
            If the lengths differ, a time falls, or a COF cannot be played.
        """
        times, mu = array_of("t_s", t_s), array_of("cof", cof)
        require_alike("t_s", times, "cof", mu)
        there = ~(np.isnan(times) | np.isnan(mu))
        times, mu = times[there], mu[there]
        return cls._of(of_curve(times - times[:1], mu, truth("repeats", repeats)), strict)

    @classmethod
    def from_picture(
        cls,
        path: Path | str,
        row: int,
        low: float,
        high: float,
        width_mm: float = PLATE_MM,
        *,
        strict: bool = False,
    ) -> Self:
        """Make a texture from a row of a picture: black is low, white is high.

        A PNG, JPEG or TIFF, in grey or in colours, of which the luma by Rec. 601 counts. Needs the
        extra ``pictures``; raises BenchError without it.

        Parameters
        ----------
        path
            Picture of up to 50 million pixels, without alpha.
        row
            Number of the row, counted from 0 at the top.
        low, high
            COF of black and white.
        width_mm
            Width of the picture in mm, 1..76, centred on the plate.
        strict
            Whether to refuse, not to warn, if more than 10 % of the swing is averaged away, as of a
            row of far more than 4096 pixels.

        Raises
        ------
        ValueError
            If it is no such picture, has no such row, or a number is outside its range.
        OSError
            If the file cannot be read.
        """
        low, high = _levels(low, high)
        width = within("width_mm", width_mm, 1.0, PLATE_MM)
        white = read_row(Path(path), row)
        # Exact at both ends: the rounded sum may leave them.
        cof = np.clip(low + (high - low) * white, low, high)
        return cls._of(of_pixels(cof, width), strict)

    from_png = from_picture
    """Former name of `from_picture`."""

    @classmethod
    def from_csv(
        cls,
        table: Path | str | pandas.DataFrame,
        *,
        position: str = "",
        time: str = "",
        cof: str = "",
        lateral: str = "",
        normal: str = "",
        unit: str = "",
        scale: Mapping[str, float] | None = None,
        track: Path | str | pandas.DataFrame | None = None,
        step_mm: float = 0.05,
        least_force: float = 0.05,
        strict: bool = False,
        **options: Any,
    ) -> Self:
        """Make a texture from a recording: COF, or lateral and normal force, over position or time.

        Positions may be irregular, repeat and go back and forth: the mean of all samples near a
        value is taken. Positions without samples are interpolated linearly. Rows with an empty cell
        or NaN are left out.

        Header, separator, decimal sign, encoding and units of a file are found out; see
        docs/how-to/lab-data.md. With the extra ``csv``, pandas reads.

        Parameters
        ----------
        table
            CSV file, or a data frame.
        position, time
            Name of the column of the abscissa, in mm from the middle of the plate or in s. Both
            only with `track`.
        cof
            Name of the column of the COF.
        lateral, normal
            Names of the columns of the forces, used instead of `cof`. The sign of the lateral force
            is ignored.
        unit
            Unit of the abscissa, such as ``m`` or ``ms``, if neither the name of its column, nor
            brackets behind it, nor a row of units tells it.
        scale
            Factors of columns by name, besides their units: ``{"Fz": -1}`` if compression is
            negative.
        track
            Another file or data frame with the columns `time` and `position`, at any rate: the
            position is interpolated at the times of `table`.
        step_mm
            Distance between two values over position in mm, 0.01..10.
        least_force
            Normal force in N, or in the unit of its column if that is not known, below which a
            sample is left out.
        strict
            Whether to refuse, not to warn, if more than 10 % of the swing is averaged away or the
            table does not reach all positions.
        **options
            Options for `pandas.read_csv`, which replace what would be found out.

        Raises
        ------
        ValueError
            If columns are missing or contradict each other, a cell is not a number or cannot be
            played, or there are fewer than 10 rows over position; the message names the line.
        OSError
            If the file cannot be read.
        """
        if not position and not time:
            raise ValueError("give one of position and time, the column that it goes over")
        if bool(position and time) != (track is not None):
            raise ValueError(
                "give one of position and time, or both and track, which has the position over time"
            )
        if bool(cof) == bool(lateral and normal) or bool(lateral) != bool(normal):
            raise ValueError("give cof, or both lateral and normal, the columns of the COF")
        step = within("step_mm", step_mm, 0.01, 10.0)
        over = (time, TIMES_S) if time else (position, LENGTHS_MM)
        if unit and unit not in (LENGTHS_MM if position else TIMES_S):
            known = ", ".join(LENGTHS_MM if position else TIMES_S)
            raise ValueError(f"unit {unit!r} is none of {known}")
        factors = _factors(scale or {}, (position, time, cof, lateral, normal))
        read = Recorded({position or time: unit}, factors, options)
        samples = (
            read.of_cof(table, over, cof)
            if cof
            else read.of_forces(table, over, lateral, normal, least_force)
        )
        if track is not None:
            samples = samples.joined(read.track(track, time, position))
        return cls._of(samples.over_position(step) if position else samples.over_time(), strict)

    @classmethod
    def _of(cls, averaged: Averaged, strict: bool) -> Self:
        """Return the texture of a table; warn of what is lost, or refuse it, at the caller."""
        loss = averaged.loss()
        if loss and truth("strict", strict):
            raise ValueError(loss)
        if loss:
            warnings.warn(loss, stacklevel=3)
        return cls(averaged.table, averaged.half_power)

    def __repr__(self) -> str:
        """Return it in one line: a table has up to 4096 values."""
        first, last = self.extent
        over = f"time, {first:g} to {last:g} s" if self.is_over_time else "position"
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
    def is_over_time(self) -> bool:
        """Whether the texture goes over time, not over position."""
        return self.table.axis is Axis.TIME

    def frequency(self, speed: float) -> float:
        """Return the frequency in Hz below which half of the power of the COF lies; 0 if constant.

        It is the frequency of the source; if this is too fine, the table has only a part of its
        swing. For a grating it is speed over period. Above `FOLLOWED_HZ`, and over position with a
        period below `FINEST_MM_N` over the force, a finger feels less than 0.7 of the swing.

        Parameters
        ----------
        speed
            Speed of the finger in mm/s; ignored for a texture over time.
        """
        per_unit = self.original
        if per_unit is None:
            values = np.array(self.table.values, dtype=np.float64)
            per_unit = half_power(values, self.table.step / self._counts_per_unit)
        return per_unit if self.is_over_time else per_unit * speed

    @property
    def _counts_per_unit(self) -> float:
        return US_PER_S if self.is_over_time else NM_PER_MM

    @property
    def extent(self) -> tuple[float, float]:
        """First and last place: the plate in mm, or the time in s, two periods if it repeats."""
        if not self.is_over_time:
            return -0.5 * PLATE_MM, 0.5 * PLATE_MM
        table = self.table
        if table.repeats:
            return 0.0, 2.0 * table.step * len(table.values) / US_PER_S
        return 0.0, table.step * max(1, len(table.values) - 1) / US_PER_S

    def figure(self) -> Figure:
        """Draw the COF over the plate or the time; BenchError without the extra ``report``."""
        require_matplotlib()
        # Loaded here because playing a texture needs no figures.
        from smarttac_can.bench.drawing import RED, canvas  # noqa: PLC0415

        first, last = self.extent
        places = np.linspace(first, last, 4001)
        cof = self.cof(places)
        with canvas(7.2, 3.4) as figure:
            axes = figure.subplots()
            axes.plot(places, cof, color=RED, lw=1.4)
            # Without a margin, half of the line would be cut off at the frame.
            aside = _MARGIN * (last - first)
            axes.set_xlim(first - aside, last + aside)
            axes.set_ylim(0.0, (1.0 + _HEADROOM) * max(cof))
            axes.set_title("Over time" if self.is_over_time else "Over the plate")
            axes.set_xlabel("time (s)" if self.is_over_time else "position on the plate (mm)")
            axes.set_ylabel("coefficient of friction")
        return figure

    def save_figure(self, path: Path | str) -> None:
        """Save the figure as PNG or SVG, by the suffix; raises BenchError as `figure` does."""
        figure = self.figure()
        from smarttac_can.bench.drawing import save_as  # noqa: PLC0415 - as in figure

        with in_words(path):
            file = Path(path)
            save_as(figure, file, file.suffix[1:].lower() or "png")


def _levels(low: float, high: float) -> tuple[float, float]:
    low, high = (
        within(name, value, *cof_bounds()) for name, value in (("low", low), ("high", high))
    )
    if low > high:
        raise ValueError(f"low {low:g} is above high {high:g}")
    return low, high


def _factors(scale: Mapping[str, float], names: Sequence[str]) -> dict[str, float]:
    """Return the factors of columns; raise ValueError if one is 0, no number or of no column."""
    if not isinstance(scale, Mapping):
        raise ValueError(f"scale {scale!r} is no mapping of columns to factors")
    for name, value in scale.items():
        if not name or name not in names:
            raise ValueError(f"scale of {name!r} is for none of {', '.join(filter(None, names))}")
        if finite(f"scale of {name!r}", value) == 0.0:
            raise ValueError(f"scale of {name!r} is 0")
    return {name: float(value) for name, value in scale.items()}


def profile_point(point: object) -> tuple[float, float]:
    """Return a point of a profile, time in s and COF; raise ValueError if it is invalid."""
    try:
        time, cof = cast("tuple[object, object]", point)
    except (TypeError, ValueError):
        raise ValueError(f"point {point!r} of a profile is no (time in s, COF)") from None
    return finite("time", time), finite("COF", cof)


def array_of(name: str, values: npt.ArrayLike) -> Floats:
    """Return numbers in a row, NaN where masked; raise ValueError if they are not."""
    try:
        array = np.ma.asarray(values, dtype=np.float64).filled(np.nan)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} are no numbers: {error}") from None
    if array.ndim != 1:
        raise ValueError(f"{name} of shape {array.shape} are no numbers in a row")
    if np.isinf(array).any():
        raise ValueError(f"{name} {int(np.isinf(array).argmax())} is infinite")
    return array


def require_alike(name: str, one: Floats, other_name: str, other: Floats) -> None:
    """Raise ValueError if two rows of numbers differ in length."""
    if len(one) != len(other):
        raise ValueError(f"{name} and {other_name} differ in length: {len(one)} and {len(other)}")


def at_times(times: Floats, places: Floats, wanted: Floats) -> Floats:
    """Return positions at other times, linear between samples; NaN before, behind, and in gaps.

    A gap is longer than `MOST_GAP` times the median interval, as where a camera lost the finger.
    """
    there = ~(np.isnan(times) | np.isnan(places))
    times, places = times[there], places[there]
    if len(times) < _LEAST_POINTS or np.any(np.diff(times) <= 0.0):
        raise ValueError("the times of the positions are fewer than 2, or do not rise")
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    gap = times[after] - times[after - 1] > MOST_GAP * float(np.median(np.diff(times)))
    outside = (wanted < times[0]) | (wanted > times[-1])
    if (outside | np.isnan(wanted)).all():
        raise ValueError(
            f"the recordings do not overlap: positions are over {times[0]:g}..{times[-1]:g} s, the "
            f"COF over {np.nanmin(wanted):g}..{np.nanmax(wanted):g} s"
        )
    return np.where(gap | outside, np.nan, np.interp(wanted, times, places))


@dataclass(frozen=True)
class Recorded:
    """How the columns of a recording are read."""

    units: dict[str, str]
    """Units of columns by name, before what the file tells."""
    scale: dict[str, float]
    options: dict[str, Any]

    def of_cof(self, table: object, place: Kind, cof: str) -> Samples:
        """Read the columns of place and COF; raises as `read_table`."""
        found, sizes = self._read(table, place, (cof, NUMBERS))
        return Samples(found, None, found.values[0] * sizes[0], found.values[1] * sizes[1])

    def of_forces(
        self, table: object, place: Kind, lateral: str, normal: str, least_force: float
    ) -> Samples:
        """Read the columns of place and forces; drop rows with a normal force below `least_force`.

        Raises
        ------
        ValueError
            As `read_table`, or if no normal force is so large.
        """
        found, sizes = self._read(table, place, (lateral, FORCES_N), (normal, FORCES_N))
        places, along, across = found.values
        least = max(finite("least_force", least_force), 1e-9)
        pressed = across * sizes[2] >= least
        if not pressed.any():
            pulled = np.count_nonzero(across * sizes[2] <= -least)
            hint = f": {pulled} are negative; scale={{{normal!r}: -1}} if that is compression"
            raise ValueError(
                f"{found.source}: no normal force is {least:g} or more{hint if pulled else ''}"
            )
        cof = np.abs(along[pressed]) * abs(sizes[1]) / (across[pressed] * sizes[2])
        kept = None if pressed.all() else np.flatnonzero(pressed)
        return Samples(found, kept, places[pressed] * sizes[0], cof)

    def track(self, table: object, time: str, position: str) -> tuple[Floats, Floats]:
        """Read times in s and positions in mm of another recording."""
        found, sizes = self._read(table, (time, TIMES_S), (position, LENGTHS_MM))
        return found.values[0] * sizes[0], found.values[1] * sizes[1]

    def _read(self, table: object, *wanted: Kind) -> tuple[Columns, list[float]]:
        """Return columns, and what each is multiplied by to be in mm, s, N or 1."""
        found = read_table(table, [name for name, _ in wanted], self.options)
        sizes = []
        for (name, kind), unit in zip(wanted, found.units, strict=True):
            try:
                sizes.append(size_of(name, self.units.get(name) or unit, kind))
            except ValueError as error:
                raise ValueError(f"{found.source}: {error}") from None
        forces = [size for (_, kind), size in zip(wanted, sizes, strict=True) if kind is FORCES_N]
        if None in forces and (any(forces) or len({*found.units[1:]} - {""}) > 1):
            raise ValueError(
                f"{found.source}: the units of {' and '.join(found.names[1:])} are not both known: "
                "name both with their units, as in 'Fz [N]'"
            )
        factors = [self.scale.get(name, 1.0) for name, _ in wanted]
        return found, [factor * (size or 1.0) for factor, size in zip(factors, sizes, strict=True)]


class Samples(NamedTuple):
    """COF at places, out of a recording."""

    found: Columns
    kept: Integers | None
    """Numbers of the samples among the rows of the recording; None if they are all."""
    place: Floats
    """Positions in mm, or times in s."""
    cof: Floats

    def over_position(self, step: float) -> Averaged:
        """Return the table of the mean COF near each multiple of `step` in mm.

        Raises
        ------
        ValueError
            If a position or a mean cannot be played; the message names the line.
        """
        averaged = named(self, lambda: of_samples(self.place, self.cof, step))
        if len(self.place) < LEAST_VALUES:
            empty = self.found.left_out
            raise ValueError(
                f"{self.found.source}: {len(self.place)} rows with numbers are fewer than the "
                f"{LEAST_VALUES} of a texture over position"
                + (f" ({empty} with an empty cell are left out)" if empty else "")
            )
        return averaged

    def over_time(self) -> Averaged:
        """Return the table through all samples, sorted by time.

        Raises
        ------
        ValueError
            If a COF cannot be played; the message names the line. Also if the recording is too long
            or a single sample.
        """
        order = np.argsort(self.place, kind="stable")
        times = self.place[order]
        kept = order if self.kept is None else self.kept[order]
        ordered = Samples(self.found, kept, times - times[0], self.cof[order])
        return named(ordered, lambda: of_curve(ordered.place, ordered.cof, False, CURE))

    def joined(self, track: tuple[Floats, Floats]) -> Samples:
        """Return the samples at the positions of a track, times in s and positions in mm."""
        try:
            places = at_times(*track, self.place)
        except ValueError as error:
            raise ValueError(f"{self.found.source}: {error}") from None
        there = np.flatnonzero(~np.isnan(places))
        kept = there if self.kept is None else self.kept[there]
        return self._replace(kept=kept, place=places[there], cof=self.cof[there])


def named(samples: Samples, made: Callable[[], Averaged]) -> Averaged:
    """Make a table of samples; an error gets their source, and the line if it is of one sample."""
    found = samples.found
    try:
        return made()
    except SampleError as error:
        row = error.number if samples.kept is None else int(samples.kept[error.number])
        raise ValueError(f"{found.source}: {found.place(row)}: {error.reason}") from None
    except ValueError as error:
        raise ValueError(f"{found.source}: {error}") from None


class Harmonic(NamedTuple):
    """One spatial frequency of a texture."""

    per_mm: float
    """Periods per mm."""
    asked: float
    """Amplitude of the texture at this frequency, in COF."""
    gain: float
    """Amplitude of the COF in phase with the texture, over that of the texture."""
    error: float
    """Amplitude of the difference, in COF."""


@dataclass(frozen=True)
class Tracking:
    """Tracking of a texture over position by the COF of one or more passes, without a shift."""

    passes: int
    """Number of passes."""
    rms: float
    """Root mean square of the difference, in COF, over all passes."""
    correlations: tuple[float, ...]
    """Correlation of each single pass."""
    mean_correlation: float
    """Correlation of the mean over position of the passes in one direction; the lower value of both
    directions, because in a mean of both a delay would cancel. For a square grating the sampling in
    cycles alone lowers it by 0.02 at 60 mm/s."""
    harmonics: tuple[Harmonic, ...]
    """Spatial frequencies of the texture, for the mean of the passes in that direction."""


def track(
    texture: Texture,
    position_mm: npt.ArrayLike,
    cof: npt.ArrayLike,
    *,
    span_mm: tuple[float, float] = (-8.0, 8.0),
) -> Tracking:
    """Compare the COF of a stroking finger with a texture.

    Parameters
    ----------
    texture
        Texture over position.
    position_mm, cof
        Position in mm and COF of each cycle, measured or true, of equal length.
    span_mm
        First and last position in mm; a whole number of periods, away from where the finger turns.

    Raises
    ------
    ValueError
        If the texture goes over time, the lengths differ, or no pass covers the whole span.
    """
    if texture.is_over_time:
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
    """Return position and COF of each pass through the whole span, in either direction."""
    inside = np.flatnonzero((places >= first) & (places <= last) & np.isfinite(mu))
    runs = np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1)
    whole = 0.9 * (last - first)
    return [
        (places[run], mu[run])
        for run in runs
        if len(run) >= _LEAST_ROWS and abs(places[run[-1]] - places[run[0]]) > whole
    ]


def _over(grid: Floats, places: Floats, mu: Floats) -> Floats:
    """Return the COF of a pass, interpolated at increasing positions `grid`."""
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
