"""How many ticks of device time had no cycle, second by second, and why."""

from __future__ import annotations

from typing import Final

from smarttac_can.device.timer import Clock
from smarttac_can.vocabulary.signals import TICK_US

TICKS: Final = 1000
"""Ticks over which they are counted: a second."""
_IDLE: Final = -1
_STANDSTILL: Final = 3
"""Ticks without a sign of life from which on a node did not run: a slow cycle takes 1 to 2."""
_MOSTLY: Final = 0.5
_PAUSES: Final = (
    "start the node with --realtime, end other programs, or take a computer that is not shared"
)
_SLOW: Final = (
    "cycles take too long or the plate answers late: end other programs, or take a faster computer"
)


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
        self._awake = clock.now
        self.restart()

    def restart(self) -> None:
        """Begin with the next cycle."""
        self._begun = _IDLE
        self._cycles = self._stood = 0
        self._told = ""

    def awake(self) -> None:
        """Take a sign of life: the node runs, whether or not it has a cycle."""
        now = self._clock.now
        gap = (now - self._awake) // TICK_US
        if gap >= _STANDSTILL:
            self._stood += gap - 1
        self._awake = now

    def told(self) -> str:
        """Say of the last whole second what was missed, why, and what helps; empty before one."""
        return self._told

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
            self._begun = self._awake = now
            return 0
        self.awake()
        self._cycles += 1
        ticks = (now - self._begun) // TICK_US
        if ticks < TICKS:
            return 0
        missed = max(0, ticks - self._cycles)
        if missed:
            stood = min(self._stood, missed)
            cure = _PAUSES if stood > _MOSTLY * missed else _SLOW
            self._told = (
                f"{missed} of {ticks} ticks missed, {stood} of them while the machine stood still "
                f"or gave this process no time; {cure}"
            )
        self._begun += ticks * TICK_US
        self._cycles = self._stood = 0
        return missed
