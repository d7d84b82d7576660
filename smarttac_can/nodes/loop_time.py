"""Time of the loop: its tick is 1 ms, its deadline an event timer, and ticks may go by unused."""

from __future__ import annotations

from typing import Final

from smarttac_can.device.device import Device
from smarttac_can.device.port import Clock
from smarttac_can.od.cia import (
    PDO_EVENT,
    RPDO_COMMUNICATION,
    SYNC_PERIOD,
    EmergencyCode,
    ErrorRegister,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.signals import TICK_US
from smarttac_can.vocabulary.watchdogs import sync_tolerance, sync_window

TICKS: Final = 1000
"""Ticks over which they are counted: a second."""
_IDLE: Final = -1
_STANDSTILL: Final = 3
"""Ticks without a sign of life from which on a node did not run: a slow cycle takes 1 to 2."""
_MOSTLY: Final = 0.5
_PAUSES: Final = (
    "start the node with --realtime, end other programs, or take a computer that is not shared"
)
_SLOW: Final = (
    "cycles take too long or the plate answers late: end other programs, or take a faster computer"
)


def set_deadline(od: ObjectDictionary, rpdos: tuple[int, ...], milliseconds: int) -> None:
    """Set another default of the event timers of RPDOs than that of the EDS.

    Parameters
    ----------
    od
        Object dictionary of a node that was not started yet.
    rpdos
        Numbers of the RPDOs of its loop.
    milliseconds
        Within the limits of the entries.
    """
    for entry in deadlines(od, rpdos):
        entry.check(milliseconds)
        entry.default = entry.value = milliseconds


def deadlines(od: ObjectDictionary, rpdos: tuple[int, ...]) -> list[Entry]:
    """Return the event timers, in ms, of RPDOs."""
    return [od.entry(RPDO_COMMUNICATION + rpdo - 1, PDO_EVENT) for rpdo in rpdos]


class Deadline:
    """How long a loop may be without what is to come every tick.

    Parameters
    ----------
    od
        Object dictionary of the node.
    rpdos
        Numbers of the RPDOs whose shortest event timer it is.

    Attributes
    ----------
    ms
        In ms, as of the last `configure`.
    window
        Periods over which SYNCs are counted under it.
    tolerance
        How many SYNCs, or measurements, too many or too few are then no fault.
    """

    __slots__ = ("_entries", "ms", "tolerance", "window")

    def __init__(self, od: ObjectDictionary, rpdos: tuple[int, ...]) -> None:
        self._entries = deadlines(od, rpdos)
        self.configure()

    def configure(self) -> None:
        """Read the event timers; for when parameters have changed."""
        self.ms = int(min([entry.value for entry in self._entries]))
        self.window = sync_window(self.ms)
        self.tolerance = sync_tolerance(self.ms)

    def with_write(self, entry: Entry, value: int) -> int | None:
        """Return what it would be in ms after a write; None if the entry is none of its own."""
        if entry not in self._entries:
            return None
        return min(value, *(int(other.value) for other in self._entries if other is not entry))


class LoopPeriod:
    """Guard of a loop over the bus, whose tick is the public SYNC.

    Parameters
    ----------
    device
        Reports the emergency 6300h while its communication cycle period is not 1000 us.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._entry = device.od.entry(SYNC_PERIOD)
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
    """Compares cycles with device time.

    A cycle that comes late is none that is missed; one that never comes is.

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
        """Begin with the next cycle."""
        self._begun = _IDLE
        self._cycles = self._stood = 0
        self._summary = ""

    def awake(self) -> None:
        """Take a sign of life: the node runs, whether or not it has a cycle."""
        now = self._clock.now
        gap = (now - self._awake) // TICK_US
        if gap >= _STANDSTILL:
            self._stood += gap - 1
        self._awake = now

    def summary(self) -> str:
        """Return what the last whole second missed, why, and what helps; empty before one."""
        return self._summary

    @property
    def missed(self) -> int:
        """Ticks of this second that were missed so far."""
        if self._begun == _IDLE:
            return 0
        return max(0, (self._clock.now - self._begun) // TICK_US - self._cycles)

    def cycle(self) -> int:
        """Take a cycle; return how many ticks were missed if a second ends with it, else 0."""
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
