"""Frames that wait on a bus, read ahead by a process that came late: which newer ones there are."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import Bus

LATE_US: Final = 2000
"""From here on a process came late: what waits on the bus may be older than what is due."""
_READING_NS: Final = 1_000_000
"""For how long they are read ahead, but for the last one."""


def kind(frame: Frame) -> tuple[int, bool, int]:
    """Return what two frames have in common of which the newer one overtakes the other."""
    return frame.can_id, frame.rtr, len(frame.data)


class ReadAhead:
    """Takes frames of a bus one by one, as they came.

    Frames that were read ahead are judged by what is listened to when they are taken: a frame in
    front of them may change it.

    Parameters
    ----------
    bus
        The bus.
    clock
        Monotonic time in ns.

    Attributes
    ----------
    late
        Whether more frames may wait: nobody has looked for 2 ms, be it that none came.
    """

    def __init__(self, bus: Bus, clock: Callable[[], int]) -> None:
        self._bus = bus
        self._clock = clock
        self._ahead: deque[Frame] = deque()
        self._can_ids: frozenset[int] | None = None
        self._looked = clock()
        self.late = False

    def listen_to(self, can_ids: frozenset[int]) -> None:
        """Pass over frames with other identifiers from now on, as `Bus.listen_to` does."""
        self._can_ids = can_ids
        self._bus.listen_to(can_ids)

    def receive(self, timeout: float, patience: float = 0.0) -> Frame | None:
        """Return the next frame, as `Bus.receive` does."""
        while self._ahead:
            waiting = self._ahead.popleft()
            if self._can_ids is None or waiting.can_id in self._can_ids:
                self.late = False
                return waiting
        frame = self._bus.receive(timeout, patience)
        before, self._looked = self._looked, self._clock()
        self.late = self._looked - before >= 1000 * LATE_US
        return frame

    def put_back(self, frame: Frame) -> None:
        """Have the frame that was received last come again."""
        self._ahead.appendleft(frame)

    def read(self) -> int:
        """Read what waits, behind what was read before; return the longest time for one in ns."""
        now = self._clock()
        end = now + _READING_NS
        longest = 0
        while now < end:
            frame = self._bus.receive(0.0, (end - now) * 1e-9, every=True)
            if frame is None:
                break
            self._ahead.append(frame)
            before, now = now, self._clock()
            longest = max(longest, now - before)
        self._looked = now
        return longest

    def look_behind(self) -> None:
        """Read what waits behind the frame that was received last, if nothing is read yet."""
        if not self._ahead:
            self.read()

    def overtaken(self, frame: Frame) -> bool:
        """Whether a newer frame of its kind was read behind the one that was received last."""
        return any(kind(newer) == kind(frame) for newer in self._ahead)
