"""How many ticks of device time had no cycle, second by second."""

from __future__ import annotations

from typing import Final

from smarttac_can.device.timer import Clock
from smarttac_can.vocabulary.signals import TICK_US

TICKS: Final = 1000
"""Ticks over which they are counted: a second."""
_IDLE: Final = -1


class MissedTime:
    """Compares cycles with device time.

    A cycle that comes late is none that is missed; one that never comes is.

    Parameters
    ----------
    clock
        Device time.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.restart()

    def restart(self) -> None:
        """Begin with the next cycle."""
        self._begun = _IDLE
        self._cycles = 0

    @property
    def missed(self) -> int:
        """Ticks of this second that were missed so far."""
        if self._begun == _IDLE:
            return 0
        return max(0, (self._clock.now - self._begun) // TICK_US - self._cycles)

    def cycle(self) -> int:
        """Take a cycle; return how many ticks were missed if a second ends with it, else 0."""
        now = self._clock.now
        if self._begun == _IDLE:
            self._begun = now
            return 0
        self._cycles += 1
        ticks = (now - self._begun) // TICK_US
        if ticks < TICKS:
            return 0
        missed = max(0, ticks - self._cycles)
        self._begun += ticks * TICK_US
        self._cycles = 0
        return missed
