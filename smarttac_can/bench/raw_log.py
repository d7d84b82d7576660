"""All frames of a bus in one of python-can's log formats, beside a recording."""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path
from time import time
from types import TracebackType
from typing import Self

import can

from smarttac_can.master.errors import BenchError


class RawLog:
    """A log by python-can: ASC, BLF, CSV, candump (``.log``), SQLite, TRC by the file's suffix.

    Parameters
    ----------
    path
        A file that does not exist yet.

    Raises
    ------
    BenchError
        If it exists, cannot be written, or python-can has no such format.
    """

    def __init__(self, path: Path) -> None:
        if path.exists():
            raise BenchError(f"{path} exists: give the raw log another name")
        try:
            self._logger = can.Logger(path)
        except Exception as error:  # the formats raise what they like
            with suppress(OSError):
                if path.exists() and not path.stat().st_size:
                    path.unlink()
            raise BenchError(f"cannot log to {path}: {error}") from error
        # python-can's notifier receives in one thread, and a bench sends in others.
        self._lock = threading.Lock()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._lock:
            self._logger.stop()

    def message(self, message: can.Message) -> None:
        """Log a message that was received."""
        with self._lock:
            self._logger.on_message_received(message)

    def data_frame(self, can_id: int, data: bytes) -> None:
        """Log a data frame, with the present time."""
        self.message(
            can.Message(
                timestamp=time(),
                arbitration_id=can_id,
                data=data,
                is_extended_id=False,
                is_rx=False,
            )
        )
