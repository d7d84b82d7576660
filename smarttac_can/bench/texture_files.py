"""Files that textures are made of: columns of a CSV recording, a row of a grey picture."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from io import BytesIO, StringIO
from itertools import islice, takewhile
from math import isfinite, nan
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.extras import require_matplotlib
from smarttac_can.host.files import in_words, read_bounded

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

MAX_BYTES: Final = 64 << 20
_GREY_DIMENSIONS: Final = 2
_SHOWN: Final = 40


@in_words()
def read_columns(path: Path, names: Sequence[str]) -> tuple[Integers, list[Floats]]:
    """Read columns of a CSV file by their names.

    Lines before the header that begin with ``#`` are comments. Rows in which one of the columns
    is empty are left out.

    Returns
    -------
    tuple
        The line that each row ends in, from 1, and the columns.

    Raises
    ------
    ValueError
        If it is no text, a column is missing, a number is none, or no row is left; names line and
        column.
    OSError
        If it is no regular file, larger than `MAX_BYTES`, or cannot be read.
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
        missing = [name for name in names if name not in header]
        if missing:
            raise ValueError(f"{path}: there is no column {missing[0]!r} among {', '.join(header)}")
        places = [(name, header.index(name)) for name in names]
        found = [
            (comments + rows.line_num, numbers)
            for row in rows
            if (numbers := _numbers(row, places))
        ]
    except (csv.Error, _NoNumberError) as error:
        raise ValueError(f"{path}: line {comments + rows.line_num}: {error}") from error
    if not found:
        raise ValueError(f"{path}: no row has all of {', '.join(names)}")
    lines, values = zip(*found, strict=True)
    return np.array(lines), list(np.array(values, dtype=np.float64).T)


def _is_comment(line: str) -> bool:
    return line.startswith("#")


class _NoNumberError(ValueError):
    """A cell of a CSV is no number."""


def _numbers(row: list[str], places: Sequence[tuple[str, int]]) -> list[float]:
    """Return the numbers in a row by name and place of their columns; none if one is empty."""
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
        raise _NoNumberError(f"column {name!r}: {text[:_SHOWN]!r} is no finite number")
    return number


@in_words()
def read_grey_row(path: Path, row: int) -> Floats:
    """Read a row of a grey PNG, from the top and 0, as numbers from 0, black, to 1, white.

    Raises
    ------
    ValueError
        If it is no PNG, not grey, or has no such row.
    OSError
        If it is no regular file, larger than `MAX_BYTES`, or cannot be read.
    BenchError
        If matplotlib is missing.
    """
    require_matplotlib()
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
