"""Logs of bus traffic, frame by frame: read in the formats of python-can, written as candump.

A candump log has the format of ``candump -L`` (can-utils).
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from io import TextIOWrapper
from pathlib import Path
from typing import Any, Final, TextIO

import can

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od import cia
from smarttac_can.host.can_socket import to_frame
from smarttac_can.host.files import open_regular
from smarttac_can.host.frame_log import is_frame_log

_CANDUMP_LINE: Final = re.compile(
    r"(?:\((?P<time>[^()]+)\)\s+)?\S+\s+(?:(?:RX|TX)\s+\S+\s+\S+\s+)?(?P<id>[0-9A-F]{3,8})"
    r"(?:#(?P<fd>#[0-9A-F])?(?P<packed>(?:[0-9A-F]{2}\.?)*)(?P<rtr>R[0-8]?)?(?:_[9A-F])?(?:\s+[RT])?"
    r"|\s+[\[{]\s*(?P<size>[0-9A-F]{1,2})[\]}](?P<bytes>(?:\s+[0-9A-F]{2})*)"
    r"(?P<remote>\s+remote request)?(?:\s+ERRORFRAME)?(?:\s+'.*')?)\s*$",
    re.IGNORECASE,
)
"""A line of candump: of its log (``-L``), or as it shows a frame (``-t``, ``-x``, ``-a``)."""
_EXPLAINED: Final = re.compile(r"\t\S|\s{8,}\S")
"""Explanation that ``candump -e`` puts below an error frame."""
_ERROR: Final = 0x20000000
_EXTENDED_DIGITS: Final = 8
FD_BYTES: Final = 64
_LONGEST_LINE: Final = 1000
_SHOWN: Final = 60


def _candump(lines: Iterable[str]) -> Iterator[can.Message]:
    """Read the lines of candump, in its log or as it shows them.

    Raises
    ------
    ValueError
        A line is none.
    """
    for line in lines:
        if not line.strip() or _EXPLAINED.match(line):
            continue
        found = _CANDUMP_LINE.match(line.strip())
        if found is None:
            raise ValueError(line)
        number = found["id"]
        can_id = int(number, 16)
        data = bytes.fromhex((found["bytes"] or found["packed"] or "").replace(".", ""))
        # Of a CAN FD frame candump shows the length with two digits.
        fd = found["fd"] is not None or len(found["size"] or "") > 1
        if len(number) not in (3, 8) or len(data) > (FD_BYTES if fd else cia.FRAME_BYTES):
            raise ValueError(line)
        remote = bool(found["rtr"] or found["remote"])
        yield can.Message(
            timestamp=_seconds(found["time"]),
            arbitration_id=can_id & (_ERROR - 1),
            is_extended_id=len(number) == _EXTENDED_DIGITS and not can_id & _ERROR,
            is_error_frame=bool(can_id & _ERROR),
            is_remote_frame=remote,
            is_fd=fd,
            dlc=None if not remote else 0,
            data=data,
        )


def _seconds(text: str | None) -> float:
    """Return the time of a line in s, absolute or relative, or a date; 0 without one."""
    if text is None:
        return 0.0
    if "-" in text:
        return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
    return float(text)


_CANDUMP: Final = ".log"
_TEXT: Final[dict[str, Any]] = {
    _CANDUMP: _candump,
    ".txt": _candump,
    ".asc": can.ASCReader,
    ".csv": can.CSVReader,
    ".trc": can.TRCReader,
}
_BLF: Final = ".blf"
LOG_SUFFIXES: Final = (*_TEXT, _BLF)
"""Suffixes of the logs that can be read."""

OnCut = Callable[[str], object]
"""Function called with a line for the user about a log that is cut off."""


class CandumpWriter:
    """Writes a line like ``(0000000001.000055) can0 0A1#0102`` for each frame.

    python-can's own writer uses a float for the time and adds a direction. Both are unsuitable for
    logs that are compared byte by byte.

    Parameters
    ----------
    file
        Open text file; the caller closes it.
    channel
        Name of the bus in the log, without spaces.
    """

    def __init__(self, file: TextIO, channel: str = "can0") -> None:
        if not channel or any(character.isspace() for character in channel):
            raise ValueError(f"channel {channel!r} is empty or has spaces")
        self._write = file.write
        self._channel = channel

    def write(self, microseconds: int, frame: Frame) -> None:
        """Write the line of a frame with its time in us; usable as the log hook of a bus."""
        seconds, rest = divmod(microseconds, 1_000_000)
        data = "R" if frame.rtr else frame.data.hex().upper()
        self._write(f"({seconds:010d}.{rest:06d}) {self._channel} {frame.can_id:03X}#{data}\n")


def read_log(path: Path, on_cut: OnCut | None = None) -> Iterator[tuple[int, Frame]]:
    """Read the CANopen frames of a log; error, extended and CAN FD frames are skipped.

    Parameters, results and errors are those of `read_messages`.
    """
    return _frames(read_messages(path, on_cut))


def read_messages(path: Path, on_cut: OnCut | None = None) -> Iterator[tuple[int, can.Message]]:
    """Read a log message by message, in the format selected by its suffix.

    Parameters
    ----------
    path
        Log in the format candump (``.log``, ``.txt``), ASC, BLF, CSV or TRC.
    on_cut
        Function called with a line for the user if the log is cut off, as after a killed logger;
        a last line that is cut is skipped. Without it, a log that is cut is an error.

    Yields
    ------
    tuple of int and can.Message
        Time stamp in us, and the message.

    Raises
    ------
    OSError
        If the file is not a regular file, or cannot be read.
    ValueError
        If it has another format, or is cut or damaged; the message names the line.
    """
    if is_frame_log(path):
        raise ValueError(
            f"{path} is the log of a recording, which has no frames between plate and stimulator: "
            "its --raw log has"
        )
    suffix = path.suffix.lower()
    if suffix in _TEXT:
        return _read_text(path, suffix, on_cut)
    if suffix == _BLF:
        return _read_blf(path, on_cut)
    raise ValueError(f"{path} is none of {', '.join(LOG_SUFFIXES)}")


def read_candump(path: Path) -> Iterator[tuple[int, Frame]]:
    """Read a candump log with any suffix; otherwise as `read_log`, where a cut line is an error."""
    return _frames(_read_text(path, _CANDUMP, None))


def _frames(messages: Iterator[tuple[int, can.Message]]) -> Iterator[tuple[int, Frame]]:
    for time, message in messages:
        frame = to_frame(message)
        if frame is not None:
            yield time, frame


def _read_text(path: Path, suffix: str, on_cut: OnCut | None) -> Iterator[tuple[int, can.Message]]:
    with _Lines(path, on_cut) as lines:
        yield from _read(lines, _TEXT[suffix], lambda: lines.refusal(_kind(suffix)))


def _read_blf(path: Path, on_cut: OnCut | None) -> Iterator[tuple[int, can.Message]]:
    with open_regular(path) as file:
        stated = size = os.fstat(file.fileno()).st_size

        def reader(stream: Any) -> can.BLFReader:
            nonlocal stated
            log = can.BLFReader(stream)
            stated = log.file_size
            return log

        try:
            yield from _read(file, reader, lambda: f"{path} is no BLF log, or damaged")
        except ValueError:
            if stated <= size:
                raise
    if stated == size:
        return
    # python-can ends a log that is cut like a whole one, and its writer states the size at the end.
    cut = f"cut after {size} of {stated} bytes" if stated > size else "its logger has not ended it"
    text = f"{path}: {cut}, and its last frames may be missing"
    if on_cut is None:
        raise ValueError(text)
    on_cut(text)


def _kind(suffix: str) -> str:
    return "candump" if _TEXT.get(suffix) is _candump else suffix[1:].upper()


def _read(
    stream: Any, reader: Any, refusal: Callable[[], str]
) -> Iterator[tuple[int, can.Message]]:
    """Yield the messages of a reader with their times in us.

    If the log cannot be read, `refusal` returns the text of the error.
    """
    messages: Iterator[can.Message] | None = None
    while True:
        try:
            if messages is None:
                messages = iter(reader(stream))
            message = next(messages, None)
            time = 0 if message is None else round(message.timestamp * 1e6)
        except OSError:
            raise
        except Exception as error:  # formats raise errors of any type
            raise ValueError(refusal()) from error
        if message is None:
            return
        yield time, message


class _Lines(TextIOWrapper):
    """The lines of a log, read only up to the longest line of a frame."""

    def __init__(self, path: Path, on_cut: OnCut | None) -> None:
        super().__init__(open_regular(path), encoding="utf-8", errors="replace")
        self._path = path
        self._on_cut = on_cut
        self._number = 0
        self._line = ""

    def __next__(self) -> str:  # type: ignore[override] # typeshed declares that of bytes
        line = self._line = self.readline(_LONGEST_LINE)
        if not line:
            raise StopIteration
        self._number += 1
        if not line.endswith("\n"):
            if self._on_cut is None or len(line) == _LONGEST_LINE:
                raise ValueError
            self._on_cut(f"{self._path}: the last line, {self._number}, is cut and left out")
            raise StopIteration
        return line

    def refusal(self, kind: str) -> str:
        """Return the error for the last line read, which does not fit the format."""
        where = f"{self._path}, line {self._number}"
        line = self._line
        if not line:
            return f"{self._path} is no {kind} log, or ends too early"
        if line.endswith("\n"):
            return f"{where}: {line.strip()[:_SHOWN]!r} is no line of a {kind} log"
        what = "too long" if len(line) == _LONGEST_LINE else "cut"
        return f"{where}: {line[:_SHOWN]!r} is {what}: no line of a {kind} log"
