"""Whether who arms would be missed, and what to do where nobody would be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from smarttac_can.device.device import Device
from smarttac_can.nodes.loop_period import deadlines
from smarttac_can.nodes.stricter import watched_node
from smarttac_can.od.cia import GUARD_TIME, HEARTBEAT_CONSUMER, HEARTBEAT_PRODUCER, LIFE_TIME_FACTOR

SETPOINT_RPDOS: Final = (1, 2, 3, 4)
_TABLE: Final = "Consumer heartbeat time"


class ArmingWatch:
    """The watches over who drives, as they are kept now.

    Parameters
    ----------
    device
        Device of the stimulator.
    plate
        Node-ID of the plate node, 0 for none: it is no master.
    lockstep
        Whether the master's SYNC is the only clock: nothing happens without the master then.
    """

    def __init__(self, device: Device, plate: int, lockstep: bool) -> None:
        self._device = device
        self._plate = plate
        self._lockstep = lockstep
        od = device.od
        self._watches = [e for s, e in od.objects[HEARTBEAT_CONSUMER].entries.items() if s]
        self._deadlines = deadlines(od, SETPOINT_RPDOS)
        self._guarding = od.entry(GUARD_TIME), od.entry(LIFE_TIME_FACTOR)
        self._heartbeat = od.entry(HEARTBEAT_PRODUCER)

    @property
    def kept(self) -> bool:
        """Whether who drives would be missed."""
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
