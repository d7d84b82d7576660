"""Recorded fingers in CSV files."""

from __future__ import annotations

import csv
from pathlib import Path

from smarttac_can.plant.finger import Trajectory

HEADER = ["t_s", "x_mm", "Fn_N"]


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
        If the header or a number is not as it should be; names file and line.
    OSError
        If the file cannot be read.
    """
    samples = []
    with path.open(encoding="utf-8", newline="") as file:
        rows = csv.reader(file)
        if next(rows, None) != HEADER:
            raise ValueError(f"{path} line 1: the header is not {','.join(HEADER)}")
        for row in rows:
            try:
                time, x, Fn = map(float, row)
            except ValueError as error:
                raise ValueError(f"{path} line {rows.line_num}: {error}") from error
            samples.append((time, x * 1e-3, Fn))
    try:
        return Trajectory(samples)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
