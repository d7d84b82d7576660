"""A texture played under the finger: the reference of the COF where the finger will be.

The COF follows its reference some ticks later. By that time, the preview, the finger is at
``x + (lag + preview) v``: that place of the table is the reference of now. Over time it is the time
that is ahead.

A straight line through its latest positions tells where the finger is, and how fast. The centre of
pressure of a tick is off by 0.24 mm under 1 N. A short memory leaves much of that, and a long one
is late where the finger turns. So the memory grows with the samples, and is short again once they
bend away from the line.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt
from typing import Final, NamedTuple

from smarttac_can.vocabulary.signals import TICK
from smarttac_can.vocabulary.textures import Axis, TextureTable, cof_at

POSITION_LAG: Final = 2.0 * 0.7 / (2.0 * pi * 100.0)
"""By how much in s the measured position is late: the delay ``2 zeta/w0`` of the force path, 100 Hz
and 0.7, an assumption. The filter of the position adds nothing at a steady speed."""
SHORT: Final = 40.0
"""Samples that count while the finger turns."""
LONG: Final = 400.0
"""Most samples that count."""
BEND_SHARE: Final = 0.05
"""Share of a new sample in the bend: its noise is a sixth of that of a sample."""
BENT: Final = 4.0 * sqrt(BEND_SHARE / (2.0 - BEND_SHARE))
"""Bend in standard uncertainties of a sample from which the finger has left the line: four of its
own."""
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


class Line(NamedTuple):
    """The straight line through the latest positions of a touch."""

    position: float
    """Where it is in this tick, in m."""
    speed: float
    """In m/s."""
    samples: float
    """Samples that count."""
    bend: float
    """Filtered distance in m of the samples from where the line expected them."""


def line_from(position: float) -> Line:
    """Return the line of a touch that begins at a measured position in m."""
    return Line(position, 0.0, 1.0, 0.0)


def prolonged(line: Line, position: float, unsure: float) -> Line:
    """Return the line a tick later, with the gains of the least-squares line through its samples.

    Parameters
    ----------
    line
        Of the tick before.
    position
        Measured position in m of this tick.
    unsure
        Its standard uncertainty in m; 0 keeps the memory short.
    """
    before, speed, n, bend = line
    expected = before + TICK * speed
    residual = position - expected
    bend += BEND_SHARE * (residual - bend)
    if n > SHORT and abs(bend) >= BENT * unsure:
        n = SHORT
    elif n < LONG:
        n += 1.0
    square = n * (n + 1.0)
    alpha = (4.0 * n - 2.0) / square
    return Line(expected + alpha * residual, speed + 6.0 / (square * TICK) * residual, n, bend)
