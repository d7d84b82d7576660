"""What the finger feels of the vibration: the mode's shape where it is, and the lag of the film."""

from __future__ import annotations

import math
from collections.abc import Iterable

from smarttac_can.plant.parameters import TWO_PI, ContactParameters


class Felt:
    """Vibration that acts on the friction under a moving finger.

    It follows ``shape |W|`` with the lag of the squeeze film, exactly for a vibration constant over
    a step. ``shape = 1 + ripple cos(2 pi x/node_distance)`` is the amplitude at the finger,
    averaged over the contact, over that at the pick-up.

    Parameters
    ----------
    parameters
        Lag, ripple and distance of the nodes.
    """

    __slots__ = ("_W", "_parameters", "shape")

    def __init__(self, parameters: ContactParameters) -> None:
        self._parameters = parameters
        self._W = 0.0
        self.shape = 1.0
        """Amplitude under the finger over that of the pick-up, at the last place."""

    def place(self, x: float) -> None:
        """Take the finger's position in m from the middle."""
        p = self._parameters
        self.shape = 1.0 + p.ripple * math.cos(TWO_PI * x / p.node_distance)

    def follow(self, duration: float, vibrations: Iterable[float]) -> list[float]:
        """Return what is felt in each step of equal length in s, of ``|W|`` in m."""
        lag = self._parameters.film_lag
        follows = -math.expm1(-duration / lag) if lag else 1.0
        felt = []
        for W in vibrations:
            self._W += (self.shape * W - self._W) * follows
            felt.append(self._W)
        return felt
