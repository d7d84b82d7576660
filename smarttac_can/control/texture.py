"""A texture played under the finger: the reference of the COF where the finger will be."""

from __future__ import annotations

from math import pi
from typing import Final

from smarttac_can.vocabulary.signals import TICK
from smarttac_can.vocabulary.textures import Axis, TextureTable

POSITION_LAG: Final = 2.0 * 0.7 / (2.0 * pi * 100.0)
"""By how much in s the measured position is late: the delay ``2 zeta/w0`` of the force path, 100 Hz
and 0.7, an assumption. The filter of the position adds nothing at a steady speed."""
_NM_PER_M: Final = 1e9
_US_PER_S: Final = 1e6


class TexturePlayer:
    """Plays one table.

    The COF follows its reference some ticks later. By that time, the preview, the finger is at
    ``x + (lag + preview) v``: that place of the table is the reference of now. Over time it is the
    time that is ahead.

    Parameters
    ----------
    table
        What to play.
    """

    __slots__ = ("_by_position", "_table", "_ticks")

    def __init__(self, table: TextureTable) -> None:
        self._table = table
        self._by_position = table.axis is Axis.POSITION
        self._ticks = 0

    def start(self) -> None:
        """Have a table over time begin with the next tick."""
        self._ticks = 0

    def reference(self, position: float, speed: float, preview: float) -> float:
        """Return the reference of the COF; to be called once a tick.

        Parameters
        ----------
        position, speed
            Of the finger in m and m/s.
        preview
            Time in s that the COF takes to follow its reference.
        """
        if self._by_position:
            ahead = position + (POSITION_LAG + preview) * speed
            return self._table.at(ahead * _NM_PER_M)
        time = self._ticks * TICK
        self._ticks += 1
        return self._table.at((time + preview) * _US_PER_S)
