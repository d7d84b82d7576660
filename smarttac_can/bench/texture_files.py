"""Files that textures are made of: columns of a CSV recording, a row of a grey picture."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from io import BytesIO, StringIO
from math import isfinite
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from smarttac_can.host.bounded_file import read_bounded

Floats = npt.NDArray[np.float64]

MAX_BYTES: Final = 64 << 20
_GREY_DIMENSIONS: Final = 2


def read_columns(path: Path, names: Sequence[str]) -> list[Floats]:
    """Read columns of a CSV file by their names.

    Rows in which one of them is empty are left out.

    Raises
    ------
    ValueError
        If a column is missing, a number is none, or no row is left; names the line.
    OSError
        If it is no regular file, larger than `MAX_BYTES`, or cannot be read.
    """
    data = read_bounded(path, MAX_BYTES)
    try:
        rows = csv.reader(StringIO(data.decode("utf-8-sig"), newline=""))
        header = [name.strip() for name in next(rows, [])]
        missing = [name for name in names if name not in header]
        if missing:
            raise ValueError(f"there is no column {missing[0]!r} among {', '.join(header)}")
        places = [header.index(name) for name in names]
        values = _numbers(rows, places)
    except (UnicodeDecodeError, csv.Error, ValueError) as error:
        raise ValueError(f"{path}: {error}") from error
    if not values:
        raise ValueError(f"{path}: no row has all of {', '.join(names)}")
    return list(np.array(values, dtype=np.float64).T)


def _numbers(rows: Iterator[list[str]], places: list[int]) -> list[list[float]]:
    found = []
    for line, row in enumerate(rows, 2):
        texts = [row[place].strip() if place < len(row) else "" for place in places]
        if "" in texts:
            continue
        try:
            numbers = [float(text) for text in texts]
        except ValueError as error:
            raise ValueError(f"line {line}: {error}") from None
        if not all(isfinite(number) for number in numbers):
            raise ValueError(f"line {line}: a number is not finite")
        found.append(numbers)
    return found


def read_grey_row(path: Path, row: int) -> Floats:
    """Read a row of a grey PNG, from the top and 0, as numbers from 0, black, to 1, white.

    Raises
    ------
    ValueError
        If it is no PNG, not grey, or has no such row.
    OSError
        If it is no regular file, larger than `MAX_BYTES`, or cannot be read.
    """
    # Who plays textures needs no pictures.
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
