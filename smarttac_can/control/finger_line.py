"""Where a finger is and how fast, by a line whose memory grows while the finger keeps to it.

The centre of pressure of a tick is off by 0.24 mm under 1 N. A short memory leaves much of that, a
long one is late where the finger turns; so the memory grows with the samples, and is short again
once they bend away from the line.
"""

from __future__ import annotations

from math import sqrt
from typing import Final, NamedTuple

from smarttac_can.vocabulary.signals import TICK

SHORT: Final = 40.0
"""Samples that count while the finger turns."""
LONG: Final = 400.0
"""Most samples that count."""
BEND_SHARE: Final = 0.05
"""Share of a new sample in the bend: its noise is a sixth of that of a sample."""
BENT: Final = 4.0 * sqrt(BEND_SHARE / (2.0 - BEND_SHARE))
"""Bend in standard uncertainties of a sample from which the finger has left the line: four of its
own."""


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
