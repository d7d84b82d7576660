"""An append-only log of frames: after a sudden end of the process only the last second is missing.

A head of JSON is followed by records of 24 bytes: time in ns since the epoch, identifier, kind,
length, 8 bytes of data, and the CRC-32 of these. A record that is cut or damaged is skipped, and
later ones are still found.
"""

from __future__ import annotations

import json
import os
import struct
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from io import BufferedReader
from pathlib import Path
from time import monotonic_ns, time_ns
from typing import Any, Final
from zlib import crc32

import numpy as np
import numpy.typing as npt

from smarttac_can.host.background import Background
from smarttac_can.host.files import open_regular

FRAME, MARK, MARK_END = range(3)
"""Kinds of records: a frame, a piece of the text of a marker, and its last piece."""
RECORD: Final = np.dtype(
    [
        ("time_ns", "<u8"),
        ("can_id", "<u2"),
        ("kind", "u1"),
        ("length", "u1"),
        ("data", "u1", 8),
        ("crc", "<u4"),
    ]
)
Records = npt.NDArray[np.void]

_MAGIC: Final = b"SMARTTAC recording log 1\n"
_HEAD: Final = struct.Struct("<II")
_CHECKED: Final = struct.Struct("<QHBB8s")
_CRC: Final = struct.Struct("<I")
_FLUSH_S: Final = 0.25
_LONGEST_HEAD: Final = 16 << 20
_CHUNK: Final = 1 << 18
"""Records read at a time."""
_PIECE: Final = 8


class FrameLog(Background):
    """Writes a log in a separate thread; a context manager that ends when all is written.

    Parameters
    ----------
    path
        File to create; it must not exist.
    head
        Further data about the frames, for JSON.

    Attributes
    ----------
    error
        Error after which nothing more is written; None before.

    Raises
    ------
    FileExistsError
        If the file exists.
    OSError
        If the file cannot be written.
    """

    def __init__(self, path: Path, head: Mapping[str, Any]) -> None:
        self._file = path.open("xb")
        try:
            text = json.dumps(head).encode()
            self._file.write(_MAGIC + _HEAD.pack(len(text), crc32(text)) + text)
            self._sync()
        except OSError:
            with suppress(OSError):
                self._file.close()
            # The rest would be mistaken for the log of a killed recording.
            path.unlink()
            raise
        self._queue: deque[tuple[int, int, int, bytes]] = deque()
        # The time of a recording never goes back, even if the system clock is set back.
        self._epoch = time_ns() - monotonic_ns()
        self._over = threading.Event()
        self.error: OSError | None = None
        super().__init__("frame log", self._work, self._over.set)

    def frame(self, can_id: int, data: bytes) -> None:
        """Queue a frame for writing, with the present time."""
        if self.error is None:
            self._queue.append((monotonic_ns(), can_id, FRAME, data))

    def mark(self, text: str) -> None:
        """Queue the text of a marker for writing, with the present time."""
        now = monotonic_ns()
        data = text.encode()
        pieces = [data[at : at + _PIECE] for at in range(0, len(data), _PIECE)] or [b""]
        kinds = [MARK] * (len(pieces) - 1) + [MARK_END]
        if self.error is None:
            # One call, so that markers of several threads are not mixed.
            self._queue.extend(
                [(now, 0, kind, piece) for kind, piece in zip(kinds, pieces, strict=True)]
            )

    def _work(self) -> None:
        try:
            with self._file:
                while not self._over.wait(_FLUSH_S):
                    self._write()
                self._write()
        except OSError as error:
            self.error = error

    def _write(self) -> None:
        queue = self._queue
        parts: list[bytes] = []
        while queue:
            time, can_id, kind, data = queue.popleft()
            checked = _CHECKED.pack(time + self._epoch, can_id, kind, len(data), data)
            parts += (checked, _CRC.pack(crc32(checked)))
        if parts:
            self._file.write(b"".join(parts))
            self._sync()

    def _sync(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())


def is_frame_log(path: Path) -> bool:
    """Return whether a file begins as a log.

    Raises
    ------
    OSError
        If the file is not a regular file, or cannot be read.
    """
    with open_regular(path) as file:
        return file.read(len(_MAGIC)) == _MAGIC


class FrameLogReader:
    """Reads the undamaged records of a log.

    Parameters
    ----------
    path
        Path of the log.

    Attributes
    ----------
    head
        Head given to `FrameLog`.
    damaged
        Number of damaged records skipped so far.

    Raises
    ------
    ValueError
        If the file is not a log, or its head is damaged.
    OSError
        If the file is not a regular file, or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with open_regular(path) as file:
            self.head = self._read_head(file)
            self._start = file.tell()
        self.damaged = 0

    def chunks(self) -> Iterator[Records]:
        """Yield the records in order, many at a time."""
        with open_regular(self._path) as file:
            file.seek(self._start)
            while data := file.read(_CHUNK * RECORD.itemsize):
                cut = len(data) % RECORD.itemsize
                records = np.frombuffer(data[: len(data) - cut], RECORD)
                whole = _whole(records)
                self.damaged += int(np.count_nonzero(~whole)) + (cut > 0)
                yield records[whole]

    def _read_head(self, file: BufferedReader) -> dict[str, Any]:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise ValueError(f"{self._path} is no log of a recording")
        sizes = file.read(_HEAD.size)
        if len(sizes) == _HEAD.size:
            size, check = _HEAD.unpack(sizes)
            text = file.read(size) if size <= _LONGEST_HEAD else b""
            if len(text) == size and crc32(text) == check:
                with suppress(ValueError, RecursionError):
                    head = json.loads(text)
                    if isinstance(head, dict):
                        return head
        raise ValueError(f"the head of {self._path} is damaged: nothing can be made of it")


def _whole(records: Records) -> npt.NDArray[np.bool_]:
    view, size, checked = memoryview(records.tobytes()), RECORD.itemsize, _CHECKED.size
    found = [crc32(view[at : at + checked]) for at in range(0, len(view), size)]
    whole: npt.NDArray[np.bool_] = np.array(found, np.uint32) == records["crc"]
    return whole & (records["length"] <= _PIECE)
