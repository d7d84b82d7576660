"""The way of a force to its gauge: flexure and filter, second order, solved exactly."""

from __future__ import annotations

import math
from typing import NamedTuple

from smarttac_can.plant.parameters import TWO_PI


class Transition(NamedTuple):
    """Exact step of the second-order system for a force constant over the step."""

    yy: float
    yr: float
    ry: float
    rr: float


def transition(duration: float, frequency: float, damping: float) -> Transition:
    """Return the step of a system with natural frequency in Hz and damping ratio below 1."""
    w = TWO_PI * frequency
    decay = damping * w
    ring = w * math.sqrt(1.0 - damping * damping)
    e = math.exp(-decay * duration)
    c = e * math.cos(ring * duration)
    s = e * math.sin(ring * duration) / ring
    return Transition(c + decay * s, s, -w * w * s, c - decay * s)


class ForcePath:
    """State of one force on its way: output y in N and its rate in N/s."""

    __slots__ = ("rate", "y")

    def __init__(self) -> None:
        self.y = 0.0
        self.rate = 0.0

    def step(self, phi: Transition, force: float) -> None:
        """Advance by the step of phi under a constant force in N."""
        yy, yr, ry, rr = phi
        deviation = self.y - force
        rate = self.rate
        self.y = force + yy * deviation + yr * rate
        self.rate = ry * deviation + rr * rate
