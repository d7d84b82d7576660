"""Recorded fingers in CSV files."""

from __future__ import annotations

import csv
from io import StringIO
from pathlib import Path
from typing import Final

from smarttac_can.host.files import read_bounded
from smarttac_can.plant.finger import SAMPLE_RANGES, Trajectory
from smarttac_can.vocabulary.model import require

_COLUMNS: Final = {"t_s": 1.0, "x_mm": 1e-3, "Fn_N": 1.0}
"""Names of the columns, with their units in those of the SI."""
HEADER: Final = list(_COLUMNS)
MAX_BYTES: Final = 8 << 20
MAX_ROWS: Final = 100_000
"""Of a recording: 100 s at 1 kHz."""


def read_finger(path: Path) -> Trajectory:
    """Read a recorded finger.

    Parameters
    ----------
    path
        CSV with the header ``t_s,x_mm,Fn_N``: time in s, position along the plate in mm from its
        middle, and normal force in N.

    Raises
    ------
    ValueError
        If the header, a number or the order is not as it should be, or there are more than
        `MAX_ROWS`; names file and line. Or if there are fewer than 2 rows.
    OSError
        If it is no regular file, longer than `MAX_BYTES`, or cannot be read.
    """
    data = read_bounded(path, MAX_BYTES)
    try:
        return Trajectory(_samples(data.decode("utf-8-sig")))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _samples(text: str) -> list[tuple[float, float, float]]:
    """Time in s, x in m and Fn in N of each row."""
    samples: list[tuple[float, float, float]] = []
    rows = csv.reader(StringIO(text, newline=""))
    try:
        if next(rows, None) != HEADER:
            raise ValueError(f"the header is not {','.join(HEADER)}")
        for row in rows:
            if len(samples) == MAX_ROWS:
                raise ValueError(f"there are more than {MAX_ROWS} rows")
            if len(row) != len(HEADER):
                raise ValueError(f"{len(row)} fields are not the {len(HEADER)} of the header")
            time, x, Fn = numbers = [float(field) for field in row]
            columns = zip(numbers, _COLUMNS.items(), SAMPLE_RANGES, strict=True)
            for number, (name, unit), (_, low, high) in columns:
                require(name, number, low / unit, high / unit)
            if samples and time <= samples[-1][0]:
                raise ValueError(f"t_s {time:g} is not after the {samples[-1][0]:g} before it")
            samples.append((time, x * _COLUMNS["x_mm"], Fn))
    except (ValueError, csv.Error) as error:
        raise ValueError(f"line {rows.line_num}: {error}") from error
    return samples
