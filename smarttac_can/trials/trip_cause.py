"""Whether the plate itself gave a watch of the vibration cause to trip."""

from __future__ import annotations

from collections import deque
from typing import Final, Protocol

from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.plant.parameters import SensorParameters
from smarttac_can.vocabulary.watchdogs import FORGOTTEN, Watchdog

_NOISE_M: Final = 10e-9
"""What a pick-up may read too much, in m: ten times its noise."""


class Driven(Protocol):
    """A stimulator with its plate, such as a `Rig`."""

    plate_block: PlateBlock
    od: ObjectDictionary
    """Of the stimulator."""
    cycles: int
    """How many there were."""


class TripCause:
    """The last cycles in which the true vibration was too large, for its limit or its pick-up.

    A watch trips after n faulty cycles in a row, or more that are spread: of the last 20 n cycles
    at least n are faulty then.

    Parameters
    ----------
    rig
        Its plate is looked at, not what its pick-up reads.
    """

    def __init__(self, rig: Driven) -> None:
        self._rig = rig
        self._block = rig.plate_block
        self._trip = rig.od["Limit.Amplitude trip"]
        sensors = SensorParameters()
        self._end = sensors.full_scale * sensors.pickup_resolution - _NOISE_M
        self._above: deque[int] = deque(maxlen=5)
        self._beyond: deque[int] = deque(maxlen=2)

    def look(self) -> None:
        """Look at a cycle."""
        W = self._block.plate.W
        trip = self._trip
        if abs(W) > trip.value * trip.si - _NOISE_M:
            self._above.append(self._rig.cycles)
            if max(abs(W.real), abs(W.imag)) > self._end:
                self._beyond.append(self._rig.cycles)

    def of(self, latched: int) -> str | None:
        """Return the cause of a trip in this cycle, None if one that is latched has none.

        Parameters
        ----------
        latched
            Watchdogs that have tripped, as bits.
        """
        causes = {
            1 << Watchdog.AMPLITUDE: ("vibration above its limit", self._above),
            1 << Watchdog.SATURATED: ("vibration beyond the range of its pick-up", self._beyond),
        }
        shown = [
            (bit, text) for bit, (text, cycles) in causes.items()
            if latched & bit and self._lasted(cycles)
        ]  # fmt: skip
        if not latched or latched != sum(bit for bit, _ in shown):
            return None
        return ", ".join(text for _, text in shown)

    def _lasted(self, cycles: deque[int]) -> bool:
        most = cycles.maxlen or 0
        return len(cycles) == most and self._rig.cycles - cycles[0] < FORGOTTEN * most
