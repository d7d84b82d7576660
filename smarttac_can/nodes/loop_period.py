"""SYNC as the tick of the loop: its period is 1 ms, or there is no loop."""

from __future__ import annotations

from collections.abc import Sequence

from smarttac_can.device.device import Device
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


def set_deadline(od: ObjectDictionary, rpdos: tuple[int, ...], milliseconds: int) -> None:
    """Have the event timers of RPDOs begin with another default than that of the EDS.

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


def shortest_ms(deadlines: Sequence[Entry]) -> int:
    """Return the shortest of one or more deadlines, in ms."""
    return int(min([entry.value for entry in deadlines]))


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
        """Tell whether the loop may run; called in every cycle."""
        if self._entry.value == TICK_US:
            if self._reported:
                self._reported = False
                self._device.clear_emergency(EmergencyCode.DATA_SET)
            return True
        if not self._reported:
            self._reported = True
            self._device.emergency(EmergencyCode.DATA_SET, ErrorRegister.GENERIC)
        return False
