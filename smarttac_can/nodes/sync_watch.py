"""The watchdogs of SYNC where it is the tick of the loop: lost, irregular, counter jumped."""

from __future__ import annotations

from collections.abc import Callable

from smarttac_can.device.timer import Clock
from smarttac_can.nodes.watching import Watching
from smarttac_can.od.cia import SYNC_COUNTER
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.watchdogs import (
    SYNC_DRIFT_WINDOW,
    Watchdog,
    sync_drift_tolerance,
    sync_tolerance,
    sync_window,
)


class _Window:
    """SYNCs that come in a stretch of device time.

    Parameters
    ----------
    clock
        Device time.
    judge
        Called at its end with how many SYNCs came, and how many should have.
    tolerance
        Returns for a deadline how many too many or too few are no fault.

    Attributes
    ----------
    count
        How many came.
    deadline_ms
        Deadline of the loop when it began: another one is for the next.
    """

    def __init__(
        self,
        clock: Clock,
        judge: Callable[[int, int], None],
        tolerance: Callable[[int], int],
    ) -> None:
        self._clock = clock
        self._tolerance = tolerance
        self._judge = judge
        self._timer = clock.timer(self._end)
        self.count = self.deadline_ms = 0
        self._begun = 0

    @property
    def open(self) -> bool:
        """Whether it counts."""
        return self._timer.running

    def begin(self, periods: int, deadline_ms: int) -> None:
        """Count anew for so many periods."""
        self.count = 0
        self.deadline_ms = deadline_ms
        self._begun = self._clock.now
        self._timer.start(periods * TICK_US)

    def level(self, ahead: int) -> float:
        """How near to a fault, 1.0, too many or too few are if it ends ``ahead`` us from now."""
        if not self.open:
            return 0.0
        off = self.count - (self._clock.now + ahead - self._begun) // TICK_US
        return abs(off) / (self._tolerance(self.deadline_ms) + 1) if off else 0.0

    def stop(self) -> None:
        """Count no more."""
        self._timer.stop()
        self.count = 0

    def _end(self) -> None:
        self._judge(self.count, (self._clock.now - self._begun) // TICK_US)


class SyncWatch:
    """Compares SYNC with device time, from the first SYNC on.

    Parameters
    ----------
    watching
        The node.
    """

    def __init__(self, watching: Watching) -> None:
        od, clock, self._deadline_ms, self._trip, self._settle = watching
        self._clock = clock
        self._overflow = od.entry(SYNC_COUNTER)
        self._silence = clock.timer(self._on_silence)
        self._window = _Window(clock, self._judge, sync_tolerance)
        self._long = _Window(clock, self._judge_drift, sync_drift_tolerance)
        self.restart()

    def restart(self) -> None:
        """Wait for a first SYNC."""
        self._silence.stop()
        self._window.stop()
        self._long.stop()
        self._counter = 0
        self._drifts = False
        self._settle(Watchdog.SYNC_LOST)
        self._settle(Watchdog.SYNC_IRREGULAR)

    def produced(self) -> None:
        """Watch nobody: the node has taken over SYNC."""
        if self._window.open:
            self.restart()

    def heard(self, counter: int) -> None:
        """Take a SYNC of another node with its counter, 0 where it has none."""
        deadline_ms = self._deadline_ms()
        window = self._window
        if not window.open:
            window.begin(sync_window(deadline_ms), deadline_ms)
        if not self._long.open:
            self._long.begin(SYNC_DRIFT_WINDOW, deadline_ms)
        window.count += 1
        self._long.count += 1
        most = sync_window(window.deadline_ms) + sync_tolerance(window.deadline_ms)
        if window.count > most:
            # At once, also where device time stands still and no window ends.
            self._irregular()
        self._silence.start(deadline_ms * TICK_US)
        self._settle(Watchdog.SYNC_LOST)
        before, self._counter = self._counter, counter
        if before and counter and counter != before % self._overflow.value + 1:
            self._trip(Watchdog.SYNC_COUNTER)

    def levels(self, ahead: int) -> tuple[float, float]:
        """How near to a fault, 1.0, silence and irregularity of SYNC are ``ahead`` us from now."""
        silence = self._clock.share((self._silence,), ahead)
        return silence, max(self._window.level(ahead), self._long.level(ahead))

    def _on_silence(self) -> None:
        self._forget_drift()
        self._trip(Watchdog.SYNC_LOST)

    def _irregular(self) -> None:
        self._forget_drift()
        self._trip(Watchdog.SYNC_IRREGULAR)

    def _forget_drift(self) -> None:
        """Count anew: what is lost or comes at once is no matter of the clock."""
        self._long.stop()
        self._drifts = False

    def _judge(self, count: int, periods: int) -> None:
        if abs(count - periods) > sync_tolerance(self._window.deadline_ms):
            self._irregular()
        elif not self._drifts:
            self._settle(Watchdog.SYNC_IRREGULAR)
        deadline_ms = self._deadline_ms()
        self._window.begin(sync_window(deadline_ms), deadline_ms)

    def _judge_drift(self, count: int, periods: int) -> None:
        self._drifts = abs(count - periods) > sync_drift_tolerance(self._long.deadline_ms)
        if self._drifts:
            self._trip(Watchdog.SYNC_IRREGULAR)
        self._long.begin(SYNC_DRIFT_WINDOW, self._deadline_ms())
