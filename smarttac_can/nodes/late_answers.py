"""Which answers come behind the next SYNC: their drives are not in force in time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from smarttac_can.nodes.plate_block import TICK_MASK

TOLD: Final = 20
"""Over how many drives it is told how many were late."""
_HALF: Final = TICK_MASK // 2
_LAST: Final = (1 << TOLD) - 1


class LateAnswers:
    """Compares SYNCs with the ticks of the plate, which counts them.

    How many SYNCs the stimulator is ahead, of 256, is least where an answer is in time. One more is
    a SYNC between the measurement and its drive: the next cycle of the plate begins without it.

    Parameters
    ----------
    deadline_ms
        Returns the deadline of the loop.

    Notes
    -----
    A SYNC that the plate has not heard makes all answers look late, and so does a loop that never
    is in time, whose voltage the deadline of the plate ends: after as many of them that is the new
    least. One that overtook its SYNC looks early; two among the last `TOLD` are the new least. What
    waits in a queue of this node is not seen.
    """

    __slots__ = ("_ahead", "_deadline_ms", "_early", "_history", "_in_a_row", "_syncs")

    def __init__(self, deadline_ms: Callable[[], int]) -> None:
        self._deadline_ms = deadline_ms
        self._syncs = 0
        self.restart()

    def restart(self) -> None:
        """Take the next answer for one in time, and forget those before."""
        self._ahead: int | None = None
        self._in_a_row = self._early = self._history = 0

    def sync(self) -> None:
        """Take a SYNC that is the tick of the plate."""
        self._syncs = self._syncs + 1 & TICK_MASK

    def late(self, tick: int) -> bool:
        """Take the answer to a tick, 0..255, which is about to go out; tell whether it is late."""
        late = self._is_late(self._syncs - tick & TICK_MASK)
        self._history = (self._history << 1 | late) & _LAST
        return late

    def told(self) -> str:
        """Say how many of the last answers were late; nothing if none was."""
        late = self._history.bit_count()
        return f"{late} of the last {TOLD} drives late" if late else ""

    def _is_late(self, ahead: int) -> bool:
        if self._ahead is None:
            self._ahead = ahead
        more = ahead - self._ahead & TICK_MASK
        early = more > _HALF
        self._early = (self._early << 1 | early) & _LAST
        if more == 0:
            self._in_a_row = 0
        elif early:
            if self._early.bit_count() > 1:
                self._take_for_least(ahead)
        else:
            self._in_a_row += 1
            if self._in_a_row <= self._deadline_ms():
                return True
            self._take_for_least(ahead)
        return False

    def _take_for_least(self, ahead: int) -> None:
        self._ahead = ahead
        self._in_a_row = self._early = 0
