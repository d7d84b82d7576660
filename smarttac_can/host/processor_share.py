"""What a process leaves of its processor to others: at a real-time priority nobody else does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

_WINDOW_US: Final = 10_000
_LEFT_US: Final = 500
"""What of the processor is left to others in a window at least: 5 %, as Linux does by itself."""


class ProcessorShare:
    """Counts what is left of the processor, be it by a wait or since the system ran another.

    Parameters
    ----------
    now
        Time in us.
    worked
        Processor time that the thread took, in ns. Where it is counted in units of many ms nothing
        is owed.
    """

    def __init__(self, now: int, worked: Callable[[], int]) -> None:
        self._worked = worked
        self._begin(now, worked())

    def owed(self, now: int) -> int:
        """Return for how many us the thread should rest now, 0 if it has left enough."""
        if now - self._since <= _WINDOW_US:
            return 0
        worked = self._worked()
        left = now - self._since - (worked - self._worked_since) // 1000
        # Far below 0 the unit of processor time is coarse.
        if abs(left) < _LEFT_US:
            return _LEFT_US - left
        self._begin(now, worked)
        return 0

    def _begin(self, now: int, worked: int) -> None:
        self._since = now
        self._worked_since = worked
