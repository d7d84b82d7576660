"""The way of a force to its gauge: flexure and filter, second order, solved exactly."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from smarttac_can.plant.parameters import TWO_PI


class Propagator(NamedTuple):
    """Exact step of the second-order system for a force constant over the step."""

    yy: float
    yr: float
    ry: float
    rr: float


def propagator(duration: float, frequency: float, damping: float) -> Propagator:
    """Return the step of a system with natural frequency in Hz and damping ratio below 1."""
    w = TWO_PI * frequency
    decay = damping * w
    ring = w * math.sqrt(1.0 - damping * damping)
    e = math.exp(-decay * duration)
    c = e * math.cos(ring * duration)
    s = e * math.sin(ring * duration) / ring
    return Propagator(c + decay * s, s, -w * w * s, c - decay * s)


class ForcePath:
    """State of one force on its way: output y in N and its rate in N/s."""

    __slots__ = ("rate", "y")

    def __init__(self) -> None:
        self.y = 0.0
        self.rate = 0.0

    def follow(self, phi: Propagator, forces: Iterable[float]) -> None:
        """Advance by a step of phi under each of the forces in N, constant over its step."""
        yy, yr, ry, rr = phi
        y, rate = self.y, self.rate
        for force in forces:
            deviation = y - force
            y = force + yy * deviation + yr * rate
            rate = ry * deviation + rr * rate
        self.y, self.rate = y, rate
