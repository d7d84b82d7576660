"""Textures under the finger: the COF reference at the position where the finger will be.

The COF follows its reference after some ticks, the preview. The finger is then at
``x + (lag + preview) v``, so the value at this position is the present reference. A table over time
is read ahead in time.

A straight line through the latest positions gives position and speed of the finger. The centre of
pressure of one tick has an error of 0.24 mm under 1 N. A short memory averages little of it, and a
long one is late at a turn. So the memory grows with the samples, and becomes short again when they
deviate from the line.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt
from typing import Final, NamedTuple

from smarttac_can.vocabulary.signals import TICK
from smarttac_can.vocabulary.textures import Axis, TextureTable, cof_at

POSITION_LAG: Final = 2.0 * 0.7 / (2.0 * pi * 100.0)
"""Delay of the measured position in s: ``2 zeta/w0`` of the force path, with 100 Hz and 0.7, an
assumption. The filter of the position adds no delay at a steady speed."""
SHORT: Final = 40.0
"""Memory in samples while the finger turns."""
LONG: Final = 400.0
"""Longest memory in samples."""
BEND_SHARE: Final = 0.05
"""Filter factor of the bend per sample; its noise is a sixth of that of a sample."""
BENT: Final = 4.0 * sqrt(BEND_SHARE / (2.0 - BEND_SHARE))
"""Bend above which the finger has left the line, in uncertainties of a sample: 4 of its own."""
_NM_PER_M: Final = 1e9
_US_PER_S: Final = 1e6


class Texture(NamedTuple):
    """A table as used by the controllers."""

    by_position: bool
    repeats: bool
    start: int
    step: int
    values: Sequence[float]
    """COF in 1e-4; empty for no texture."""


NO_TEXTURE: Final = Texture(True, False, 0, 1, ())


def texture_of(table: TextureTable) -> Texture:
    """Return a table in the form used by the controllers."""
    return Texture(
        table.axis is Axis.POSITION, table.repeats, table.start, table.step, table.values
    )


def cof_ahead(texture: Texture, ticks: int, position: float, speed: float, preview: float) -> float:
    """Return the reference of the COF in a tick.

    Parameters
    ----------
    texture
        Texture to play.
    ticks
        Ticks since its start, for a table over time.
    position, speed
        Position and speed of the finger in m and m/s, for a table over the position.
    preview
        Delay of the COF behind its reference in s.
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
    """Position in this tick in m."""
    speed: float
    """Speed in m/s."""
    samples: float
    """Memory in samples."""
    bend: float
    """Filtered distance in m between the samples and the line's prediction."""


def line_from(position: float) -> Line:
    """Return the line at the start of a touch, at a measured position in m."""
    return Line(position, 0.0, 1.0, 0.0)


def prolonged(line: Line, position: float, unsure: float) -> Line:
    """Return the line a tick later, with the gains of the least-squares line through its samples.

    Parameters
    ----------
    line
        Line of the tick before.
    position
        Measured position in m of this tick.
    unsure
        Standard uncertainty of the position in m; 0 keeps the memory short.
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
