"""SYNC as the tick of the loop: its period is 1 ms, or there is no loop."""

from __future__ import annotations

from typing import Final

from smarttac_can.device.device import Device
from smarttac_can.od.cia import SYNC_PERIOD, EmergencyCode, ErrorRegister

TICK_US: Final = 1000
"""Period of the loop in us."""


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
        """Whether the loop may run; called in every cycle."""
        if self._entry.value == TICK_US:
            if self._reported:
                self._reported = False
                self._device.clear_emergency(EmergencyCode.DATA_SET)
            return True
        if not self._reported:
            self._reported = True
            self._device.emergency(EmergencyCode.DATA_SET, ErrorRegister.GENERIC)
        return False
