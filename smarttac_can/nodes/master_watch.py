"""Who watches over a run from outside: nodes whose heartbeat is watched, and set-points in time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from smarttac_can.device.nmt import NMTState
from smarttac_can.device.timer import Clock
from smarttac_can.nodes.stricter import watched_node
from smarttac_can.vocabulary.watchdogs import Watchdog

NOT_OPERATIONAL_US: Final = 1_000_000
"""Longest rest of a master outside of OPERATIONAL. One that sets up its own stack passes through
PRE-OPERATIONAL for less, and a bench that is killed is missed as late."""

_UP: Final = -1


class MasterWatch:
    """The watchdogs of heartbeats and set-points.

    A watched node is gone when its heartbeat stays away, at once when it boots again, and when it
    has been OPERATIONAL but is so no more for `NOT_OPERATIONAL_US`. One that never was need not be:
    some masters announce PRE-OPERATIONAL all their life.

    Parameters
    ----------
    clock
        Device time.
    plate
        Node-ID of the plate node, 0 for none. It is no master, and has watchdogs of its own: only
        its silence counts.
    trip, settle
        Called with a watchdog whose fault comes or goes.
    """

    def __init__(
        self,
        clock: Clock,
        plate: int,
        trip: Callable[[Watchdog], None],
        settle: Callable[[Watchdog], None],
    ) -> None:
        self._clock = clock
        self._plate = plate
        self._trip = trip
        self._settle = settle
        self._late: set[int] = set()
        self._gone: set[int] = set()
        self._seen: set[int] = set()
        self._resting: dict[int, int] = {}
        """Since when nodes that were OPERATIONAL are so no more; `_UP` for one that is."""

    def restart(self) -> None:
        """Begin anew: nobody was seen yet."""
        self._gone.clear()
        self._seen.clear()
        self._resting.clear()
        self._settle(Watchdog.HEARTBEAT)

    def leave(self) -> None:
        """Follow NMT out of OPERATIONAL: deadlines start anew with the first PDO."""
        self._late.clear()
        self._settle(Watchdog.SETPOINT)

    def rewatch(self, before: int, after: int) -> None:
        """Follow a write to the heartbeat consumer: another watch is a new one."""
        node_id = watched_node(before)
        if node_id and node_id != watched_node(after):
            self._seen.discard(node_id)
            self._resting.pop(node_id, None)
            self._back(node_id)

    def silent(self, node_id: int, lost: bool) -> None:
        """Take note that a node is heard no more, or again; node-ID 0 is life guarding."""
        if lost:
            self._lose(node_id)
        else:
            self._back(node_id)

    def heard(self, node_id: int, state: int) -> None:
        """Take a heartbeat, or the boot-up message, of a watched node."""
        if node_id == self._plate:
            return
        if state == NMTState.INITIALISING:
            self._resting.pop(node_id, None)
            if node_id in self._seen:
                self._lose(node_id)
            return
        self._seen.add(node_id)
        if state == NMTState.OPERATIONAL:
            self._resting[node_id] = _UP
        elif node_id in self._resting:
            since = self._resting[node_id]
            if since == _UP:
                self._resting[node_id] = self._clock.now
            elif self._clock.now - since >= NOT_OPERATIONAL_US:
                self._lose(node_id)
            return
        self._back(node_id)

    def rest(self) -> float:
        """Largest share of its time that a node which was OPERATIONAL is so no more."""
        now = self._clock.now
        since = [at for at in self._resting.values() if at != _UP]
        return (now - min(since)) / NOT_OPERATIONAL_US if since else 0.0

    def late(self, rpdo: int, late: bool) -> None:
        """Take note that set-points are late, or late no more."""
        if late:
            self._late.add(rpdo)
            self._trip(Watchdog.SETPOINT)
            return
        self._late.discard(rpdo)
        if not self._late:
            self._settle(Watchdog.SETPOINT)

    def _lose(self, node_id: int) -> None:
        if node_id not in self._gone:
            self._gone.add(node_id)
            self._trip(Watchdog.HEARTBEAT)

    def _back(self, node_id: int) -> None:
        self._gone.discard(node_id)
        if not self._gone:
            self._settle(Watchdog.HEARTBEAT)
