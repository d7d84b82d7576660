"""Logs of bus traffic in the format of ``candump -L`` (can-utils)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from io import TextIOWrapper
from pathlib import Path
from typing import Final, TextIO

import can

from smarttac_can.device.frame import Frame
from smarttac_can.host.bounded_file import open_regular
from smarttac_can.host.python_can import to_frame

_LONGEST_LINE: Final = 1000
_SHOWN: Final = 60

ToldCut = Callable[[str], object]
"""Called with what to show of a log that is cut."""


class CandumpWriter:
    """Writes a line like ``(0000000001.000055) can0 0A1#0102`` for each frame.

    python-can's own writer takes the time as a float and adds a direction; a log that is compared
    byte by byte wants neither.

    Parameters
    ----------
    file
        Open for text; stays the caller's to close.
    channel
        Name of the bus in the log, without spaces.
    """

    def __init__(self, file: TextIO, channel: str = "can0") -> None:
        if not channel or any(character.isspace() for character in channel):
            raise ValueError(f"channel {channel!r} is empty or has spaces")
        self._write = file.write
        self._channel = channel

    def write(self, microseconds: int, frame: Frame) -> None:
        """Write the line of one frame, with a time in us; fits as the log hook of a bus."""
        seconds, rest = divmod(microseconds, 1_000_000)
        data = "R" if frame.rtr else frame.data.hex().upper()
        self._write(f"({seconds:010d}.{rest:06d}) {self._channel} {frame.can_id:03X}#{data}\n")


def read_candump(path: Path, told_cut: ToldCut | None = None) -> Iterator[tuple[int, Frame]]:
    """Read a log line by line.

    Parameters
    ----------
    path
        The log, of can-utils, python-can or `CandumpWriter`.
    told_cut
        Called with a line to show where the last line of the log is cut, as of a logger that was
        killed: it is left out. Without, that is an error.

    Yields
    ------
    tuple of int and Frame
        Time stamp in us, and the frame; error, extended and CAN FD frames are passed over.

    Raises
    ------
    OSError
        If it is no regular file, or cannot be read.
    ValueError
        At a line that is no candump log, or that is cut; names it.
    """
    with Lines(path, told_cut) as lines, can.CanutilsLogReader(lines) as log:
        wrong = (ValueError, IndexError, OverflowError)
        yield from stamped(iter(log), lambda: lines.refusal("candump"), wrong)


def stamped(
    messages: Iterator[can.Message],
    refusal: Callable[[], str],
    wrong: tuple[type[Exception], ...],
) -> Iterator[tuple[int, Frame]]:
    """Turn messages of a log into frames.

    Parameters
    ----------
    messages
        Of python-can.
    refusal
        Returns what the error says where one cannot be read.
    wrong
        What the format raises there, besides OSError.

    Yields
    ------
    tuple of int and Frame
        Time stamp in us, and the frame; error, extended and CAN FD frames are passed over.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        At a message that cannot be read.
    """
    while True:
        try:
            message = next(messages, None)
            time = 0 if message is None else round(message.timestamp * 1e6)
        except OSError:
            raise
        except wrong as error:
            raise ValueError(refusal()) from error
        if message is None:
            return
        frame = to_frame(message)
        if frame is not None:
            yield time, frame


class Lines(TextIOWrapper):
    """The lines of a log, none of which is read further than a frame can go.

    Parameters
    ----------
    path
        The log.
    told_cut
        As of `read_candump`.

    Raises
    ------
    OSError
        If it is no regular file, or cannot be read.
    """

    def __init__(self, path: Path, told_cut: ToldCut | None = None) -> None:
        super().__init__(open_regular(path), encoding="utf-8", errors="replace")
        self._path = path
        self._told_cut = told_cut
        self._number = 0
        self._line = ""

    def __next__(self) -> str:  # type: ignore[override] # typeshed has it that of bytes
        line = self._line = self.readline(_LONGEST_LINE)
        if not line:
            raise StopIteration
        self._number += 1
        if not line.endswith("\n"):
            if self._told_cut is None or len(line) == _LONGEST_LINE:
                raise ValueError
            self._told_cut(f"{self._path}: the last line, {self._number}, is cut and left out")
            raise StopIteration
        return line

    def refusal(self, kind: str) -> str:
        """Say that the line that was read last is none of a log of a kind."""
        where = f"{self._path}, line {self._number}"
        line = self._line
        if not line:
            return f"{self._path} is no {kind} log, or ends too early"
        if line.endswith("\n"):
            return f"{where}: {line.strip()[:_SHOWN]!r} is no line of a {kind} log"
        what = "too long" if len(line) == _LONGEST_LINE else "cut"
        return f"{where}: {line[:_SHOWN]!r} is {what}: no line of a {kind} log"
