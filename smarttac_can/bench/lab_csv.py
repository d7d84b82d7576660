"""Columns of numbers out of a table as labs write it: a CSV file of any maker, or a data frame.

A file is looked at before it is read. The wanted names decide: the header is the last line before
the numbers in which all of them stand, whatever the separator, and however many lines of a logger
come before. It may begin with ``#``, as that of `numpy.savetxt`. The encoding is the first of
UTF-8, UTF-16, cp932 and cp1252 in which the names are found. The units may stand below the header.
Numbers have a decimal comma if there is such a number among the first ones.

pandas reads the numbers, in pieces, so that only the wanted columns are ever held. Where it stops,
and where it is not installed, a plain reader goes through the lines. It takes the same files, is
slower, and names the line of what it refuses.
"""

from __future__ import annotations

import re
import warnings
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from io import TextIOWrapper
from itertools import islice
from math import isfinite, nan
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.host.files import cells as cells_of
from smarttac_can.host.files import in_words, open_regular, too_large

Floats = npt.NDArray[np.float64]

MAX_CSV_BYTES: Final = 1 << 30
"""Largest file in bytes: ten minutes at 6 kHz with a dozen columns."""
_HEAD_BYTES: Final = 1 << 16
"""Bytes in which the header is looked for."""
_SMALL_BYTES: Final = 1 << 18
"""Smaller files are read before pandas would be imported."""
_CHUNK_ROWS: Final = 1 << 17
_SHOWN: Final = 40
_MOST_LINES: Final = 100
"""Most lines of a cell in quotes."""
_SEPARATORS: Final = ("\t", ";", ",", "|", " ")
"""What is tried, in this order; the blank stands for any white space."""
MISSING: Final = frozenset(
    ("", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--", "---", "-nan", "1.#qnan", "-1.#ind")
)
"""Cells that mean that there is no number, in lower case."""
_WORDS: Final = sorted({*MISSING, *map(str.upper, MISSING), "NaN", "Null", "None", "-NaN"} - {""})
_COMMENT: Final = re.compile(r"^\s*[#%]+\s*")
_NUMBER: Final = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_COMMA: Final = re.compile(r"[-+]?(\d{1,3}(\.\d{3})+|\d*),\d+([eE][-+]?\d+)?", re.ASCII)
_UNIT: Final = re.compile(r"^(.*?)\s*(?:[\[［]([^\]］]*)[\]］]|[(（]([^)）]*)[)）]|\s/\s*(\S+))$")
_LAST: Final = re.compile(r"(.+?)\s*[_\s,/]\s*([^_\s,/]+)")
"""A name, and the last word in it, which may be a unit: ``x_mm``, ``x/mm``, ``x in mm``."""
_JAPANESE: Final = re.compile("[぀-ヿ一-鿿]{2}|[｡-ﾟ]{3}")
"""Two signs of Japanese in a row: in one, as in Temp駻ature, cp932 meets cp1252."""
_OWN: Final = ("chunksize", "iterator", "index_col", "usecols", "dtype", "engine", "nrows")
"""Options of pandas.read_csv that this reader needs for itself."""
_WHOLE: Final = ("header", "names", "skiprows", "compression")
"""Options with which the place of the header is not looked for."""


class Columns(NamedTuple):
    """Columns of a table, without the rows in which one of them is empty."""

    names: tuple[str, ...]
    values: tuple[Floats, ...]
    units: tuple[str, ...]
    """Unit of each column, as its name, its brackets or the row below tell; empty if none does."""
    source: str
    """The path, or what the table is, for messages."""
    left_out: int
    """Number of rows in which one of the columns is empty."""
    place: Callable[[int], str]
    """Return in words where one of the rows stands."""


class _Layout(NamedTuple):
    """How a file is written."""

    encoding: str
    skipped: int
    """Lines before the first one with numbers."""
    fields: int
    """Number of fields in the header."""
    at: tuple[int, ...]
    """Fields of the wanted columns."""
    units: tuple[str, ...]
    separator: str
    comma: bool
    """Whether numbers have a decimal comma; a point may then stand before thousands."""


@in_words()
def read_table(
    table: object, names: Sequence[str], options: Mapping[str, Any] | None = None
) -> Columns:
    """Read columns by their names.

    Parameters
    ----------
    table
        Path of a CSV file, or a data frame of pandas, or another with ``columns``.
    names
        Names of the columns; one with a unit, such as ``x [mm]``, is also found as ``x``.
    options
        Options for `pandas.read_csv`, which replace what would be found out.

    Raises
    ------
    ValueError
        If a column is missing or appears twice, a cell is no finite number, no row has all columns,
        or the file is no text; the message names line and column.
    OSError
        If the file is not a regular file, larger than `MAX_CSV_BYTES`, or cannot be read.
    BenchError
        If there are options and pandas is missing.
    """
    wanted = tuple(names)
    given = dict(options or {})
    for name in _OWN:
        if name in given:
            raise ValueError(f"option {name}= of pandas.read_csv is not taken: the reader sets it")
    if hasattr(table, "columns"):
        if given:
            raise ValueError(f"option {next(iter(given))}= is for a file, not for a data frame")
        return _of_frame(table, wanted)
    path = Path(table)  # type: ignore[arg-type]
    if given and not _has_pandas():
        raise BenchError(
            f"option {next(iter(given))}= needs pandas: pip install 'smarttac-can[csv]'"
        )
    if any(name in given for name in _WHOLE):
        return _by_options(path, wanted, given)
    with _text(path) as (file, head):
        layout = _layout(path, head, wanted, given)
        file.reconfigure(encoding=layout.encoding, errors="backslashreplace")
        for _ in range(layout.skipped):
            file.readline()
        if not given and (not _has_pandas() or path.stat().st_size < _SMALL_BYTES):
            return _plain(path, file, wanted, layout)
        found = _fast(path, file, wanted, layout, given)
    if found is not None:
        return found
    with _text(path) as (file, _):
        file.reconfigure(encoding=layout.encoding, errors="backslashreplace")
        for _ in range(layout.skipped):
            file.readline()
        return _plain(path, file, wanted, layout)


def _has_pandas() -> bool:
    return find_spec("pandas") is not None


@contextmanager
def _text(path: Path) -> Iterator[tuple[TextIOWrapper, bytes]]:
    """Open a file as text at its beginning; give its first bytes, too."""
    with open_regular(path) as file:
        if file.seek(0, 2) > MAX_CSV_BYTES:
            raise too_large(path, MAX_CSV_BYTES)
        file.seek(0)
        head = file.read(_HEAD_BYTES)
        file.seek(0)
        if head.startswith((b"PK\3\4", b"\xd0\xcf\x11\xe0")):
            raise ValueError(
                f"{path}: is a spreadsheet, not a text: save it as CSV, or pass what "
                "pandas.read_excel returns"
            )
        # What is no text of its encoding is seen where a number should be.
        yield TextIOWrapper(file, encoding="utf-8", errors="backslashreplace", newline=""), head


# -- How a file is written ---------------------------------------------------------------------


def _layout(path: Path, head: bytes, wanted: Sequence[str], given: Mapping[str, Any]) -> _Layout:
    """Return how a file is written, by its first bytes and the names of its columns."""
    encodings = [str(given["encoding"])] if "encoding" in given else _encodings(head)
    separators = [str(given[key]) for key in ("sep", "delimiter") if given.get(key)]
    if separators[:1] in ([r"\s+"], [r"\s*"]):
        separators = [" "]
    texts = [_decoded(path, head, encoding) for encoding in encodings]
    for encoding, text in zip(encodings, texts, strict=True):
        lines = text.splitlines(keepends=False)
        found = _header(lines, wanted, separators or _SEPARATORS)
        if found:
            try:
                layout = _below(lines, found, wanted, encoding)
            except ValueError as error:
                raise ValueError(f"{path}: line {found[0] + 1}: {error}") from None
            return layout._replace(comma=given.get("decimal", "," if layout.comma else ".") == ",")
    raise ValueError(f"{path}: {_no_column(texts[0].splitlines(), wanted, separators)}")


def _encodings(head: bytes) -> list[str]:
    """Return the encodings that a file may have, the most probable first."""
    for mark, encoding in (
        (b"\xef\xbb\xbf", "utf-8-sig"),
        (b"\xff\xfe", "utf-16"),
        (b"\xfe\xff", "utf-16"),
    ):
        if head.startswith(mark):
            return [encoding]
    if head[1:64:2].count(0) > len(head[:64]) // 4:
        return ["utf-16-le"]
    if head[:64:2].count(0) > len(head[:64]) // 4:
        return ["utf-16-be"]
    # The last sign may be cut in two.
    whole = head if len(head) < _HEAD_BYTES else head[: head.rfind(b"\n") + 1]
    try:
        whole.decode("utf-8")
    except UnicodeDecodeError:
        japanese = _JAPANESE.search(whole.decode("cp932", errors="ignore"))
        return ["cp932", "cp1252"] if japanese else ["cp1252", "cp932"]
    return ["utf-8"]


def _decoded(path: Path, head: bytes, encoding: str) -> str:
    try:
        text = head.decode(encoding, errors="replace")
    except LookupError:
        raise ValueError(f"{path}: encoding {encoding!r} is unknown") from None
    if "\0" in text:
        raise ValueError(f"{path}: is no text: it contains bytes of value 0")
    # The last line may be cut; it is complete in a short file.
    return text if len(head) < _HEAD_BYTES else text[: text.rfind("\n") + 1]


def _split(line: str, separator: str) -> list[str]:
    if separator == " ":
        return line.split()
    return cells_of(line, separator) or []


def _header(
    lines: Sequence[str], wanted: Sequence[str], separators: Sequence[str]
) -> tuple[int, str] | None:
    """Return the number of the line of the header and its separator, None if there is none."""
    found = None
    for number, line in enumerate(lines):
        if not line.strip():
            continue
        text = _COMMENT.sub("", line)
        separator = next((s for s in separators if _has(_split(text, s), wanted)), None)
        if separator is not None:
            found = number, separator
        elif found:
            return found
    return found


def _has(cells: Sequence[str], wanted: Sequence[str]) -> bool:
    known = {*cells, *(_base(cell) for cell in cells)}
    return all(name in known for name in wanted)


def _base(cell: str) -> str:
    """Return the name of a column without a unit in brackets or behind a slash."""
    match = _UNIT.match(cell)
    return match[1] if match else cell


def unit_of(name: str) -> str:
    """Return the unit in brackets or behind a slash in the name of a column; empty if none."""
    match = _UNIT.match(name)
    return (
        next((unit.strip() for unit in match.groups()[1:] if unit is not None), "") if match else ""
    )


def _find(cells: Sequence[str], name: str) -> int:
    """Return the place of a column; raise ValueError if it is missing or appears twice."""
    places = [at for at, cell in enumerate(cells) if cell == name]
    places = places or [at for at, cell in enumerate(cells) if _base(cell) == name]
    if not places:
        raise ValueError(f"there is no column {name!r} among {', '.join(cells)}")
    if len(places) > 1:
        fields = " and ".join(str(at + 1) for at in places)
        raise ValueError(f"column {name!r} appears twice, as {fields}: rename one")
    return places[0]


def _no_column(lines: Sequence[str], wanted: Sequence[str], separators: Sequence[str]) -> str:
    """Return in words which column is missing, in the line that is most like a header."""
    best, shown = (-1, 0, 0), (1, [""])
    for number, line in enumerate(lines, 1):
        text = _COMMENT.sub("", line)
        splits = [_split(text, separator) for separator in separators or _SEPARATORS]
        if any(_NUMBER.fullmatch(cell) for cells in splits[:-1] for cell in cells) and best[0] >= 0:
            break
        for cells in splits if text == line and text.strip() else ():
            score = sum(name in {*cells, *map(_base, cells)} for name in wanted), len(cells), number
            if score > best:
                best, shown = score, (number, cells)
    number, cells = shown
    if not any(map(str.strip, lines)):
        return "the file is empty"
    if best[0] < 0:
        return f"no line of the first {_HEAD_BYTES // 1024} KiB has the columns {', '.join(wanted)}"
    missing = next((name for name in wanted if name not in {*cells, *map(_base, cells)}), wanted[0])
    return f"line {number}: there is no column {missing!r} among {', '.join(cells)}"


def _below(
    lines: Sequence[str], header: tuple[int, str], wanted: Sequence[str], encoding: str
) -> _Layout:
    """Return the layout of a file whose header is known, by the rows below it."""
    number, separator = header
    cells = _split(_COMMENT.sub("", lines[number]), separator)
    at = tuple(_find(cells, name) for name in wanted)
    units, skipped = tuple(unit_of(cells[k]) for k in at), number + 1
    rows = [
        (k, _split(_COMMENT.sub("", line), separator)) for k, line in enumerate(lines) if k > number
    ]
    filled = [(k, row) for k, row in rows if any(row)]
    if filled and _is_unit_row(filled[0][1], at):
        skipped = filled[0][0] + 1
        row = filled.pop(0)[1]
        units = tuple(row[k].strip("[]() ") if k < len(row) else "" for k in at)
    taken = [row[k] for _, row in filled for k in at if k < len(row)]
    comma = any(_COMMA.fullmatch(cell) for cell in taken)
    return _Layout(encoding, skipped, len(cells), at, units, separator, comma)


def _is_unit_row(row: Sequence[str], at: Sequence[int]) -> bool:
    """Whether one of the wanted cells is a known unit, and none is a number."""
    cells = [row[k] if k < len(row) else "" for k in at]
    return any(cell.strip("[]() ") in UNITS for cell in cells) and not any(
        _NUMBER.fullmatch(cell) or _COMMA.fullmatch(cell) for cell in cells
    )


# -- The numbers -------------------------------------------------------------------------------


def _fast(
    path: Path, file: TextIOWrapper, wanted: Sequence[str], layout: _Layout, given: dict[str, Any]
) -> Columns | None:
    """Read the numbers by pandas; return None where the plain reader has to say what is wrong."""
    options: dict[str, Any] = {
        "sep": r"\s+" if layout.separator == " " else layout.separator,
        "decimal": "," if layout.comma else ".",
        "na_values": _WORDS,
        "keep_default_na": False,
        "skipinitialspace": True,
    }
    taken = {key: value for key, value in given.items() if key not in ("delimiter", "encoding")}
    if "sep" in given or "delimiter" in given:
        taken["sep"] = given.get("sep") or given["delimiter"]
    options |= taken | {"header": None, "index_col": False}
    options.setdefault("names", range(layout.fields))
    try:
        pieces, rows = _pieces(file, layout.at, wanted, options)
    except _UnclearError as unclear:
        if not taken:
            return None
        raise ValueError(f"{path}: {unclear}") from unclear.__cause__
    place = _line_finder(path, layout)
    return _kept(wanted, layout.units, str(path), pieces, rows, place)


class _UnclearError(Exception):
    """What pandas does not read as numbers, in words."""


def _pieces(
    file: Any, at: Sequence[Any], wanted: Sequence[str], options: Mapping[str, Any]
) -> tuple[list[Floats], int]:
    """Read the columns by pandas; return rows of numbers in pieces, and how many rows there are.

    `at` are the labels of the columns. A number that is not finite is unclear.
    """
    import pandas  # noqa: PLC0415 - slow, and not needed otherwise

    pieces: list[Floats] = []
    rows = 0
    try:
        with (
            warnings.catch_warnings(),
            pandas.read_csv(file, chunksize=_CHUNK_ROWS, **options) as reader,
        ):
            # It warns of fields that it would drop, as of decimal commas between commas.
            warnings.simplefilter("error", pandas.errors.ParserWarning)
            for chunk in reader:
                piece = np.empty((len(at), len(chunk)))
                for row, (label, name) in enumerate(zip(at, wanted, strict=True)):
                    piece[row] = _numbers(chunk[label], name, rows, options.get("decimal") == ",")
                pieces.append(piece)
                rows += len(chunk)
    except pandas.errors.EmptyDataError:
        pass
    except (ValueError, TypeError, pandas.errors.ParserWarning) as error:
        said = str(error).strip().splitlines()[0]
        raise _UnclearError(f"pandas.read_csv: {said}") from error
    return pieces, rows


def _numbers(column: Any, name: str, before: int, comma: bool = False) -> Floats:
    """Return a column of pandas as numbers; raise _UnclearError for the first cell that is none.

    With a decimal comma a number with a point is none: 1.234 may be 1234.
    """
    if getattr(column.dtype, "kind", "O") not in "iuf":
        import pandas  # noqa: PLC0415 - it made the column

        numbers = pandas.to_numeric(column, errors="coerce")
        none = numbers.isna()
        if comma:
            none |= column.astype(str).str.contains(".", regex=False)
        wrong = np.flatnonzero(np.asarray(none & column.notna()))
        if len(wrong) or getattr(column.dtype, "kind", "O") == "b":
            at = int(wrong[0]) if len(wrong) else 0
            raise _UnclearError(
                _is_no_number(name, str(column.iloc[at]), f"row {before + at + 1}: ")
            )
        column = numbers
    values: Floats = column.to_numpy(np.float64, na_value=np.nan)
    if np.isinf(values).any():
        at = int(np.isinf(values).argmax())
        raise _UnclearError(_is_no_number(name, str(values[at]), f"row {before + at + 1}: "))
    return values


def _is_no_number(name: str, text: str, where: str = "") -> str:
    return f"{where}column {name!r}: {text[:_SHOWN]!r} is no finite number"


def _by_options(path: Path, wanted: Sequence[str], given: dict[str, Any]) -> Columns:
    """Read a file as `pandas.read_csv` does with these options, whose columns have the names."""
    import pandas  # noqa: PLC0415 - slow, and not needed otherwise

    with open_regular(path) as file:
        if file.seek(0, 2) > MAX_CSV_BYTES:
            raise too_large(path, MAX_CSV_BYTES)
        file.seek(0)
        try:
            cells = [str(name) for name in pandas.read_csv(file, nrows=0, **given).columns]
            at = [_find(cells, name) for name in wanted]
            for name in wanted:
                if f"{name}.1" in cells:  # how pandas names the second one
                    raise ValueError(f"column {name!r} appears twice: rename one")
            file.seek(0)
            pieces, rows = _pieces(file, [cells[k] for k in at], wanted, given)
        except (_UnclearError, ValueError, TypeError) as error:
            raise ValueError(f"{path}: {error}") from error
    units = tuple(unit_of(cells[k]) for k in at)
    return _kept(wanted, units, str(path), pieces, rows, lambda row: f"row {row + 1}")


def _plain(path: Path, file: TextIOWrapper, wanted: Sequence[str], layout: _Layout) -> Columns:
    """Read the numbers line by line; the file stands at the first row."""
    columns = [array("d") for _ in wanted]
    rows = 0
    for line, row in _rows(path, file, layout):
        if any(row[layout.fields :]):
            raise ValueError(
                f"{path}: line {line} has {len(row)} fields, and the header {layout.fields}: with "
                "decimal commas, separate by semicolons or tabs"
            )
        rows += 1
        for column, at, name in zip(columns, layout.at, wanted, strict=True):
            text = row[at].strip() if at < len(row) else ""
            number = _number(text, layout.comma)
            if number is None:
                comma = " with a decimal comma" if layout.comma else ""
                raise ValueError(f"{path}: line {line}: {_is_no_number(name, text)}{comma}")
            column.append(number)
    piece = np.array([np.frombuffer(column) if column else [] for column in columns])
    return _kept(wanted, layout.units, str(path), [piece], rows, _line_finder(path, layout))


def _rows(path: Path, file: TextIOWrapper, layout: _Layout) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of the line in which each row ends, and its fields, without empty rows."""
    if layout.separator == " ":
        for number, line in enumerate(file, layout.skipped + 1):
            if row := line.split():
                yield number, row
        return
    lines = enumerate(file, layout.skipped + 1)
    for first, line in lines:
        number, text, found = first, line, cells_of(line, layout.separator)
        while found is None:
            number, more = next(lines, (number, ""))
            if not more or number - first > _MOST_LINES:
                raise ValueError(f"{path}: line {first}: a cell in quotes has no end")
            text += more
            found = cells_of(text, layout.separator)
        if any(found) or len(found) > 1:
            yield number, found


def _number(text: str, comma: bool) -> float | None:
    """Return the number in a cell, NaN if it is empty, None if it is no finite number."""
    if text.lower() in MISSING:
        return nan
    if comma and _COMMA.fullmatch(text):
        text = text.replace(".", "").replace(",", ".")
    elif comma and "." in text:
        return None
    if not _NUMBER.fullmatch(text):
        return None
    number = float(text)
    return number if isfinite(number) else None


def _line_finder(path: Path, layout: _Layout) -> Callable[[int], str]:
    """Return what tells the line of a row; the file is read again, as this is for errors."""

    def line(row: int) -> str:
        with _text(path) as (file, _):
            file.reconfigure(encoding=layout.encoding, errors="backslashreplace")
            for _ in range(layout.skipped):
                file.readline()
            number, _ = next(islice(_rows(path, file, layout), row, None), (0, []))
            return f"line {number}"

    return line


def _of_frame(frame: Any, wanted: Sequence[str]) -> Columns:
    """Take the columns of a data frame; its ``attrs`` may hold the units, as those of a trace."""
    kind = type(frame).__name__
    cells = [str(name) for name in frame.columns]
    try:
        labels = [frame.columns[_find(cells, name)] for name in wanted]
    except ValueError as error:
        raise ValueError(f"{kind}: {error}") from None
    piece = np.empty((len(wanted), len(frame)))
    for row, (label, name) in enumerate(zip(labels, wanted, strict=True)):
        try:
            piece[row] = _numbers(frame[label], name, 0)
        except _UnclearError as unclear:
            raise ValueError(f"{kind}: {unclear}") from None
    known = getattr(frame, "attrs", {}).get("units", {})
    units = tuple(
        unit_of(name) or str(known.get(label, ""))
        for name, label in zip(wanted, labels, strict=True)
    )
    index = getattr(frame, "index", range(len(frame)))
    return _kept(wanted, units, kind, [piece], len(frame), lambda row: f"row {index[row]!r}")


def _kept(
    wanted: Sequence[str],
    units: Sequence[str],
    source: str,
    pieces: list[Floats],
    rows: int,
    place: Callable[[int], str],
) -> Columns:
    """Join the pieces of rows, without those in which a column is empty."""
    there = [~np.isnan(piece).any(axis=0) for piece in pieces]
    whole = np.concatenate(there) if there else np.zeros(0, np.bool_)
    values = tuple(
        np.concatenate([piece[k][kept] for piece, kept in zip(pieces, there, strict=True)])
        if pieces
        else np.zeros(0)
        for k in range(len(wanted))
    )
    if not whole.any():
        raise ValueError(f"{source}: no row has all of {', '.join(wanted)}")
    left_out = rows - int(whole.sum())
    found = place
    if left_out:
        numbers = np.flatnonzero(whole)

        def found(row: int) -> str:
            return place(int(numbers[row]))

    return Columns(tuple(wanted), values, tuple(units), source, left_out, found)


# -- Units -------------------------------------------------------------------------------------

LENGTHS_MM: Final = {
    "m": 1e3, "cm": 10.0, "mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "micron": 1e-3, "nm": 1e-6,
}  # fmt: skip
TIMES_S: Final = {
    "s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0,
}  # fmt: skip
FORCES_N: Final = {
    "N": 1.0, "mN": 1e-3, "uN": 1e-6, "µN": 1e-6, "μN": 1e-6, "kN": 1e3, "gf": 9.80665e-3,
    "kgf": 9.80665,
}  # fmt: skip
NUMBERS: Final = {"-": 1.0, "1": 1.0, "%": 0.01, "N/N": 1.0}
SPEEDS_MM: Final = {f"{unit}/s": size for unit, size in LENGTHS_MM.items()}
ACCELERATIONS_M: Final = {
    f"{unit}/s{square}": 1e-3 * LENGTHS_MM[unit]
    for unit in ("m", "mm")
    for square in ("^2", "2", "²")
}
UNITS: Final = {**LENGTHS_MM, **TIMES_S, **FORCES_N, **NUMBERS, **SPEEDS_MM, **ACCELERATIONS_M}
"""Size of every known unit, in mm, s, N, 1, mm/s or m/s2."""
_WHAT: Final = (
    (LENGTHS_MM, "length"), (TIMES_S, "time"), (FORCES_N, "force"), (NUMBERS, "ratio"),
    (SPEEDS_MM, "speed"), (ACCELERATIONS_M, "acceleration"),
)  # fmt: skip


def size_of(name: str, unit: str, kind: Mapping[str, float]) -> float | None:
    """Return the size of the unit of a column, as in `UNITS`; None if nothing tells it.

    Parameters
    ----------
    name
        Name of the column, whose end may be a unit, as in ``x_mm``.
    unit
        What was found in brackets or in a row of units.
    kind
        Units of the wanted kind, such as `LENGTHS_MM`.

    Raises
    ------
    ValueError
        If it is a unit of another kind, or of a length or time and not known. Of a force or a ratio
        it may be a remark, as in ``mu (filtered)``.
    """
    if unit in kind:
        return kind[unit]
    what = next(word for units, word in _WHAT if units is kind)
    if unit in UNITS:
        raise ValueError(f"column {name!r} is in {unit}, which is no {what}")
    if unit and (kind is LENGTHS_MM or kind is TIMES_S):
        raise ValueError(
            f"column {name!r} has the unit {unit!r}, which is no known {what}: give unit=, and "
            "scale= with the factor to it"
        )
    last = _LAST.fullmatch(name)
    if last is None or last[0] in ("F_N", "f_N"):  # the normal force
        return None
    return kind.get(last[2])
