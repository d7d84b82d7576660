"""The drive as it leaves the stimulator."""

from __future__ import annotations

from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.scaling import Quantiser
from smarttac_can.vocabulary.signals import Drive


class DriveOutput:
    """The drive that stands in the object dictionary.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._voltage = od["Drive.Voltage"]
        self._tick = od["Drive.Tick"]
        self._quantiser = Quantiser([self._voltage, od["Drive.Frequency"]])

    def write(self, drive: Drive, tick: int) -> None:
        """Write voltage and frequency, and the tick that they answer."""
        self._quantiser.write(drive)
        self._tick.value = tick

    def switch_off(self) -> None:
        """Write 0 V, whatever tick it answers."""
        self._voltage.value = 0
