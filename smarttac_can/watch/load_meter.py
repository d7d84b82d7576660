"""How busy the bus was in the last second."""

from __future__ import annotations

from collections import deque
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.od.timing import frame_seconds

WINDOW_S: Final = 1.0


class LoadMeter:
    """Sums the time that frames take on the wire, each as long as stuff bits can make it.

    Parameters
    ----------
    bit_rate
        In bit/s, above 0.
    """

    def __init__(self, bit_rate: int) -> None:
        # An RTR frame and one of no data are as long as each other.
        self._seconds = [frame_seconds(size, bit_rate) for size in range(9)]
        self._frames: deque[tuple[float, float]] = deque()
        self._busy = 0.0

    def take(self, now: float, frame: Frame) -> None:
        """Count a frame that was on the bus at a time in s."""
        seconds = self._seconds[0 if frame.rtr else len(frame.data)]
        self._frames.append((now, seconds))
        self._busy += seconds

    def at(self, now: float) -> tuple[float, float]:
        """Return the share of the last second that was busy, and its frames."""
        while self._frames and self._frames[0][0] <= now - WINDOW_S:
            self._busy -= self._frames.popleft()[1]
        if not self._frames:
            self._busy = 0.0
        return self._busy / WINDOW_S, len(self._frames) / WINDOW_S
