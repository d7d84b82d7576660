"""The watchdogs of SYNC where it is the tick of the loop: lost, irregular, counter jumped."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from smarttac_can.nodes.loop_period import TICK_US
from smarttac_can.nodes.watchdogs import SYNC_LOST_CYCLES, SYNC_WINDOW_CYCLES, Watchdog
from smarttac_can.od.cia import COB_SYNC_PRODUCER, SYNC_COB_ID, SYNC_COUNTER
from smarttac_can.od.dictionary import ObjectDictionary

_TOLERANCE: Final = 2
"""SYNCs more or less than ticks of device time in a window: it moves by whole ticks."""


class SyncWatch:
    """Compares SYNC with device time, from the first SYNC on.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    trip, settle
        Called with a watchdog whose fault comes or goes.

    Notes
    -----
    A node that produces SYNC itself is not to hear any other.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        trip: Callable[[Watchdog], None],
        settle: Callable[[Watchdog], None],
    ) -> None:
        self._overflow = od.entry(SYNC_COUNTER)
        self._cob_id = od.entry(SYNC_COB_ID)
        self._trip = trip
        self._settle = settle
        self.restart()

    @property
    def _own(self) -> bool:
        return bool(self._cob_id.value & COB_SYNC_PRODUCER)

    def restart(self) -> None:
        """Wait for a first SYNC."""
        self._running = False
        self._silence = self._elapsed = self._count = self._counter = 0
        self._settle(Watchdog.SYNC_LOST)
        self._settle(Watchdog.SYNC_IRREGULAR)

    def advance(self, microseconds: int) -> None:
        """Let time pass in us, and see whether SYNC is late, or comes too often or seldom."""
        if not self._running:
            return
        self._elapsed += microseconds
        own = self._own
        self._silence = 0 if own else self._silence + microseconds
        if self._silence >= SYNC_LOST_CYCLES * TICK_US:
            self._trip(Watchdog.SYNC_LOST)
        if self._elapsed >= SYNC_WINDOW_CYCLES * TICK_US:
            right, tolerance = (0, 0) if own else (self._elapsed // TICK_US, _TOLERANCE)
            if abs(self._count - right) > tolerance:
                self._trip(Watchdog.SYNC_IRREGULAR)
            else:
                self._settle(Watchdog.SYNC_IRREGULAR)
            self._elapsed = self._count = 0

    def heard(self, counter: int) -> None:
        """Take a SYNC of another node with its counter, 0 where it has none."""
        self._running = True
        self._silence = 0
        self._count += 1
        if self._own or self._count > SYNC_WINDOW_CYCLES + _TOLERANCE:
            # At once, also where device time stands still and `advance` sees nothing.
            self._trip(Watchdog.SYNC_IRREGULAR)
        self._settle(Watchdog.SYNC_LOST)
        before, self._counter = self._counter, counter
        if before and counter and counter != before % self._overflow.value + 1:
            self._trip(Watchdog.SYNC_COUNTER)
