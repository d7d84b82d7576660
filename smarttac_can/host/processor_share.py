"""What a process leaves of its processor to others: at a real-time priority nobody else does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

_WORK_NS: Final = 10_000_000
_SOON_NS: Final = 8_000_000
"""From here on what can wait does, so that a rest does not come at the wrong time."""
_WAITED_NS: Final = 500_000
"""For how long a thread waits in so much work, at least."""


class ProcessorShare:
    """Has a thread rest that does not wait for long enough by itself.

    That the system ran another meanwhile does not count: at a real-time priority that is one more
    urgent, and those below get nothing.

    Parameters
    ----------
    clock
        Monotonic time in ns.
    worked
        Processor time that the thread took, in ns.
    rest
        Waits for so many s.

    Attributes
    ----------
    rest
        As given; what it takes counts only where `rest_if_owed` calls it.
    """

    def __init__(
        self, clock: Callable[[], int], worked: Callable[[], int], rest: Callable[[float], None]
    ) -> None:
        self._clock = clock
        self._worked = worked
        self.rest = rest
        self._begin(clock(), worked())

    def waited(self, nanoseconds: int) -> None:
        """Count a wait, which may have been for one frame of many."""
        self._waited += nanoseconds

    def owed(self) -> int:
        """Return for how many us the thread should wait soon, 0 if that has time or was done."""
        return self._owed(_SOON_NS)

    def rest_if_owed(self) -> None:
        """Wait for as long as is owed, if that can be put off no more."""
        if owed := self._owed(_WORK_NS):
            self.rest(owed * 1e-6)
            self._begin(self._clock(), self._worked())

    def _owed(self, after: int) -> int:
        now = self._clock()
        passed = now - self._since
        if passed <= after:
            return 0
        worked = self._worked()
        work = worked - self._worked_since
        # A wait for one frame of many is work, too. What waits took beyond the idle time was; as
        # much again comes off, for idle may be what the system took: sure while that is less than
        # half of such waits. Far below 0 the unit of work is coarse.
        waited, idle = self._waited, passed - work
        if waited > idle > -_WAITED_NS:
            waited = max(2 * idle - waited, 0)
        if waited >= _WAITED_NS:
            self._begin(now, worked)
        elif work > after - _WAITED_NS:
            return -((waited - _WAITED_NS) // 1000)
        return 0

    def _begin(self, now: int, worked: int) -> None:
        self._since = now
        self._worked_since = worked
        self._waited = 0
