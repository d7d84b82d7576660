"""Which answers come behind the next SYNC: their drives are not in force in time."""

from __future__ import annotations

from typing import Final

from smarttac_can.nodes.plate_block import TICK_MASK

WINDOW: Final = 20
"""Late answers in a row before that is how it is, and over how many are told; those of the default
deadline."""
_HALF: Final = TICK_MASK // 2
_LAST: Final = (1 << WINDOW) - 1


class LateAnswers:
    """Compares SYNCs with the ticks of the plate, which counts them.

    How many SYNCs the stimulator is ahead, of 256, is least where an answer is in time. One more is
    a SYNC between the measurement and its drive: the next cycle of the plate begins without it.

    Notes
    -----
    A SYNC that the plate has not heard makes all answers look late, and so does a loop that never
    is in time, which the deadline of the plate ends: after `WINDOW` of them that is the new least.
    What waits in a queue of this node is not seen.
    """

    __slots__ = ("_ahead", "_behind", "_history", "_syncs")

    def __init__(self) -> None:
        self._syncs = self._ahead = 0
        self.restart()

    def restart(self) -> None:
        """Take the next answer for one in time, and forget those before."""
        self._behind = WINDOW
        self._history = 0

    def sync(self) -> None:
        """Take a SYNC that is the tick of the plate."""
        self._syncs = self._syncs + 1 & TICK_MASK

    def late(self, tick: int) -> bool:
        """Take the answer to a tick, 0..255, which is about to go out; tell whether it is late."""
        ahead = self._syncs - tick & TICK_MASK
        more = ahead - self._ahead & TICK_MASK
        self._behind = self._behind + 1 if more else 0
        if more > _HALF or self._behind > WINDOW:
            self._ahead = ahead
            more = self._behind = 0
        late = more > 0
        self._history = (self._history << 1 | late) & _LAST
        return late

    def told(self) -> str:
        """Say how many of the last answers were late; nothing if none was."""
        late = self._history.bit_count()
        return f"{late} of the last {WINDOW} drives late" if late else ""
