"""Who commands a stimulator: whether a loss would be noticed, and whether there is one."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from smarttac_can.device.device import Device
from smarttac_can.device.nmt import NMTState
from smarttac_can.nodes.bus_loop import Observe
from smarttac_can.nodes.lock import watched_node
from smarttac_can.nodes.loop_time import deadlines
from smarttac_can.od.cia import GUARD_TIME, HEARTBEAT_CONSUMER, HEARTBEAT_PRODUCER, LIFE_TIME_FACTOR
from smarttac_can.vocabulary.watchdogs import Watchdog

NOT_OPERATIONAL_US: Final = 1_000_000
"""Longest rest of a master outside of OPERATIONAL. One that sets up its own stack passes through
PRE-OPERATIONAL for less, and a bench that is killed is missed as late."""

_UP: Final = -1
SETPOINT_RPDOS: Final = (1, 2, 3, 4)
_TABLE: Final = "Consumer heartbeat time"


class Commander:
    """The watchdogs of heartbeats and set-points, and whether one of them is active.

    A watched node is gone when its heartbeat stays away, at once when it boots again, and when it
    has been OPERATIONAL but is so no more for `NOT_OPERATIONAL_US`. One that never was need not be:
    some masters announce PRE-OPERATIONAL all their life.

    Parameters
    ----------
    device
        That of the stimulator.
    plate
        Node-ID of the plate node, 0 for none. It is no master, and has watchdogs of its own: only
        its silence counts.
    observe
        Called with a watchdog whose fault comes, or goes.
    lockstep
        Whether the master's SYNC is the only clock: nothing happens without the master then.
    """

    def __init__(
        self,
        device: Device,
        plate: int,
        observe: Observe,
        *,
        lockstep: bool,
    ) -> None:
        self._device = device
        self._clock = device.clock
        self._plate = plate
        self._observe = observe
        self._lockstep = lockstep
        self._late: set[int] = set()
        self._gone: set[int] = set()
        self._seen: set[int] = set()
        self._resting: dict[int, int] = {}
        """Since when nodes that were OPERATIONAL are so no more; `_UP` for one that is."""
        od = device.od
        self._watches = [e for s, e in od.objects[HEARTBEAT_CONSUMER].entries.items() if s]
        self._deadlines = deadlines(od, SETPOINT_RPDOS)
        self._guarding = od.entry(GUARD_TIME), od.entry(LIFE_TIME_FACTOR)
        self._heartbeat = od.entry(HEARTBEAT_PRODUCER)

    def restart(self) -> None:
        """Begin anew: nobody was seen yet."""
        self._gone.clear()
        self._seen.clear()
        self._resting.clear()
        self._observe(Watchdog.HEARTBEAT, False)

    def leave(self) -> None:
        """Follow NMT out of OPERATIONAL: deadlines start anew with the first PDO."""
        self._late.clear()
        self._observe(Watchdog.SETPOINT, False)

    def rewatch(self, before: int, after: int) -> None:
        """Follow a write to the heartbeat consumer: another watch is a new one."""
        node_id = watched_node(before)
        if node_id and node_id != watched_node(after):
            self._seen.discard(node_id)
            self._resting.pop(node_id, None)
            self._back(node_id)

    def silent(self, node_id: int, lost: bool) -> None:
        """Record that a node is silent, or heard again; node-ID 0 is life guarding."""
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

    def level(self) -> float:
        """Return the largest share of its time for which a node has left OPERATIONAL, 0..1."""
        now = self._clock.now
        since = [at for at in self._resting.values() if at != _UP]
        return (now - min(since)) / NOT_OPERATIONAL_US if since else 0.0

    def late(self, rpdo: int, late: bool) -> None:
        """Record that the set-points of an RPDO are late, or have come again."""
        if late:
            self._late.add(rpdo)
            self._observe(Watchdog.SETPOINT, True)
            return
        self._late.discard(rpdo)
        if not self._late:
            self._observe(Watchdog.SETPOINT, False)

    def _lose(self, node_id: int) -> None:
        if node_id not in self._gone:
            self._gone.add(node_id)
            self._observe(Watchdog.HEARTBEAT, True)

    def _back(self, node_id: int) -> None:
        self._gone.discard(node_id)
        if not self._gone:
            self._observe(Watchdog.HEARTBEAT, False)

    @property
    def kept(self) -> bool:
        """Whether the loss of the commander would be noticed."""
        device = self._device
        return (
            self._lockstep
            or device.guarded
            or bool(device.watched_in_time - {self._plate})
            or any(device.in_time(number) for number in SETPOINT_RPDOS)
        )

    def advice(self) -> str:
        """Say what the watches wait for that are set, or how to set one."""
        return ", or ".join(self._set_but_silent()) or (
            f"enter your heartbeat in {_TABLE} and send it, or set Drive unwatched to 1"
        )

    def _set_but_silent(self) -> Iterator[str]:
        """Yield what each watch waits for that is set: its first sign of life."""
        nodes = [watched_node(entry.value) for entry in self._watches]
        if masters := [f"{node}" for node in nodes if node not in (0, self._plate)]:
            which = " or ".join(masters)
            full = all(entry.value for entry in self._watches)
            taken = "; its entries are all taken: write 0 to one for another" if full else ""
            silent = f"entered in {_TABLE} but not heard yet{taken}"
            yield f"send the heartbeat of node {which}, {silent}"
        for number, deadline in zip(SETPOINT_RPDOS, self._deadlines, strict=True):
            if deadline.value:
                yield f"send RPDO {number}, which has a deadline but has not come yet"
        if all(entry.value for entry in self._guarding):
            if self._heartbeat.value:
                yield "set Producer heartbeat time to 0: life guarding rests beside a heartbeat"
            else:
                yield "guard this node: its life time is set, but no remote frame has come yet"
