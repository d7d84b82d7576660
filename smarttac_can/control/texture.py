"""A texture played under the finger: the reference of the COF where the finger will be.

The COF follows its reference some ticks later. By that time, the preview, the finger is at
``x + (lag + preview) v``: that place of the table is the reference of now. Over time it is the time
that is ahead.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Final, NamedTuple

from smarttac_can.vocabulary.signals import TICK
from smarttac_can.vocabulary.textures import Axis, TextureTable, cof_at

POSITION_LAG: Final = 2.0 * 0.7 / (2.0 * pi * 100.0)
"""By how much in s the measured position is late: the delay ``2 zeta/w0`` of the force path, 100 Hz
and 0.7, an assumption. The filter of the position adds nothing at a steady speed."""
_NM_PER_M: Final = 1e9
_US_PER_S: Final = 1e6


class Texture(NamedTuple):
    """A table as the controllers play it."""

    by_position: bool
    repeats: bool
    start: int
    step: int
    values: Sequence[float]
    """COF in 1e-4; none for no texture."""


NO_TEXTURE: Final = Texture(True, False, 0, 1, ())


def texture_of(table: TextureTable) -> Texture:
    """Return a table as it is played."""
    return Texture(
        table.axis is Axis.POSITION, table.repeats, table.start, table.step, table.values
    )


def cof_ahead(texture: Texture, ticks: int, position: float, speed: float, preview: float) -> float:
    """Return the reference of the COF in a tick.

    Parameters
    ----------
    texture
        What is played.
    ticks
        Ticks since it began, for a table over time.
    position, speed
        Of the finger in m and m/s, for a table over the position.
    preview
        Time in s that the COF takes to follow its reference.
    """
    by_position, repeats, start, step, values = texture
    if by_position:
        place = (position + (POSITION_LAG + preview) * speed) * _NM_PER_M
    else:
        place = (ticks * TICK + preview) * _US_PER_S
    return cof_at(values, repeats, start, step, place)
