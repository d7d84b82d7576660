"""Files named by a user: opened safely, replaced as a whole, with errors in plain words."""

from __future__ import annotations

import errno
import os
import re
import stat
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from io import BufferedReader, BufferedWriter, FileIO, StringIO, TextIOWrapper
from pathlib import Path
from secrets import token_hex
from typing import Any, Final, TextIO

from smarttac_can.host.background import Background

_FLAGS: Final = os.O_RDONLY | sum(
    getattr(os, name, 0)
    for name in ("O_NONBLOCK", "O_NOCTTY", "O_BINARY")  # Windows has the last alone
)


def open_regular(path: Path) -> BufferedReader:
    """Open a regular file, or a link to one, without waiting.

    Raises
    ------
    OSError
        If it is something else, such as a pipe, a device or a directory, or cannot be opened.
    """
    # Check before opening as well, because opening alone has effects on some devices.
    _require_regular(path, path.stat())
    file = os.fdopen(os.open(path, _FLAGS), "rb")
    try:
        _require_regular(path, os.fstat(file.fileno()))
    except OSError:
        file.close()
        raise
    return file


_PART_BYTES: Final = 8
"""Random bytes in the name of a new file, so that nothing has it already."""


def part_of(path: Path) -> Path:
    """Return a free name beside `path`, for a file that is to take its place."""
    return path.with_name(f"{path.name}.{token_hex(_PART_BYTES)}.part")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield the name of a file to create, which takes the place of `path` after the block.

    Create it with mode ``x``, which follows no link, waits for no pipe and overwrites nothing. If
    the block fails, it is removed and `path` stays as it is. Whatever else is beside `path` stays.

    Raises
    ------
    OSError
        If it cannot be made, or not take the place of `path`, which is what the error names.
    """
    part = part_of(path)
    try:
        yield part
        part.replace(path)
    except OSError as error:
        if error.filename in (part, str(part)):
            error.filename, error.filename2 = str(path), None
        raise
    finally:
        with suppress(OSError):  # report why it could not be made, not this
            part.unlink()


def remove_parts(path: Path) -> None:
    """Remove what `replacing` has left beside `path` because the power failed."""
    name = re.compile(rf"{re.escape(path.name)}\.[0-9a-f]{{{2 * _PART_BYTES}}}\.part")
    with suppress(OSError), os.scandir(path.parent) as entries:
        for entry in entries:
            if name.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                Path(entry.path).unlink()


def read_bounded(path: Path, most: int) -> bytes:
    """Return the content of a regular file of at most `most` bytes.

    Raises
    ------
    OSError
        If the file is larger, and as for `open_regular`.
    """
    with open_regular(path) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise too_large(path, most)
    return data


def too_large(path: Path, most: int) -> OSError:
    """Return the error for a file that is larger than `most` bytes."""
    return OSError(errno.EFBIG, f"is larger than {most} bytes", str(path))


def cells(text: str, separator: str = ",") -> list[str] | None:
    """Return the cells of a row of a CSV file; None if one in quotes does not end in this text.

    The module `csv` is not used: how long its cells may be is a setting that any code in the
    process may change.
    """
    row = text.rstrip("\r\n")
    if '"' not in row:
        return [cell.strip() for cell in row.split(separator)] if row.strip() else []
    found, end = [], 0
    while cell := _cell(separator).match(row, end):
        quoted, behind, plain, border = cell.groups()
        found.append((plain if quoted is None else quoted.replace('""', '"') + behind).strip())
        if not border:
            return found
        end = cell.end()
    return None


@cache
def _cell(separator: str) -> re.Pattern[str]:
    other = f"[^{re.escape(separator)}]*"
    return re.compile(
        rf' *(?:"((?:[^"]|"")*+)"({other})|((?! *"){other}))({re.escape(separator)}|\Z)', re.DOTALL
    )


_LONGEST_CELL: Final = 100
"""Most characters of a number in a CSV file."""
Ranges = Mapping[str, tuple[float, float]]
"""Names of columns, with the least and the largest number in each."""


def read_numbers(
    path: Path, ranges: Ranges, *, most_rows: int, most_bytes: int = 1 << 20
) -> Iterator[tuple[int, list[float]]]:
    """Yield the line and the numbers of each row of a CSV file with exactly these columns.

    Raises
    ------
    ValueError
        If the header or a row is wrong, or there are more rows; the message names file and line.
    OSError
        As `read_bounded`.
    """
    text = read_bounded(path, most_bytes).decode("utf-8-sig", errors="replace")
    header, *lines = StringIO(text, newline=None).readlines() or [""]
    number = 1
    try:
        if cells(header) != list(ranges):
            raise ValueError(f"the header is not {','.join(ranges)}")
        for number, line in enumerate(lines, 2):
            if number > most_rows + 1:
                raise ValueError(f"there are more than {most_rows} rows")
            row = cells(line) or []
            if len(row) != len(ranges):
                raise ValueError(f"{len(row)} fields are not the {len(ranges)} of the header")
            yield number, list(map(_number, row, ranges.items()))
    except ValueError as error:
        raise ValueError(f"{path}: line {number}: {error}") from error


def _number(text: str, column: tuple[str, tuple[float, float]]) -> float:
    name, (low, high) = column
    if len(text) > _LONGEST_CELL:
        raise ValueError(f"{name} has {len(text)} characters, above {_LONGEST_CELL}")
    try:
        number = float(text)
    except ValueError:
        raise ValueError(f"{name} {text.strip()!r} is not a number") from None
    if not low <= number <= high:
        raise ValueError(f"{name} {text.strip()} is outside {low:g}..{high:g}")
    return number


def _require_regular(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "is no regular file", str(path))


def reason(error: OSError) -> str:
    """Return in words what is wrong with a file, or which folder is missing, without its name."""
    if error.filename is not None and isinstance(error, FileNotFoundError | NotADirectoryError):
        folders = list(reversed(Path(error.filename).parents))
        for folder in folders:
            if not folder.exists():
                return f"the folder {folder} does not exist"
            if not folder.is_dir():
                return f"{folder} is a file, not a folder"
        if isinstance(error, FileNotFoundError):
            return "there is no such file"
    if isinstance(error, IsADirectoryError):
        return "that is a folder, not a file"
    return error.strerror or str(error)


def trouble(error: OSError) -> str:
    """Return the name of the file, if there is one, and `reason`."""
    return reason(error) if error.filename is None else f"{error.filename}: {reason(error)}"


@contextmanager
def in_words(path: Path | str | None = None) -> Iterator[None]:
    """Give an `OSError` of the block the text of `trouble`, and keep its class.

    Parameters
    ----------
    path
        File to name if the error names none, as an error of writing; None to leave such errors.

    Raises
    ------
    OSError
        With the text of `trouble`, one line.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None:
            if path is None or not error.errno:
                raise
            error.filename = str(path)
        raise type(error)(trouble(error)) from None


@contextmanager
def result_file(path: Path) -> Iterator[TextIO]:
    r"""Open a file that replaces an old one when all of it is written.

    The file is UTF-8 with lines that end in ``\n``. If the block fails, the old file remains.

    Raises
    ------
    OSError
        If the file cannot be written; the message names it.
    """
    if path.exists() and not path.is_file():  # such as /dev/stdout, or a pipe
        with _opened(path, path, "w") as file:
            yield file
        return
    with replacing(path.resolve()) as part, _opened(part, path, "x") as file:
        yield file


def _opened(path: Path, name: Path, mode: str) -> TextIO:
    raw = _NamedFile(path, name, mode)
    return TextIOWrapper(BufferedWriter(raw), encoding="utf-8", newline="\n")


class _NamedFile(FileIO):
    """A file whose errors, also of writing, contain the name given by the user.

    Parameters
    ----------
    path
        File to write.
    name
        Name for the errors.
    mode
        ``w``, or ``x`` for a new file.
    """

    def __init__(self, path: Path, name: Path, mode: str) -> None:
        self._named = str(name)
        try:
            super().__init__(path, mode)
        except OSError as error:
            error.filename = self._named
            raise

    def write(self, data: Any) -> int:
        """Write some of the data."""
        try:
            return super().write(data)
        except OSError as error:
            error.filename = self._named
            raise


MAX_STORED_BYTES: Final = 4 << 20
"""Most bytes that a device stores; a DOMAIN takes up to 1 MiB of them."""


class StorageFile:
    """Storage of a device in one file, which holds the old or the new bytes after a power failure.

    Parameters
    ----------
    path
        The file, or a link to it. It need not exist; its directory must.

    Attributes
    ----------
    path
        The file after following all links.
    """

    def __init__(self, path: Path) -> None:
        # Follow links now: replacing a link would leave its target unchanged.
        self.path = Path(os.path.realpath(path))

    def read(self) -> bytes | None:
        """Return the content of the file, None if there is none.

        A half-written file, left by a power failure, is removed.

        Raises
        ------
        OSError
            If it is not a regular file, longer than `MAX_STORED_BYTES`, or cannot be read.
        """
        remove_parts(self.path)
        try:
            return read_bounded(self.path, MAX_STORED_BYTES)
        except FileNotFoundError:
            return None

    def require_writable(self) -> None:
        """Create a file beside it, as a write does, and remove it.

        Raises
        ------
        OSError
            If it cannot be created, as on a read-only file system; the error names the file itself.
        """
        part = part_of(self.path)
        try:
            part.open("xb").close()
            part.unlink()
        except OSError as error:
            error.filename = str(self.path)
            raise

    def write(self, data: bytes) -> None:
        """Replace the file as a whole; on `OSError` the old one remains."""
        if len(data) > MAX_STORED_BYTES:
            raise too_large(self.path, MAX_STORED_BYTES)
        with replacing(self.path) as part, part.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        _sync_directory(self.path.parent)


def _sync_directory(path: Path) -> None:
    """Make the new name durable; Windows cannot open directories and needs no such call."""
    if os.name == "nt":
        return
    directory = os.open(path, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


_LONGEST: Final = 500
_UNPRINTABLE: Final = re.compile("[^ -~]")
PERIOD_S: Final = 1.0
"""Least period in s between two writes of a `FaultFile`."""


class FaultFile(Background):
    """Stores lines that change now and then in a file, so that the caller never waits.

    A thread writes the file. It is a context manager that saves a last time at the end.

    Parameters
    ----------
    file
        File that is replaced as a whole whenever the lines have changed.
    lines
        Function that returns the lines; called in the thread.
    failed
        Function called in the thread with the first `OSError`; the lines are tried again.
    period
        Time in s between two calls of `lines`, above 0.
    """

    def __init__(
        self,
        file: StorageFile,
        lines: Callable[[], tuple[str, ...]],
        failed: Callable[[OSError], None],
        period: float = PERIOD_S,
    ) -> None:
        self._file = file
        self._lines = lines
        self._failed: Callable[[OSError], None] | None = failed
        self._period = period
        self._kept = lines()
        self._over = threading.Event()
        super().__init__("fault file", self._keep, self._over.set)

    def _keep(self) -> None:
        while not self._over.wait(self._period):
            self._save()
        self._save()

    def _save(self) -> None:
        lines = self._lines()
        if lines == self._kept:
            return
        try:
            self._file.write("".join(f"{line}\n" for line in lines).encode("ascii", "replace"))
        except OSError as error:
            if self._failed is not None:
                self._failed(error)
            self._failed = None
            return
        self._kept = lines


def read_lines(file: StorageFile) -> tuple[str, ...]:
    """Return the lines of a file, an empty tuple if it does not exist; raises `OSError`.

    Characters that are not printable ASCII become a question mark. Lines are cut at 500
    characters.
    """
    lines = (file.read() or b"").decode("latin-1").splitlines()
    return tuple(_UNPRINTABLE.sub("?", line[:_LONGEST]) for line in lines)


MAX_EDS_BYTES: Final = 4 << 20
"""Most bytes of an EDS; those of this package have 57 KB at most."""
_PACKAGE: Final = Path(__file__).parents[1]
PLACES: Final = (_PACKAGE / "eds", _PACKAGE.parent / "eds")
"""Folders of EDS files in an installed package, and in the source tree."""


def packaged_eds(name: str) -> Path:
    """Return the path of an EDS file of this package.

    Parameters
    ----------
    name
        Name of the file, e.g. ``plate.eds``.

    Raises
    ------
    FileNotFoundError
        If neither the installed package nor the source tree has it.
    """
    for place in PLACES:
        if (place / name).is_file():
            return place / name
    raise FileNotFoundError(f"there is no EDS file {name} in the package or its source tree")


def read_eds(name: str) -> str:
    """Return the text of an EDS file of this package.

    Raises
    ------
    FileNotFoundError
        As `packaged_eds`.
    """
    return packaged_eds(name).read_text(encoding="ascii")


def read_eds_file(path: Path) -> str:
    """Return the text of an EDS or DCF of any maker: ASCII by the standard, or UTF-8, or cp1252.

    Raises
    ------
    OSError
        If it is not a regular file, longer than `MAX_EDS_BYTES`, or cannot be read.
    """
    return decode_eds(read_bounded(path, MAX_EDS_BYTES))


def decode_eds(data: bytes) -> str:
    """Return the text of an EDS of any maker: ASCII by the standard, or UTF-8, or cp1252."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")
