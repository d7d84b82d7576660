"""Timing of the loop: its tick of 1 ms, its deadline from event timers, and missed ticks."""

from __future__ import annotations

from typing import Any, Final

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.port import Clock
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import EmergencyCode, ErrorRegister
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.watchdogs import sync_tolerance, sync_window

TICKS: Final = 1000
"""Ticks over which missed ticks are counted: 1 s."""
_IDLE: Final = -1
_STANDSTILL: Final = 3
"""Ticks without activity from which on the node stood still. A slow cycle takes 1 to 2."""
_MOSTLY: Final = 0.5
_PAUSES: Final = (
    "start the node with --realtime, end other programs, or take a computer that is not shared"
)
_SLOW: Final = (
    "cycles take too long or the plate answers late: end other programs, or take a faster computer"
)


def set_deadline(od: ObjectDictionary, rpdos: tuple[int, ...], milliseconds: int) -> None:
    """Set the default of the event timers of RPDOs in place of the default of the EDS.

    Parameters
    ----------
    od
        Object dictionary of a node that is not started yet.
    rpdos
        Numbers of the RPDOs of the loop.
    milliseconds
        Time in ms, within the limits of the entries.
    """
    for entry in deadlines(od, rpdos):
        entry.check(milliseconds)
        entry.default = entry.value = milliseconds


def deadlines(od: ObjectDictionary, rpdos: tuple[int, ...]) -> list[Entry]:
    """Return the event timers, in ms, of RPDOs."""
    return [od.entry(cia.RPDO_COMMUNICATION + rpdo - 1, cia.PDO_EVENT) for rpdo in rpdos]


class Deadline:
    """Longest time that a loop may be without the data of a tick.

    Parameters
    ----------
    od
        Object dictionary of the node.
    rpdos
        Numbers of the RPDOs. The shortest of their event timers is the deadline.

    Attributes
    ----------
    ms
        Deadline in ms, as of the last `configure`.
    window
        Number of periods over which SYNCs are counted with this deadline.
    tolerance
        Number of SYNCs, or of measurements, too many or too few that is no fault with this
        deadline.
    """

    __slots__ = ("_entries", "ms", "tolerance", "window")

    def __init__(self, od: ObjectDictionary, rpdos: tuple[int, ...]) -> None:
        self._entries = deadlines(od, rpdos)
        self.configure()

    def configure(self) -> None:
        """Read the event timers; called after parameters have changed."""
        self.ms = int(min([entry.value for entry in self._entries]))
        self.window = sync_window(self.ms)
        self.tolerance = sync_tolerance(self.ms)

    def with_write(self, entry: Entry, value: Any) -> int | None:
        """Return the deadline in ms after a write; None if the entry is not one of its timers."""
        if entry not in self._entries:
            return None
        return min(int(value), *(int(other.value) for other in self._entries if other is not entry))


class LoopPeriod:
    """Check that the communication cycle period of SYNC, the tick of the loop, is 1000 us.

    Parameters
    ----------
    device
        Device of the node. It sends the emergency 6300h while the period is another one.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._entry = device.od.entry(cia.SYNC_PERIOD)
        self._reported = False

    def agrees(self) -> bool:
        """Return whether the loop may run; called in every cycle."""
        if self._entry.value == TICK_US:
            if self._reported:
                self._reported = False
                self._device.clear_emergency(EmergencyCode.DATA_SET)
            return True
        if not self._reported:
            self._reported = True
            self._device.emergency(EmergencyCode.DATA_SET, ErrorRegister.GENERIC)
        return False


class MissedTime:
    """Count the ticks without a cycle, by comparing cycles with device time.

    A late cycle is not missed; a cycle that never takes place is.

    Parameters
    ----------
    clock
        Device time.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._awake = clock.now
        self.restart()

    def restart(self) -> None:
        """Restart the count with the next cycle."""
        self._begun = _IDLE
        self._cycles = self._stood = 0
        self._summary = ""

    def awake(self) -> None:
        """Record that the node is active, with or without a cycle."""
        now = self._clock.now
        gap = (now - self._awake) // TICK_US
        if gap >= _STANDSTILL:
            self._stood += gap - 1
        self._awake = now

    def summary(self) -> str:
        """Return how many ticks the last full second missed, why, and what to do; empty if none."""
        return self._summary

    @property
    def missed(self) -> int:
        """Ticks that were missed so far in this second."""
        if self._begun == _IDLE:
            return 0
        return max(0, (self._clock.now - self._begun) // TICK_US - self._cycles)

    def cycle(self) -> int:
        """Take a cycle; return the number of missed ticks if it ends a second, else 0."""
        now = self._clock.now
        if self._begun == _IDLE:
            self._begun = self._awake = now
            return 0
        self.awake()
        self._cycles += 1
        ticks = (now - self._begun) // TICK_US
        if ticks < TICKS:
            return 0
        missed = max(0, ticks - self._cycles)
        if missed:
            stood = min(self._stood, missed)
            cure = _PAUSES if stood > _MOSTLY * missed else _SLOW
            self._summary = (
                f"{missed} of {ticks} ticks missed, {stood} of them while the machine stood still "
                f"or gave this process no time; {cure}"
            )
        self._begun += ticks * TICK_US
        self._cycles = self._stood = 0
        return missed
