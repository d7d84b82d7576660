"""Frames that wait on a bus, read ahead by a process that came late: which newer ones there are."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import Bus

_LATE_NS: Final = 2_000_000
"""A bus that nobody looked at for so long may have several frames waiting."""
_READING_NS: Final = 1_000_000
"""For how long they are read ahead."""


class ReadAhead:
    """Takes frames of a bus one by one, as they came.

    Parameters
    ----------
    bus
        The bus.
    clock
        Monotonic time in ns.
    """

    def __init__(self, bus: Bus, clock: Callable[[], int]) -> None:
        self._bus = bus
        self._clock = clock
        self._ahead: deque[Frame] = deque()
        self._looked = clock()
        self._late = False

    def receive(self, timeout: float, patience: float = 0.0) -> Frame | None:
        """Return the next frame, as `Bus.receive` does."""
        if self._ahead:
            return self._ahead.popleft()
        frame = self._bus.receive(timeout, patience)
        before, self._looked = self._looked, self._clock()
        self._late = self._looked - before >= _LATE_NS
        return frame

    def overtaken(self, frame: Frame) -> bool:
        """Whether a newer frame of its identifier waits behind the one that was received last.

        After a pause the frames that wait are read for it.
        """
        if self._late:
            self._late = False
            self._read()
        return any(newer.can_id == frame.can_id for newer in self._ahead)

    def _read(self) -> None:
        end = self._clock() + _READING_NS
        while self._clock() < end and (frame := self._bus.receive(0.0)) is not None:
            self._ahead.append(frame)
