"""Logs of bus traffic in the formats that python-can reads, frame by frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import can

from smarttac_can.device.frame import Frame
from smarttac_can.host.bounded_file import open_regular
from smarttac_can.host.candump import Lines, ToldCut, read_candump, stamped
from smarttac_can.host.frame_log import is_frame_log

_CANDUMP: Final = ".log"
_TEXT: Final[dict[str, Any]] = {".asc": can.ASCReader, ".csv": can.CSVReader, ".trc": can.TRCReader}
_BINARY: Final[dict[str, Any]] = {".blf": can.BLFReader}
LOG_SUFFIXES: Final = (_CANDUMP, *_TEXT, *_BINARY)
"""Of the logs that can be read."""


def read_log(path: Path, told_cut: ToldCut | None = None) -> Iterator[tuple[int, Frame]]:
    """Read a log frame by frame, in the format that its suffix stands for.

    Parameters
    ----------
    path
        A candump (``.log``), ASC, BLF, CSV or TRC.
    told_cut
        Called with a line to show where the last line of a log is cut, as of a logger that was
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
        If it is none of these, or where it is cut or damaged; names the line.
    """
    if is_frame_log(path):
        raise ValueError(
            f"{path} is the log of a recording, which has no frames between plate and stimulator: "
            "its --raw log has"
        )
    suffix = path.suffix.lower()
    if suffix == _CANDUMP:
        return read_candump(path, told_cut)
    if suffix in _TEXT:
        return _read_text(path, suffix, told_cut)
    if suffix in _BINARY:
        return _read_binary(path, suffix)
    raise ValueError(f"{path} is none of {', '.join(LOG_SUFFIXES)}")


def _read_text(path: Path, suffix: str, told_cut: ToldCut | None) -> Iterator[tuple[int, Frame]]:
    with Lines(path, told_cut) as lines:
        yield from _read(lines, suffix, lambda: lines.refusal(_kind(suffix)))


def _read_binary(path: Path, suffix: str) -> Iterator[tuple[int, Frame]]:
    with open_regular(path) as file:
        yield from _read(file, suffix, lambda: f"{path} is no {_kind(suffix)} log, or damaged")


def _read(stream: Any, suffix: str, refusal: Callable[[], str]) -> Iterator[tuple[int, Frame]]:
    try:
        messages = iter((_BINARY | _TEXT)[suffix](stream))
    except Exception as error:  # the formats raise what they like
        raise ValueError(refusal()) from error
    # The formats raise what they like.
    yield from stamped(messages, refusal, (Exception,))


def _kind(suffix: str) -> str:
    return suffix[1:].upper()
