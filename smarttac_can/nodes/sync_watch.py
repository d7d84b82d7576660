"""The watchdogs of SYNC where it is the tick of the loop: lost, irregular, counter jumped."""

from __future__ import annotations

from collections.abc import Callable

from smarttac_can.device.timer import Clock
from smarttac_can.nodes.loop_period import TICK_US
from smarttac_can.nodes.watchdogs import Watchdog, sync_tolerance, sync_window
from smarttac_can.od.cia import COB_SYNC_PRODUCER, SYNC_COB_ID, SYNC_COUNTER
from smarttac_can.od.dictionary import ObjectDictionary


class SyncWatch:
    """Compares SYNC with device time, from the first SYNC on.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    clock
        Device time.
    deadline_ms
        How long the loop may be without a measurement, and so without SYNC.
    trip, settle
        Called with a watchdog whose fault comes or goes.

    Notes
    -----
    A node that produces SYNC itself is not to hear any other.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        clock: Clock,
        deadline_ms: Callable[[], int],
        trip: Callable[[Watchdog], None],
        settle: Callable[[Watchdog], None],
    ) -> None:
        self._overflow = od.entry(SYNC_COUNTER)
        self._cob_id = od.entry(SYNC_COB_ID)
        self._clock = clock
        self._silence = clock.timer(lambda: trip(Watchdog.SYNC_LOST))
        self._window = clock.timer(self._on_window_end)
        self._deadline_ms = deadline_ms
        self._trip = trip
        self._settle = settle
        self.restart()

    @property
    def _own(self) -> bool:
        return bool(self._cob_id.value & COB_SYNC_PRODUCER)

    def restart(self) -> None:
        """Wait for a first SYNC."""
        self._silence.stop()
        self._window.stop()
        self._count = self._counter = 0
        self._settle(Watchdog.SYNC_LOST)
        self._settle(Watchdog.SYNC_IRREGULAR)

    def heard(self, counter: int) -> None:
        """Take a SYNC of another node with its counter, 0 where it has none."""
        deadline_ms = self._deadline_ms()
        if not self._window.running:
            self._begin_window(deadline_ms)
        self._count += 1
        if self._own or self._count > sync_window(deadline_ms) + sync_tolerance(deadline_ms):
            # At once, also where device time stands still and no window ends.
            self._trip(Watchdog.SYNC_IRREGULAR)
        if self._own:
            self._silence.stop()
        else:
            self._silence.start(deadline_ms * TICK_US)
        self._settle(Watchdog.SYNC_LOST)
        before, self._counter = self._counter, counter
        if before and counter and counter != before % self._overflow.value + 1:
            self._trip(Watchdog.SYNC_COUNTER)

    def _begin_window(self, deadline_ms: int) -> None:
        self._count = 0
        self._begun = self._clock.now
        self._window.start(sync_window(deadline_ms) * TICK_US)

    def _on_window_end(self) -> None:
        deadline_ms = self._deadline_ms()
        if self._own:
            right, tolerance = 0, 0
        else:
            right = (self._clock.now - self._begun) // TICK_US
            tolerance = sync_tolerance(deadline_ms)
        if abs(self._count - right) > tolerance:
            self._trip(Watchdog.SYNC_IRREGULAR)
        else:
            self._settle(Watchdog.SYNC_IRREGULAR)
        self._begin_window(deadline_ms)
