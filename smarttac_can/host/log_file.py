"""Logs of bus traffic in the formats that python-can reads, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import can

from smarttac_can.device.frame import Frame
from smarttac_can.host.bounded_file import open_regular
from smarttac_can.host.candump import Lines, read_candump, stamped
from smarttac_can.host.frame_log import is_frame_log

_CANDUMP: Final = ".log"
_TEXT: Final[dict[str, Any]] = {".asc": can.ASCReader, ".csv": can.CSVReader, ".trc": can.TRCReader}
_BINARY: Final[dict[str, Any]] = {".blf": can.BLFReader}
LOG_SUFFIXES: Final = (_CANDUMP, *_TEXT, *_BINARY)
"""Of the logs that can be read."""


def read_log(path: Path) -> Iterator[tuple[int, Frame]]:
    """Read a log frame by frame, in the format that its suffix stands for.

    Parameters
    ----------
    path
        A candump (``.log``), ASC, BLF, CSV or TRC.

    Yields
    ------
    tuple of int and Frame
        Time stamp in us, and the frame; error, extended and CAN FD frames are passed over.

    Raises
    ------
    OSError
        If it is no regular file, or cannot be read.
    ValueError
        If it is none of these, or where it is cut or damaged.
    """
    if is_frame_log(path):
        raise ValueError(
            f"{path} is the log of a recording, which has no frames between plate and stimulator: "
            "its --raw log has"
        )
    suffix = path.suffix.lower()
    if suffix == _CANDUMP:
        return read_candump(path)
    if suffix not in LOG_SUFFIXES:
        raise ValueError(f"{path} is none of {', '.join(LOG_SUFFIXES)}")
    return _read(path, suffix)


def _read(path: Path, suffix: str) -> Iterator[tuple[int, Frame]]:
    kind = suffix[1:].upper()
    file = open_regular(path)
    with file if suffix in _BINARY else Lines(file, encoding="utf-8", errors="replace") as stream:
        try:
            messages = iter((_BINARY | _TEXT)[suffix](stream))
        except Exception as error:  # the formats raise what they like
            raise ValueError(f"{path} is no {kind} log: {error}") from error
        # The formats raise what they like.
        yield from stamped(messages, f"{path} is no {kind} log, or cut", (Exception,))
