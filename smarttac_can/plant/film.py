"""Vibration that acts on the finger: the mode shape at its position, and the lag of the film.

The amplitude at the finger follows ``shape |W|`` with the lag of the squeeze film. The step is
exact for a vibration that is a ramp during it.
"""

from __future__ import annotations

import math

from smarttac_can.plant.parameters import TWO_PI


def shape_at(x: float, ripple: float, node_distance: float) -> float:
    """Return ``1 + ripple cos(2 pi x/node_distance)`` at x in m from the middle of the plate.

    It is the ratio of the amplitude at the finger, averaged over the contact, to that at the
    pick-up.
    """
    return 1.0 + ripple * math.cos(TWO_PI * x / node_distance)


def film_share(duration: float, lag: float) -> float:
    """Return the fraction of its distance that the film covers in a step, both times in s."""
    return -math.expm1(-duration / lag) if lag else 1.0


def film(before: float, start: float, end: float, lag_steps: float, share: float) -> float:
    """Return the amplitude in m that acts on the skin after a step.

    Parameters
    ----------
    before
        The same before the step.
    start, end
        Amplitude at the finger's place without a film in m, before and after the step.
    lag_steps
        Lag of the film over the length of the step.
    share
        Of `film_share`.
    """
    late = lag_steps * (end - start)
    return end - late + (before - start + late) * (1.0 - share)
