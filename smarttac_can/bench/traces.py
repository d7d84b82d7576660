"""Recorded runs as exact integers, and the CSV file that keeps them.

A trace holds what came over the wire, in the resolution of the wire, so that a file differs from
another by at least one digit wherever the runs differ by one bit. Floats are made on demand.
"""

from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from io import TextIOWrapper
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.tidy import to_dataframe, write_tidy_csv
from smarttac_can.host.bounded_file import open_regular
from smarttac_can.host.file_errors import in_words
from smarttac_can.od.units import Quantity

if TYPE_CHECKING:
    import pandas

Integers = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]


class Column(NamedTuple):
    """A column of the CSV file: the wire's integer is the decimal without its point."""

    name: str
    decimals: int
    unit: str


COLUMNS = (
    Column("tick", 0, "ms"),
    Column("mu", 4, "1"),
    Column("mu_ref", 4, "1"),
    Column("W", 4, "um"),
    Column("V", 2, "V"),
    Column("f", 2, "Hz"),
    Column("Ft", 3, "N"),
    Column("Fn", 3, "N"),
)
WITH_STATUS = (*COLUMNS, Column("position", 2, "mm"), Column("status", 0, "1"))
"""Columns of a trace as it was recorded; the CSV file of `write_csv` has `COLUMNS`."""
HEADER = ("experiment", "subject", *(column.name for column in COLUMNS))
_LONGEST_LINE = 1000
_LONGEST_LABEL = 100
_LABEL = re.compile(r"[a-z0-9_.]+")


@dataclass(frozen=True, eq=False)
class Trace:
    """One run of one experiment: integer columns of equal length, one row a tick of 1 ms.

    The row of tick k holds the measurement of tick k and the drive computed from it, in force
    from tick k to tick k + 1. The columns are copied and read-only.

    Raises
    ------
    ValueError
        If the label or subject is refused, a column is not a list of integers, the columns differ
        in length or are empty, or the ticks do not increase.
    """

    experiment: str
    """Label of the experiment, such as ``fig5.amplitude_only``: a-z, 0-9, point, underscore."""
    subject: int
    """Number of the subject from 1; 0 where no finger takes part."""
    tick: Integers
    """Tick count in ms, increasing; a gap is a tick that was not recorded."""
    mu: Integers
    """Coefficient of friction in 1e-4; 0 while the finger does not touch."""
    mu_ref: Integers
    """Reference of the friction loop in 1e-4; 0 while there is none."""
    W: Integers
    """Vibration amplitude ``|W|`` peak-to-peak in 0.1 nm."""
    V: Integers
    """Voltage in 10 mV."""
    f: Integers
    """Excitation frequency in 0.01 Hz."""
    Ft: Integers
    """Tangential force in mN."""
    Fn: Integers
    """Normal force in mN."""
    position: Integers | None = None
    """Position of the finger in 0.01 mm from the middle; None of a trace that was read from CSV."""
    status: Integers | None = None
    """Statusword; None of a trace that was read from CSV."""

    def __post_init__(self) -> None:
        require_labels(self.experiment, self.subject)
        for column in WITH_STATUS:
            given = getattr(self, column.name)
            if given is None and column not in COLUMNS:
                continue
            values = np.array(given)
            if values.ndim != 1 or values.dtype.kind not in "iu":
                raise ValueError(f"column {column.name} is not a list of integers")
            if not 0 < len(values) == len(self.tick):
                raise ValueError(f"column {column.name} has {len(values)} of {len(self.tick)} rows")
            values = values.astype(np.int64)
            values.setflags(write=False)
            object.__setattr__(self, column.name, values)
        if not np.all(np.diff(self.tick) > 0):
            raise ValueError(f"ticks of {self.experiment} do not increase")

    @classmethod
    def from_rows(cls, experiment: str, subject: int, rows: Sequence[Sequence[int]]) -> Trace:
        """Make a trace from rows (tick, mu, mu_ref, W, V, f, Ft, Fn) of scaled integers.

        They may go on with position and status.
        """
        widths = {len(row) for row in rows} or {len(COLUMNS)}
        if len(widths) > 1 or not widths <= {len(COLUMNS), len(WITH_STATUS)}:
            raise ValueError(
                f"a row of {experiment} does not have {len(COLUMNS)} or {len(WITH_STATUS)} values"
            )
        return cls(experiment, subject, *np.array(rows).reshape(-1, *widths).T)

    def __len__(self) -> int:
        return len(self.tick)

    def __repr__(self) -> str:
        first, last = self.tick[0], self.tick[-1]
        return (
            f"<Trace {self.experiment!r} of subject {self.subject}: {len(self)} rows, "
            f"ticks {first}..{last}, {self.lost} lost>"
        )

    @property
    def time_s(self) -> Floats:
        """Time of each row in s of the simulation run or the node's start, not of the recording."""
        return self._in_unit("tick", "s")

    @property
    def lost(self) -> int:
        """Number of ticks between the first row and the last that were not recorded."""
        return int(self.tick[-1] - self.tick[0]) + 1 - len(self)

    @property
    def cof(self) -> Floats:
        """Coefficient of friction; NaN while the finger does not touch."""
        return np.where(self.mu == 0, np.nan, self._in_unit("mu", ""))

    @property
    def cof_reference(self) -> Floats:
        """Reference of the friction loop; NaN while there is none."""
        return np.where(self.mu_ref == 0, np.nan, self._in_unit("mu_ref", ""))

    @property
    def amplitude_um(self) -> Floats:
        """Vibration amplitude peak-to-peak in um."""
        return self._in_unit("W", "um")

    @property
    def voltage_v(self) -> Floats:
        """Voltage in V."""
        return self._in_unit("V", "V")

    @property
    def frequency_hz(self) -> Floats:
        """Excitation frequency in Hz."""
        return self._in_unit("f", "Hz")

    @property
    def tangential_force_n(self) -> Floats:
        """Tangential force in N."""
        return self._in_unit("Ft", "N")

    @property
    def normal_force_n(self) -> Floats:
        """Normal force in N."""
        return self._in_unit("Fn", "N")

    @property
    def position_mm(self) -> Floats | None:
        """Position of the finger in mm from the middle; None of a trace from `read_csv`."""
        return None if self.position is None else np.asarray(self.position / 100)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return a table with a row a tick and units in the names of its columns.

        Without contact the COF is NaN. Raises BenchError if pandas is missing.
        """
        return to_dataframe(self)

    def to_csv(self, path: Path | str) -> None:
        """Write the same table as CSV, with ``# key: value`` before it; no contact is no number."""
        write_tidy_csv(path, self)

    def _in_unit(self, name: str, unit: str) -> Floats:
        (column,) = (column for column in COLUMNS if column.name == name)
        last_decimal = Quantity.parse(f"1e-{column.decimals} {column.unit}")
        return np.asarray(getattr(self, name) * last_decimal.in_unit(unit), dtype=np.float64)


def require_labels(experiment: str, subject: int) -> None:
    """Refuse labels that a trace cannot have.

    Raises
    ------
    ValueError
        If the experiment is not 1 to 100 of a-z, 0-9, point and underscore, or the subject is no
        integer of 0 or more.
    """
    if not (isinstance(experiment, str) and _LABEL.fullmatch(experiment)):
        raise ValueError(f"experiment {experiment!r} is not made of a-z 0-9 . _")
    if len(experiment) > _LONGEST_LABEL:
        raise ValueError(f"experiment of {len(experiment)} characters is outside 1..100")
    if type(subject) is not int:
        raise ValueError(f"subject {subject!r} is no integer")
    if subject < 0:
        raise ValueError(f"subject {subject} is below 0")


@in_words()
def write_csv(path: Path | str, traces: Iterable[Trace]) -> None:
    r"""Write traces as exact decimals, one row a tick, lines ending in ``\n``.

    The units of the columns stand in `COLUMNS`. The same traces make the same bytes.

    Raises
    ------
    ValueError
        If two traces bear the same experiment and subject, before anything is written.
    """
    traces = list(traces)
    labels = [(trace.experiment, trace.subject) for trace in traces]
    for label in labels:
        if labels.count(label) > 1:
            raise ValueError(f"experiment {label[0]} of subject {label[1]} appears twice")
    with Path(path).open("w", encoding="ascii", newline="") as file:
        file.write(",".join(HEADER) + "\n")
        for trace in traces:
            columns = [_decimals(getattr(trace, c.name), c.decimals) for c in COLUMNS]
            start = f"{trace.experiment},{trace.subject},"
            file.writelines(start + ",".join(row) + "\n" for row in zip(*columns, strict=True))


@in_words()
def read_csv(path: Path | str) -> list[Trace]:
    """Read the traces of a file written by `write_csv`, exactly as they were.

    Raises
    ------
    ValueError
        If the header, a number or a label is not as `write_csv` writes it; names the line.
    OSError
        If it is no regular file, or cannot be read.
    """
    with TextIOWrapper(open_regular(Path(path)), encoding="ascii", newline="") as file:
        # A line that is too long is none of a trace, and is not read as a whole.
        lines = iter(lambda: file.readline(_LONGEST_LINE), "")
        return [
            Trace.from_rows(experiment, int(subject), [row for _, _, row in rows])
            for (experiment, subject), rows in groupby(_rows(lines), key=lambda row: row[:2])
        ]


@in_words()
def sha256(path: Path | str) -> str:
    """Return the SHA-256 of a file as 64 hexadecimal digits."""
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _decimals(values: Integers, decimals: int) -> list[str]:
    """Write integers as decimals with the point ``decimals`` digits from the right, no float."""
    return [f"{Decimal(value).scaleb(-decimals):f}" for value in values.tolist()]


def _rows(lines: Iterator[str]) -> Iterator[tuple[str, str, list[int]]]:
    """Yield (experiment, subject, scaled integers) for each line after the header."""
    reader = csv.reader(lines, quoting=csv.QUOTE_NONE)
    if tuple(next(reader, ())) != HEADER:
        raise ValueError(f"line 1 is not {','.join(HEADER)}")
    number = [
        re.compile(r"-?\d+" + (rf"\.\d{{{c.decimals}}}" if c.decimals else ""), re.ASCII)
        for c in COLUMNS
    ]
    for fields in reader:
        if len(fields) != len(HEADER):
            raise ValueError(f"line {reader.line_num} has {len(fields)} of {len(HEADER)} fields")
        experiment, subject, *texts = fields
        for column, pattern, text in zip(COLUMNS, number, texts, strict=True):
            if not pattern.fullmatch(text):
                raise ValueError(
                    f"line {reader.line_num}: {column.name} {text!r} "
                    f"is not a number with {column.decimals} decimals"
                )
        if not (subject.isascii() and subject.isdigit()):
            raise ValueError(f"line {reader.line_num}: subject {subject!r} is not a whole number")
        yield experiment, subject, [int(text.replace(".", "")) for text in texts]
