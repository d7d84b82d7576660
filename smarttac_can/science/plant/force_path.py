"""Force path to a gauge: flexure and filter, a second-order system, solved exactly."""

from __future__ import annotations

import math
from typing import NamedTuple

from smarttac_can.science.plant.parameters import TWO_PI


class Propagator(NamedTuple):
    """Exact step of the second-order system for a force that is constant during the step."""

    yy: float
    yr: float
    ry: float
    rr: float


def propagator(duration: float, frequency: float, damping: float) -> Propagator:
    """Return the step for a natural frequency in Hz and a damping ratio below 1."""
    w = TWO_PI * frequency
    decay = damping * w
    ring = w * math.sqrt(1.0 - damping * damping)
    e = math.exp(-decay * duration)
    c = e * math.cos(ring * duration)
    s = e * math.sin(ring * duration) / ring
    return Propagator(c + decay * s, s, -w * w * s, c - decay * s)


def follow(phi: Propagator, y: float, rate: float, force: float) -> tuple[float, float]:
    """Return output y in N and its rate in N/s after a step with a constant force in N."""
    yy, yr, ry, rr = phi
    deviation = y - force
    return force + yy * deviation + yr * rate, ry * deviation + rr * rate
