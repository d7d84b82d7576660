"""One source of each frame of the loop: one answer a SYNC, and nobody else's frames."""

from __future__ import annotations

from typing import Final

from smarttac_can.device.collision import GONE_AFTER_US
from smarttac_can.nodes.watching import Watching
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.watchdogs import Watchdog, sync_tolerance, sync_window

BACKLOG: Final = 1000
"""Measurements that may have waited in queues and come late: those of a second."""


class SourceWatch:
    """Grants one answer a SYNC, and trips when there is another source of a frame of the loop.

    Parameters
    ----------
    watching
        The node; its deadline is also how many SYNCs may wait for their measurement.

    Notes
    -----
    A SYNC that the plate has heard and this node has not leaves a measurement more than SYNCs.
    `SyncWatch` lets one less than the deadline pass in its window; so does this, in as many SYNCs.
    """

    def __init__(self, watching: Watching) -> None:
        od, self._clock, self._deadline_ms, self._trip, self._settle = watching
        self._surplus = od["Cycle.Surplus measurements"]
        self._quiet = self._clock.timer(self._on_quiet)
        self._collision = False
        self._owed = 0
        self.restart()

    def restart(self) -> None:
        """Wait for a first SYNC; what waits in queues may come later still."""
        self._credits = self._heard = 0
        self._begin_window()

    def forget(self) -> None:
        """Forget what was noticed."""
        self._quiet.stop()
        self._collision = False
        self._settle(Watchdog.DOUBLE)

    def sync(self) -> None:
        """Take a SYNC that is the tick of the plate: it has one measurement.

        What came while SYNC was lost is no sign of another source, nor is what comes late.
        """
        deadline_ms = self._deadline_ms()
        before, self._heard = self._heard, self._clock.now
        if self._heard - before > deadline_ms * TICK_US:
            self._begin_window()
        self._credits = min(self._credits + 1, deadline_ms)
        self._owed = min(self._owed + 1, BACKLOG)
        self._syncs += 1
        if self._strange > sync_tolerance(deadline_ms):
            self.told()
        if self._syncs >= sync_window(deadline_ms):
            if self._measured == self._syncs:
                self._owed = 0
                self._credits = min(self._credits, 1)
            self._begin_window()

    def may_answer(self) -> bool:
        """Take a measurement, and tell whether it is that of a SYNC; it is counted if not.

        On a bus of sockets it may overtake its SYNC: after a first SYNC one answer may be
        ahead.
        """
        self._measured += 1
        late = self._owed > 0
        if late:
            self._owed -= 1
        if self._credits > 0 or (self._credits == 0 and self._heard):
            self._credits -= 1
            return True
        self._surplus.count()
        if not late:
            self.strange()
        return False

    def strange(self) -> None:
        """Take note of a measurement that is not that of a SYNC, or of no one tick."""
        self._strange += 1

    @property
    def level(self) -> float:
        """How near measurements that are not those of a SYNC are to a fault, of 1.0."""
        return self._strange / (sync_tolerance(self._deadline_ms()) + 1)

    def told(self) -> None:
        """Take note that the plate has noticed another source of its frames."""
        self._quiet.start(GONE_AFTER_US)
        self._trip(Watchdog.DOUBLE)

    def collide(self, heard: bool) -> None:
        """Take note that an identifier of this node is another one's too, or no more."""
        self._collision = heard
        if heard:
            self._trip(Watchdog.DOUBLE)
        elif not self._quiet.running:
            self._settle(Watchdog.DOUBLE)

    def _begin_window(self) -> None:
        self._syncs = self._measured = self._strange = 0

    def _on_quiet(self) -> None:
        if not self._collision:
            self._settle(Watchdog.DOUBLE)
