"""Recorded runs as arrays in physical units, and the CSV file that stores them.

A trace holds the integers of the wire, so that two files differ whenever the runs differ by one
bit. The arrays in units are computed from the integers on demand. Their names are also those of the
columns of the CSV file and of the data frame, and of the channels of a recording.
"""

from __future__ import annotations

import hashlib
import json
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from importlib.util import find_spec
from io import TextIOWrapper
from itertools import chain, groupby
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self, TypeVar, overload

import numpy as np
import numpy.typing as npt

from smarttac_can import __version__
from smarttac_can.bench.given import integer, said, sequence
from smarttac_can.bench.given import metadata as own_metadata
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.host.files import in_words, open_regular, result_file
from smarttac_can.vocabulary.states import Status

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure, FigureBase

    _Figure = TypeVar("_Figure", bound=FigureBase)

Integers = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]


class Column(NamedTuple):
    """A column of a trace; its decimal without the point is the integer of the wire."""

    name: str
    """Name of the array, of the column of a file, and of the channel of a recording."""
    object: str
    """Name of the recorded object."""
    decimals: int
    unit: str
    needs: str = ""
    """Column whose integer 0 means that there is no value: NaN, or an empty cell in a file."""


COLUMNS: Final = (
    Column("time_s", "Contact.Tick", 3, "s"),
    Column("cof", "Contact.COF", 4, "", needs="cof"),
    Column("cof_reference", "Contact.COF reference", 4, "", needs="cof_reference"),
    Column("amplitude_um", "Vibration.Amplitude", 4, "um"),
    Column("voltage_v", "Vibration.Voltage", 2, "V"),
    Column("frequency_hz", "Vibration.Frequency", 2, "Hz"),
    Column("tangential_force_n", "Contact.Tangential force", 3, "N"),
    Column("normal_force_n", "Contact.Normal force", 3, "N"),
    Column("position_mm", "Contact.Position", 2, "mm", needs="cof"),
    Column("status", "Statusword", 0, ""),
)
"""Columns of a trace, in the order of its rows."""
FORMAT: Final = "# format: SMARTTAC traces 2"
"""First line of the CSV file."""
HEADER: Final = ("experiment", "subject", *(column.name for column in COLUMNS))
_LATER: Final = 2
"""Number of columns, the last ones, that files of format 1 do not have."""
_NAMES_1: Final = ("tick", "mu", "mu_ref", "W", "V", "f", "Ft", "Fn")
_COLUMNS_1: Final = tuple(
    column._replace(name=name, decimals=column.decimals if name != "tick" else 0, needs="")
    for column, name in zip(COLUMNS, _NAMES_1, strict=False)
)
_HEADER_1: Final = ("experiment", "subject", *_NAMES_1)
"""Header of format 1, which has no line for the format."""
_PANELS: Final = {
    "COF": {"cof": "measured", "cof_reference": "reference"},
    "force (N)": {"normal_force_n": "normal", "tangential_force_n": "tangential"},
    "amplitude (µm)": {"amplitude_um": ""},
    "voltage (V)": {"voltage_v": ""},
    "frequency (Hz)": {"frequency_hz": ""},
    "position (mm)": {"position_mm": ""},
}
"""Panels of a figure from top to bottom: label, and for each array its name in the legend."""
_MOST_POINTS: Final = 4000
"""Most points of a line; twice the pixels across a screen."""
_MOST_COUNT: Final = np.iinfo(np.int64).max
_LONGEST_LINE = 1000
_LONGEST_LABEL = 100
_MISS: Final = 0.1
"""Relative deviation of the COF from its reference that counts as not followed."""
_MOSTLY: Final = 0.5
"""Fraction of the rows with contact and reference in which it was not followed, to say so."""
_BRIEF_ROWS: Final = 100
"""Rows of a step or of the first touch, of which nothing is said."""
_MIDDLE: Final = (0.05, 0.95)
"""Quantiles of the COF that a message names, so that one noisy row says nothing."""
_META: Final = "# metadata: "
"""Beginning of a line of the CSV file with label, subject and metadata of a trace as JSON."""
_LONGEST_META: Final = 1 << 20
_MOST_SUBJECT: Final = (1 << 31) - 1
_LABEL = re.compile(r"[a-z0-9_.]+")


def require_matplotlib() -> None:
    """Raise BenchError if matplotlib is missing; called before a picture is drawn or read."""
    if find_spec("matplotlib") is None:
        raise BenchError("the pictures need matplotlib: pip install 'smarttac-can[report]'")


class _Former:
    """A former name of an array, which still returns the integers of the wire."""

    def __init__(self, name: str, count: str) -> None:
        self._name = name
        self.__doc__ = f"Former name of `{name}`, in integers of {count}."

    def __set_name__(self, _owner: type, former: str) -> None:
        self._former = former

    def __get__(self, trace: Trace | None, _owner: type | None = None) -> Integers:
        if trace is None:
            return self  # type: ignore[return-value]
        warnings.warn(
            f"Trace.{self._former} is deprecated: take Trace.{self._name}, which is in the unit "
            "that its name ends in",
            DeprecationWarning,
            stacklevel=2,
        )
        return _integers(trace.counts, self._name)


@dataclass(frozen=True, eq=False, repr=False)
class Trace:
    """One run of one experiment: arrays of equal length, with a row for each tick of 1 ms.

    The row of tick k holds the measurement of tick k and the drive computed from it, in force
    from tick k to tick k + 1. All arrays are read-only. Create a trace with `from_rows`.

    Raises
    ------
    ValueError
        If the label or subject is invalid, the counts are not a table of integers, or the ticks do
        not increase.
    """

    experiment: str
    """Label of the experiment, such as ``fig5.amplitude_only``: a-z, 0-9, point, underscore."""
    subject: int
    """Number of the subject from 1; 0 if no finger takes part."""
    counts: Integers
    """The integers of the wire: a row for each tick, a column for each of `COLUMNS`. A trace from a
    file of format 1 lacks the last two columns. 0 where there is no value."""
    metadata: Mapping[str, str | float] = field(default_factory=dict)
    """Own keys with texts or numbers, such as the humidity in the room."""

    mu = _Former("cof", "1e-4")
    mu_ref = _Former("cof_reference", "1e-4")
    W = _Former("amplitude_um", "0.1 nm")
    V = _Former("voltage_v", "10 mV")
    f = _Former("frequency_hz", "0.01 Hz")
    Ft = _Former("tangential_force_n", "mN")
    Fn = _Former("normal_force_n", "mN")
    position = _Former("position_mm", "0.01 mm")

    def __post_init__(self) -> None:
        object.__setattr__(self, "subject", require_labels(self.experiment, self.subject))
        object.__setattr__(self, "metadata", MappingProxyType(own_metadata(self.metadata)))
        counts = np.array(self.counts)
        whole = counts.dtype.kind in "iu" and len(counts) and counts.max(initial=0) <= _MOST_COUNT
        if counts.ndim != 2 or not whole:  # noqa: PLR2004
            raise ValueError(f"the rows of {self.experiment} are no table of integers")
        if counts.shape[1] not in (len(_COLUMNS_1), len(COLUMNS)):
            raise ValueError(
                f"a row of {self.experiment} has {counts.shape[1]} values, not {len(COLUMNS)}, or "
                f"{len(_COLUMNS_1)} without position and status"
            )
        counts = counts.astype(np.int64)
        for at, column in enumerate(COLUMNS[: counts.shape[1]]):
            # Without contact a node still publishes the last position of the finger.
            counts[_integers(counts, column.needs or column.name) == 0, at] = 0
        object.__setattr__(self, "counts", _read_only(counts))
        if not np.all(np.diff(self.tick) > 0):
            raise ValueError(f"ticks of {self.experiment} do not increase")

    @classmethod
    def from_rows(
        cls,
        experiment: str,
        subject: int,
        rows: Sequence[Sequence[int]],
        metadata: Mapping[str, str | float] | None = None,
    ) -> Trace:
        """Create a trace from rows of the integers of the wire.

        Parameters
        ----------
        experiment, subject
            Labels.
        rows
            Rows of tick in ms, COF and its reference in 1e-4, amplitude in 0.1 nm, voltage in
            10 mV, frequency in 0.01 Hz, tangential and normal force in mN; optionally position in
            0.01 mm and statusword.
        metadata
            Own keys with texts or numbers.

        Raises
        ------
        ValueError
            If the rows differ in length.
        """
        if any(getattr(row, "__len__", None) is None for row in sequence("rows", rows)):
            raise ValueError(f"the rows of {experiment} are no table of integers")
        if len({len(row) for row in rows}) > 1:
            raise ValueError(f"the rows of {experiment} differ in length")
        return cls(experiment, subject, np.array(rows), metadata or {})

    def __len__(self) -> int:
        return len(self.counts)

    def __reduce__(self) -> tuple[type[Self], tuple[str, int, Integers, dict[str, Any]]]:
        # A pickled copy of the arrays would be writable.
        return type(self), (self.experiment, self.subject, self.counts, dict(self.metadata))

    def __dir__(self) -> list[str]:
        former = [name for name, value in vars(type(self)).items() if isinstance(value, _Former)]
        return [name for name in super().__dir__() if name not in former]

    def __repr__(self) -> str:
        first, last = self.tick[0], self.tick[-1]
        return (
            f"<Trace {self.experiment!r} of subject {self.subject}: {len(self)} rows, "
            f"ticks {first}..{last} ms, {self.lost} lost, {self.limited} limited"
            f"{self.shortfall and '; '}{self.shortfall}>"
        )

    @cached_property
    def tick(self) -> Integers:
        """Number of each row's tick of 1 ms, increasing; a gap is a tick that was not recorded."""
        return _integers(self.counts, "time_s")

    @cached_property
    def time_s(self) -> Floats:
        """Time of each row in s since the start of the simulation run or of the node."""
        return self._in_unit("time_s")

    @property
    def lost(self) -> int:
        """Number of ticks between the first row and the last that were not recorded."""
        return int(self.tick[-1] - self.tick[0]) + 1 - len(self)

    @property
    def limited(self) -> int:
        """Number of rows in which a limit of voltage, amplitude or frequency cut the drive."""
        return int(np.count_nonzero(self.status & Status.LIMITED))

    @property
    def shortfall(self) -> str:
        """Text about a COF that was out of reach in most of the rows; empty if it was in reach.

        It is shown with the trace. It is no warning: a start or a lift may be most of a short run.

        It has the commanded COF and the COF of the finger. At the limits friction can be lowered no
        further, and no drive raises it above the friction without vibration.
        """
        asked = ~np.isnan(self.cof_reference) & ~np.isnan(self.cof)
        cut = asked & (self.status & Status.LIMITED != 0)
        missed = cut & (np.abs(self.cof - self.cof_reference) > _MISS * self.cof_reference)
        if np.count_nonzero(missed) <= max(_MOSTLY * np.count_nonzero(asked), _BRIEF_ROWS):
            return ""
        # A landing passes below a reference that friction cannot be lowered to.
        above = missed & (self.cof > self.cof_reference)
        side = max(above, missed & ~above, key=np.count_nonzero)
        wanted = {self.cof_reference[side].min(), self.cof_reference[side].max()}
        low, high = np.quantile(self.cof[side], _MIDDLE)
        return (
            f"the COF could not follow in {np.count_nonzero(missed) / np.count_nonzero(asked):.1%} "
            "of the rows with contact, because a limit cut the drive: "
            f"{' to '.join(f'{value:g}' for value in sorted(wanted))} was commanded, and this "
            f"finger had {low:.2f} to {high:.2f}: command that, or raise the limits"
        )

    @cached_property
    def cof(self) -> Floats:
        """Coefficient of friction; NaN while the finger does not touch."""
        return self._in_unit("cof")

    @cached_property
    def cof_reference(self) -> Floats:
        """Reference of the friction loop; NaN if there is none."""
        return self._in_unit("cof_reference")

    @cached_property
    def amplitude_um(self) -> Floats:
        """Vibration amplitude peak-to-peak in um."""
        return self._in_unit("amplitude_um")

    @cached_property
    def voltage_v(self) -> Floats:
        """Voltage in V."""
        return self._in_unit("voltage_v")

    @cached_property
    def frequency_hz(self) -> Floats:
        """Excitation frequency in Hz."""
        return self._in_unit("frequency_hz")

    @cached_property
    def tangential_force_n(self) -> Floats:
        """Tangential force in N."""
        return self._in_unit("tangential_force_n")

    @cached_property
    def normal_force_n(self) -> Floats:
        """Normal force in N."""
        return self._in_unit("normal_force_n")

    @cached_property
    def position_mm(self) -> Floats:
        """Position of the finger in mm from the middle; NaN while it does not touch.

        All NaN in a trace from a file of format 1.
        """
        return self._in_unit("position_mm")

    @cached_property
    def status(self) -> Integers:
        """Statusword; 0 in a trace from a file of format 1."""
        return _integers(self.counts, "status")

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a data frame with a row for each tick, and the names of the arrays as columns.

        Its `attrs` hold what is common to all rows. Raises BenchError if pandas is missing.
        """
        arrays = {column.name: getattr(self, column.name) for column in COLUMNS}
        return data_frame(
            arrays,
            {
                "experiment": self.experiment,
                "subject": self.subject,
                "rows": len(self),
                "lost_ticks": self.lost,
                "limited_rows": self.limited,
                "units": {column.name: column.unit or "1" for column in COLUMNS},
                "made_by": f"smarttac-can {__version__}",
                "metadata": dict(self.metadata),
            },
        )

    @overload
    def plot(self, figure: None = None) -> Figure: ...
    @overload
    def plot(self, figure: _Figure) -> _Figure: ...
    def plot(self, figure: FigureBase | None = None) -> FigureBase:
        """Plot the arrays over time, in panels from top to bottom.

        A notebook shows the returned figure; ``trace.plot().savefig("run.png")`` saves it.

        Parameters
        ----------
        figure
            Figure to draw into: ``plt.figure()`` of pyplot for a window, or a subfigure; if None, a
            new figure without a window.

        Raises
        ------
        BenchError
            If matplotlib is missing, the extra ``report``.
        ValueError
            If `figure` is not a figure.
        """
        require_matplotlib()
        # Loaded here because recording needs no figures.
        from smarttac_can.bench.drawing import INK, RED, drawn_into  # noqa: PLC0415

        panels = {
            label: {name: what for name, what in lines.items() if not self._empty(name)}
            for label, lines in _PANELS.items()
        }
        panels = {label: lines for label, lines in panels.items() if lines}
        with drawn_into(figure, 9.0, 1.0 + 1.3 * len(panels)) as drawn:
            rows = drawn.subplots(len(panels), sharex=True, squeeze=False)[:, 0]
            for axes, (label, lines) in zip(rows, panels.items(), strict=True):
                for color, (name, what) in zip((RED, INK), lines.items(), strict=False):
                    axes.plot(*self._line(getattr(self, name)), color=color, lw=1.0, label=what)
                axes.set_ylabel(label)
                axes.ticklabel_format(useOffset=False)
                if len(lines) > 1:
                    axes.legend(
                        loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, ncols=2
                    )
            drawn.align_ylabels(rows)
            lost = f", {self.lost} ticks lost" if self.lost else ""
            cut = f", {self.limited / len(self):.1%} limited" if self.limited else ""
            rows[0].set_title(f"{self.experiment}, subject {self.subject}{lost}{cut}")
            rows[-1].set_xlabel("time (s)")
        return drawn

    def _empty(self, name: str) -> bool:
        return bool(np.isnan(getattr(self, name)).all())

    def _line(self, values: Floats) -> tuple[Floats, Floats]:
        """Return times and values of a line, with NaN where ticks are missing.

        A long line is reduced to the minimum and maximum of equal parts, which looks the same.
        """
        rows, points = np.arange(len(self)), [values]
        if len(self) > _MOST_POINTS:
            rows = np.linspace(0, len(self), _MOST_POINTS // 2, endpoint=False).astype(np.intp)
            points = [np.fmin.reduceat(values, rows), np.fmax.reduceat(values, rows)]
        many = len(points)
        missing = many * (np.flatnonzero(np.diff(self.tick[rows]) > np.diff(rows)) + 1)
        times = np.repeat(self.time_s[rows], many)
        return (
            np.insert(times, missing, np.nan),
            np.insert(np.column_stack(points).ravel(), missing, np.nan),
        )

    def _repr_html_(self) -> str:
        """Return a table of the statistics of the arrays, for a notebook."""
        rows = [_summary(column, getattr(self, column.name)) for column in COLUMNS[:-1]]
        head = ("", "unit", "least", "median", "greatest", "rows without")
        table = [f"<tr>{''.join(f'<th>{text}</th>' for text in head)}</tr>"]
        table += [f"<tr>{''.join(f'<td>{text}</td>' for text in row)}</tr>" for row in rows]
        set_bits = {bit.name: np.count_nonzero(self.status & bit) for bit in Status}
        bits = ", ".join(f"{name} in {count} rows" for name, count in set_bits.items() if count)
        return (
            f"<table><caption>{escape(repr(self)[1:-1])}</caption>{''.join(table)}</table>"
            f"<p>status: {bits or 'no bit set'}</p>"
        )

    def to_csv(self, path: Path | str) -> None:
        """Write the CSV file of this trace alone, as `write_csv` does."""
        write_csv(path, self)

    def _in_unit(self, name: str) -> Floats:
        (at,) = (at for at, column in enumerate(COLUMNS) if column.name == name)
        column, counts = COLUMNS[at], _integers(self.counts, name)
        if at >= self.counts.shape[1]:
            return _read_only(np.full(len(self), np.nan))
        # These are the floats that any reader gets from the decimals in the file.
        values = np.asarray(counts / 10**column.decimals, dtype=np.float64)
        if column.needs:
            values[_integers(self.counts, column.needs) == 0] = np.nan
        return _read_only(values)


def _summary(column: Column, values: Floats) -> tuple[str, ...]:
    """Return name, unit, minimum, median and maximum, and the number of rows without a value."""
    found = values[~np.isnan(values)]
    numbers = (found.min(), np.median(found), found.max()) if len(found) else ()
    texts = [f"{number:.{column.decimals}f}" for number in numbers] or ["-"] * 3
    return (column.name, column.unit or "1", *texts, str(len(values) - len(found)))


def data_frame(arrays: dict[str, Any], attrs: dict[str, Any]) -> pandas.DataFrame:
    """Return a data frame of arrays by name; raise BenchError if pandas is missing."""
    try:
        import pandas  # noqa: PLC0415 - slow, and not needed otherwise
    except ImportError as error:
        raise BenchError("a data frame needs pandas: pip install pandas") from error
    frame = pandas.DataFrame({name: np.array(values) for name, values in arrays.items()})
    frame.attrs = attrs
    return frame


def require_labels(experiment: str, subject: int) -> int:
    """Refuse labels that a trace cannot have; return the subject.

    Raises
    ------
    ValueError
        If the experiment is not 1 to 100 of a-z, 0-9, point and underscore, or the subject is not
        an integer of 0 or more.
    """
    if not (isinstance(experiment, str) and _LABEL.fullmatch(experiment)):
        raise ValueError(f"experiment {said(experiment)} is not made of a-z 0-9 . _")
    if len(experiment) > _LONGEST_LABEL:
        raise ValueError(f"experiment of {len(experiment)} characters is outside 1..100")
    return integer("subject", subject, 0, _MOST_SUBJECT)


@in_words()
def write_csv(path: Path | str, traces: Trace | Iterable[Trace]) -> None:
    r"""Write one or more traces as exact decimals, one row per tick, lines ending in ``\n``.

    The first line is a comment with the format, the second has the names of the columns. A cell is
    empty where there is no value, for example the COF without contact. Between these two lines is a
    comment for each trace with metadata. The same traces give the same bytes. An existing file is
    replaced once everything is written.

    Raises
    ------
    ValueError
        If there is no trace, an element is not a trace, or two have the same experiment and
        subject; nothing is written then.
    OSError
        If the file cannot be written, for example on a full disk.
    """
    traces = [traces] if isinstance(traces, Trace) else sequence("traces", traces)
    if not traces:
        raise ValueError("there is no trace to write: write_csv(path, traces)")
    for trace in traces:
        if not isinstance(trace, Trace):
            raise ValueError(f"{said(trace)} is no Trace: write_csv(path, traces)")
    labels = [(trace.experiment, trace.subject) for trace in traces]
    for label in labels:
        if labels.count(label) > 1:
            raise ValueError(f"experiment {label[0]} of subject {label[1]} appears twice")
    with result_file(Path(path)) as file:
        file.write(f"{FORMAT}\n")
        for trace in traces:
            if trace.metadata:
                own = [trace.experiment, trace.subject, dict(trace.metadata)]
                file.write(f"{_META}{json.dumps(own)}\n")
        file.write(f"{','.join(HEADER)}\n")
        for trace in traces:
            columns = [_cells(trace.counts, column) for column in COLUMNS]
            start = f"{trace.experiment},{trace.subject},"
            file.writelines(start + ",".join(row) + "\n" for row in zip(*columns, strict=True))


@in_words()
def read_csv(path: Path | str) -> list[Trace]:
    """Read the traces of a file written by `write_csv`, exactly as they were.

    Files of format 1 (version 0.1.0 and before) have neither position nor status.

    Raises
    ------
    ValueError
        If the header, a number or a label is not as `write_csv` writes it; the message names file
        and line.
    OSError
        If the file is not a regular file, or cannot be read.
    """
    # A character that is not ASCII is reported with its line, like an invalid number.
    file = open_regular(Path(path))
    with TextIOWrapper(file, encoding="utf-8-sig", errors="backslashreplace", newline="") as text:
        # A longer line does not belong to a trace, and is not read as a whole.
        lines = iter(lambda: text.readline(_LONGEST_LINE), "")
        try:
            return list(_traces(text, lines))
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error


@in_words()
def sha256(path: Path | str) -> str:
    """Return the SHA-256 of a file as 64 hexadecimal digits."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _traces(text: TextIOWrapper, lines: Iterator[str]) -> Iterator[Trace]:
    first, second = next(lines, ""), ""
    own: dict[tuple[str, int], dict[str, str | float]] = {}
    while first.rstrip() == FORMAT and (second := text.readline(_LONGEST_META)).startswith(_META):
        line = f"line {2 + len(own)}"
        try:
            experiment, subject, values = json.loads(second.removeprefix(_META))
        except ValueError as error:
            raise ValueError(f"{line}: the metadata are damaged: {error}") from error
        if type(values) is not dict or type(subject) is not int:
            raise ValueError(f"{line}: the metadata are damaged")
        try:
            own[str(experiment), subject] = own_metadata(values)
        except ValueError as error:
            raise ValueError(f"{line}: {error}") from error
    rows = _rows(first, chain([second] if second else [], lines), len(own))
    for (experiment, digits), group in groupby(rows, key=lambda row: row[:2]):
        subject = int(digits)
        yield Trace.from_rows(
            experiment, subject, [row for _, _, row in group], own.get((experiment, subject))
        )


def _integers(counts: Integers, name: str) -> Integers:
    """Return the column of an array; zeros if the file has no such column."""
    at = [column.name for column in COLUMNS].index(name)
    if at < counts.shape[1]:
        return counts[:, at]
    return _read_only(np.zeros(len(counts), np.int64))


def _read_only(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    values.setflags(write=False)
    return values


def _cells(counts: Integers, column: Column) -> list[str]:
    """Return a column as decimals, by shifting the decimal point, without floats."""
    at = COLUMNS.index(column)
    if at >= counts.shape[1]:
        return [""] * len(counts)
    there = np.ones(len(counts), np.bool_)
    if column.needs:
        there = _integers(counts, column.needs) != 0
    digits = column.decimals
    texts = [f"{count:0{digits + 1 + (count < 0)}}" for count in counts[:, at].tolist()]
    if digits:
        texts = [f"{text[:-digits]}.{text[-digits:]}" for text in texts]
    return [text if one else "" for text, one in zip(texts, there.tolist(), strict=True)]


def _rows(first: str, lines: Iterator[str], skipped: int) -> Iterator[tuple[str, str, list[int]]]:
    """Yield (experiment, subject, integers of the wire) for each line after the header.

    Parameters
    ----------
    first
        First line of the file.
    lines
        Lines after that, without `skipped` lines of metadata.
    skipped
        Their number, so that messages name the right line.
    """
    known = first.rstrip() == FORMAT
    columns, header = (COLUMNS, HEADER) if known else (_COLUMNS_1, _HEADER_1)
    # Not by the module csv: how long its cells may be is a setting that any code may change.
    rows = (line.rstrip("\r\n").split(",") for line in (lines if known else chain([first], lines)))
    if tuple(next(rows, ())) != header:
        names = ",".join(header)
        raise ValueError(
            f"line {2 + skipped} is not {names}"
            if known
            else f"line 1 is neither {FORMAT} nor {names}"
        )
    number = [
        re.compile(r"-?\d+" + (rf"\.\d{{{c.decimals}}}" if c.decimals else ""), re.ASCII)
        for c in columns
    ]
    for line, fields in enumerate(rows, known + skipped + 2):
        if len(fields) != len(header):
            raise ValueError(f"line {line} has {len(fields)} of {len(header)} fields")
        experiment, subject, *texts = fields
        if known and texts[-_LATER:] == [""] * _LATER:
            # The trace came from a file of format 1.
            del texts[-_LATER:]
        for column, pattern, text in zip(columns, number, texts, strict=False):
            if not (pattern.fullmatch(text) or (column.needs and not text)):
                raise ValueError(
                    f"line {line}: {column.name} {text!r} "
                    f"is not a number with {column.decimals} decimals"
                )
        if not (subject.isascii() and subject.isdigit()):
            raise ValueError(f"line {line}: subject {subject!r} is not a whole number")
        yield experiment, subject, [int(text.replace(".", "") or 0) for text in texts]
