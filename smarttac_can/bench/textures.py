"""Textures for the stimulator from gratings, profiles, rows of a picture and recordings."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from io import BytesIO, StringIO
from itertools import islice, takewhile
from math import ceil, isfinite, nan
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, Self, cast

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.given import finite, truth
from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.bench.traces import Floats, Integers, require_matplotlib
from smarttac_can.host.files import in_words, read_bounded
from smarttac_can.vocabulary.textures import (
    COF_COUNT,
    MAX_START,
    MAX_STEP,
    MAX_VALUES,
    Axis,
    TextureTable,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PLATE_MM: Final = 76.0
"""Length of the plate in mm along the stroke of a finger."""
MAX_BYTES: Final = 64 << 20
"""Largest file in bytes from which a texture is read."""
NM_PER_MM: Final = 1e6
US_PER_S: Final = 1e6
MOST_MM: Final = MAX_START / NM_PER_MM
"""Largest distance of a position from the middle of the plate in mm."""
FOLLOWED_HZ: Final = 100.0
"""Highest frequency in Hz at which a finger feels 0.7 of the swing of a texture or more, with the
dead time of a bus and the vibration law ``pi``: docs/reference/bandwidth.md."""
_MOST_STEP_MM: Final = MAX_STEP / NM_PER_MM
_MS_US: Final = 1000
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
_CURE: Final = "; leave out rows where the finger turns, rests or hardly touches"
_GREY_DIMENSIONS: Final = 2
_SHOWN: Final = 40

GRID_MM: Final = 0.02
"""Grid spacing in mm at which passes are compared."""
_LEAST_SHARE: Final = 0.05
"""Frequencies with an amplitude below this fraction of the texture's largest are ignored."""
_LEAST_ROWS: Final = 8


@dataclass(frozen=True)
class Texture:
    """COF over position or time, to be played by a stimulator: ``bench.texture = texture``.

    Created by `grating`, `profile`, `from_png` and `from_csv`. The COF is 0.05..2 everywhere, as
    bounded by the EDS.
    """

    table: TextureTable
    """Table as stored in the stimulator."""

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
        return cls(over_time(points, truth("repeats", repeats)))

    @classmethod
    def from_png(
        cls, path: Path | str, row: int, low: float, high: float, width_mm: float = PLATE_MM
    ) -> Self:
        """Make a texture from a row of a grey picture: black is low, white is high.

        Needs the extra ``report``; raises BenchError without it.

        Parameters
        ----------
        path
            PNG file with grey values.
        row
            Number of the row, counted from 0 at the top.
        low, high
            COF of black and white.
        width_mm
            Width of the picture in mm, 1..76, centred on the plate.

        Raises
        ------
        ValueError
            If the picture is not grey, has no such row, or a number is outside its range.
        OSError
            If the file cannot be read.
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
        """Make a texture from a recording: COF, or lateral and normal force, over position or time.

        Positions may be irregular, repeat and go back and forth: the mean of all samples near a
        position is taken. Positions without samples are interpolated linearly.

        Parameters
        ----------
        path
            CSV file with a header; lines before it that begin with ``#`` are skipped.
        position, time
            Name of the column of the abscissa, in mm from the middle of the plate or in s.
        cof
            Name of the column of the COF.
        lateral, normal
            Names of the columns of the forces, used instead of `cof`, both in the same unit. The
            sign of the lateral force is ignored.
        step_mm
            Distance between two values over position in mm, 0.01..10.
        least_force
            Normal force, in the unit of its column, below which a sample is skipped.

        Raises
        ------
        ValueError
            If columns are missing or contradict each other, or a cell is not a number or cannot be
            played; the message names the line.
        OSError
            If the file cannot be read.
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
        """Whether the texture goes over time, not over position."""
        return self.table.axis is Axis.TIME

    def frequency(self, speed: float) -> float:
        """Return the frequency in Hz below which half of the power of the COF lies; 0 if constant.

        For a grating it is speed over period. Above `FOLLOWED_HZ` a finger feels less than 0.7 of
        the swing.

        Parameters
        ----------
        speed
            Speed of the finger in mm/s; ignored for a texture over time.
        """
        table = self.table
        values = np.array(table.values, dtype=np.float64)
        power = np.abs(np.fft.rfft(values - values.mean())) ** 2
        total = float(power.sum())
        if total == 0.0:
            return 0.0
        median = int(np.searchsorted(np.cumsum(power), 0.5 * total))
        per_unit = median / (len(values) * table.step) * self._counts_per_unit
        return per_unit if self.over_time else per_unit * speed

    @property
    def _counts_per_unit(self) -> float:
        return US_PER_S if self.over_time else NM_PER_MM

    @property
    def extent(self) -> tuple[float, float]:
        """First and last place: the plate in mm, or the time in s, two periods if it repeats."""
        if not self.over_time:
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
            axes.set_title("Over time" if self.over_time else "Over the plate")
            axes.set_xlabel("time (s)" if self.over_time else "position on the plate (mm)")
            axes.set_ylabel("coefficient of friction")
        return figure

    def save_figure(self, path: Path | str) -> None:
        """Save the figure as PNG or SVG, by the suffix; raises BenchError as `figure` does."""
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


@cache
def cof_bounds() -> tuple[float, float]:
    """Return the lowest and the highest COF that a stimulator plays, from its EDS."""
    entry = stimulator_od()["Setpoint.COF left"]
    low, high = (float(int(bound) * entry.unit.number) for bound in (entry.low, entry.high))
    return low, high


def over_position(places: Floats, cof: Floats) -> TextureTable:
    """Return the table of COF at increasing positions in mm, with about as many values."""
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
    """Return a point of a profile, time in s and COF; raise ValueError if it is invalid."""
    try:
        time, cof = cast("tuple[object, object]", point)
    except (TypeError, ValueError):
        raise ValueError(f"point {point!r} of a profile is no (time in s, COF)") from None
    return finite("time", time), finite("COF", cof)


def over_time(points: list[tuple[float, float]], repeats: bool) -> TextureTable:
    """Return the table through points (time in s, COF), in steps of a multiple of 1 ms.

    Raises
    ------
    ValueError
        If there is one point only, a time falls, or a time or a COF is outside its bounds.
    """
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
    """Return the table of COF at equal steps, in counts of its axis."""
    for value in (cof.min(), cof.max()):
        within("COF", float(value), *cof_bounds())
    counts = np.round(cof / COF_COUNT).astype(np.int64)
    return TextureTable(axis, repeats, start, step, tuple(counts.tolist()))


def within(name: str, value: float, low: float, high: float) -> float:
    """Return a finite number within its bounds; otherwise raise ValueError with name and bounds."""
    number = finite(name, value)
    if not low <= number <= high:
        raise ValueError(f"{name} {number:g} is outside {low:g}..{high:g}")
    return number


class Samples(NamedTuple):
    """COF at places, with the line of the file for each."""

    path: Path
    line: Integers
    place: Floats
    """Positions in mm, or times in s."""
    cof: Floats

    @classmethod
    def of_cof(cls, path: Path, place: str, cof: str) -> Samples:
        """Read the columns of place and COF; raises as `read_columns`."""
        line, (places, values) = read_columns(path, (place, cof))
        return cls(path, line, places, values)

    @classmethod
    def of_forces(
        cls, path: Path, place: str, lateral: str, normal: str, least_force: float
    ) -> Samples:
        """Read the columns of place and forces; drop rows with a normal force below `least_force`.

        Raises
        ------
        ValueError
            As `read_columns`, or if no normal force is so large.
        """
        line, (places, along, across) = read_columns(path, (place, lateral, normal))
        pressed = across >= max(least_force, 1e-9)
        if not pressed.any():
            raise ValueError(f"{path}: no normal force is {least_force:g} or more")
        cof = np.abs(along[pressed]) / across[pressed]
        return cls(path, line[pressed], places[pressed], cof)

    def over_position(self, step: float) -> TextureTable:
        """Return the table of the mean COF near each multiple of `step` in mm.

        Raises
        ------
        ValueError
            If a position or a mean cannot be played; the message names the line.
        """
        far = np.abs(self.place) > MOST_MM
        self._refuse(far, lambda k: f"position {self.place[k]:g} is outside ±{MOST_MM:g} mm")
        cells, which = np.unique(np.round(self.place / step), return_inverse=True)
        mean = np.bincount(which, self.cof) / np.bincount(which)
        self._refuse_cof(self._unplayable(self.cof) & self._unplayable(mean)[which])
        # The mean of values at a bound may exceed it by a rounding error.
        return over_position(cells * step, np.clip(mean, *cof_bounds()))

    def over_time(self) -> TextureTable:
        """Return the table through all samples, sorted by time.

        Raises
        ------
        ValueError
            If a COF cannot be played; the message names the line. Also if the recording is too long
            or a single sample.
        """
        self._refuse_cof(self._unplayable(self.cof))
        order = np.argsort(self.place, kind="stable")
        times = self.place[order] - self.place[order][0]
        points = zip(times.tolist(), self.cof[order].tolist(), strict=True)
        try:
            return over_time(list(points), repeats=False)
        except ValueError as error:
            raise ValueError(f"{self.path}: {error}") from None

    @staticmethod
    def _unplayable(cof: Floats) -> npt.NDArray[np.bool_]:
        low, high = cof_bounds()
        return (cof < low) | (cof > high)

    def _refuse_cof(self, wrong: npt.NDArray[np.bool_]) -> None:
        low, high = cof_bounds()
        self._refuse(wrong, lambda k: f"COF {self.cof[k]:g} is outside {low:g}..{high:g}{_CURE}")

    def _refuse(self, wrong: npt.NDArray[np.bool_], why: Callable[[int], str]) -> None:
        if wrong.any():
            first = int(wrong.argmax())
            raise ValueError(f"{self.path}: line {self.line[first]}: {why(first)}")


@in_words()
def read_columns(path: Path, names: Sequence[str]) -> tuple[Integers, list[Floats]]:
    """Read columns of a CSV file by their names.

    Lines before the header that begin with ``#`` are comments. Rows in which one of the columns
    is empty are left out.

    Returns
    -------
    tuple
        Number of the line in which each row ends, from 1, and the columns.

    Raises
    ------
    ValueError
        If the file is not a text, a column is missing, a cell is not a number, or no row is left;
        the message names line and column.
    OSError
        If the file is not a regular file, larger than `MAX_BYTES`, or cannot be read.
    """
    data = read_bounded(path, MAX_BYTES)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ValueError(f"{path}: line {line} is no UTF-8 text") from error
    comments = sum(1 for _ in takewhile(_is_comment, StringIO(text, newline="")))
    rows = csv.reader(islice(StringIO(text, newline=""), comments, None))
    try:
        header = [name.strip() for name in next(rows, [])]
        for name in names:
            if name not in header:
                raise ValueError(f"there is no column {name!r} among {', '.join(header)}")
        places = [(name, header.index(name)) for name in names]
        found = [
            (comments + rows.line_num, numbers)
            for row in rows
            if (numbers := _numbers(row, places))
        ]
    except (csv.Error, ValueError) as error:
        raise ValueError(f"{path}: line {comments + max(rows.line_num, 1)}: {error}") from error
    if not found:
        raise ValueError(f"{path}: no row has all of {', '.join(names)}")
    lines, values = zip(*found, strict=True)
    return np.array(lines), list(np.array(values, dtype=np.float64).T)


def _is_comment(line: str) -> bool:
    return line.startswith("#")


def _numbers(row: list[str], places: Sequence[tuple[str, int]]) -> list[float]:
    """Return the numbers of a row by name and index of their columns; [] if a cell is empty."""
    texts = [row[place].strip() if place < len(row) else "" for _, place in places]
    return (
        []
        if "" in texts
        else [_number(name, text) for (name, _), text in zip(places, texts, strict=True)]
    )


def _number(name: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = nan
    if not isfinite(number):
        raise ValueError(f"column {name!r}: {text[:_SHOWN]!r} is no finite number")
    return number


@in_words()
def read_grey_row(path: Path, row: int) -> Floats:
    """Read a row of a grey PNG, counted from 0 at the top, as numbers from 0 (black) to 1 (white).

    Raises
    ------
    ValueError
        If the file is not a PNG, not grey, or has no such row.
    OSError
        If the file is not a regular file, larger than `MAX_BYTES`, or cannot be read.
    BenchError
        If matplotlib is missing.
    """
    require_matplotlib()
    # Loaded here because playing a texture needs no pictures.
    from matplotlib.image import imread  # noqa: PLC0415

    data = read_bounded(path, MAX_BYTES)
    try:
        pixels = imread(BytesIO(data), format="png")
    except (OSError, SyntaxError, ValueError) as error:
        raise ValueError(f"{path}: is no PNG that can be read: {error}") from error
    if pixels.ndim > _GREY_DIMENSIONS:
        red, green, blue = (pixels[..., channel] for channel in range(3))
        if not (np.array_equal(red, green) and np.array_equal(red, blue)):
            raise ValueError(f"{path}: is not grey")
        pixels = red
    if not 0 <= row < len(pixels):
        raise ValueError(f"{path}: row {row} is outside 0..{len(pixels) - 1}")
    return np.asarray(pixels[row], dtype=np.float64)


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
