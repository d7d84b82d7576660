"""Levels of steady vibration within a pass, from pairs of which the friction map is learned.

The functions are plain ones of floats and named tuples; amplitudes are in m.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from smarttac_can.control.friction_map import Plateau

LEVEL_TICKS: Final = 20
"""Ticks that make a level."""
LEVEL_SPREAD: Final = 0.1e-6
"""Distance in m of an amplitude to the mean so far with which a level begins anew."""
LEVEL_DRIFT: Final = 0.03
"""The same of m0: a finger that stops makes no level, though the amplitude rests at 0."""
PAIR_MIN: Final = 0.05
"""Difference of ln mu_ref from which two levels make a pair: a smaller one is noise that the loop
has followed, from which it would learn itself."""
PAIR_MIN_W: Final = 0.05e-6
"""The same of their amplitudes in m."""


class Gathered(NamedTuple):
    """The levels of a pass."""

    ticks: int
    """Of the level that is being made, as the sums."""
    sum_ln: float
    sum_W: float
    sum_m0: float
    made: int
    """Levels that were made."""
    last: Plateau


NOTHING: Final = Gathered(0, 0.0, 0.0, 0.0, 0, Plateau(0.0, 0.0, 0.0))


def interrupted(so_far: Gathered, turned: bool) -> Gathered:
    """Return the levels once a step, or a turn, has ended the one that was being made."""
    return Gathered(0, 0.0, 0.0, 0.0, 0 if turned else so_far.made, so_far.last)


def gathered(so_far: Gathered, ln_mu: float, W: float, ln_ref: float, m0: float) -> Gathered:
    """Return the levels with a tick more.

    Parameters
    ----------
    so_far
        After the tick before.
    ln_mu, W
        Measured.
    ln_ref
        Logarithm of the reference of the COF.
    m0
        ln mu without vibration, as it is believed.
    """
    ticks, sum_ln, sum_W, sum_m0, made, last = so_far
    moved = abs(ticks * W - sum_W) > ticks * LEVEL_SPREAD
    if moved or abs(ticks * m0 - sum_m0) > ticks * LEVEL_DRIFT:
        ticks, sum_ln, sum_W, sum_m0 = 0, 0.0, 0.0, 0.0
    ticks, sum_ln, sum_W, sum_m0 = ticks + 1, sum_ln + ln_mu, sum_W + W, sum_m0 + m0
    if ticks < LEVEL_TICKS:
        return Gathered(ticks, sum_ln, sum_W, sum_m0, made, last)
    return Gathered(0, 0.0, 0.0, 0.0, made + 1, Plateau(sum_ln / ticks, sum_W / ticks, ln_ref))


def tells(before: Plateau, after: Plateau) -> bool:
    """Tell whether two levels differ because they were asked to."""
    asked = abs(after.ln_ref - before.ln_ref) > PAIR_MIN
    return asked and abs(after.W - before.W) > PAIR_MIN_W
