"""Four fingers that press and move as they like: fitted to Table I by tools/fit_fingers.py.

The presets of Table I share one force and speed and do not reach the slow rise of subject 4. These have
forces and speeds of their own: three numbers a finger were searched for, W0, force and speed. The rest is
that of the preset in its place, which was fitted to the same table; mu0 gives, at the finger's own
force and speed, the middle of the range that the paper states. It shows what the model can do, and
predicts nothing.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from smarttac_can.plant.subjects import SUBJECTS, Subject


class FittedFinger(NamedTuple):
    """A fingertip, and how it is moved."""

    subject: Subject[float]
    force: float
    """Mean normal force in N."""
    speed: float
    """Mean sliding speed in m/s."""


def _fitted(number: int, mu0: float, W0: float, force: float, speed: float) -> FittedFinger:
    subject = replace(SUBJECTS[number - 1], name=f"fitted-{number}", mu0=mu0, W0=W0)
    return FittedFinger(subject, force, speed)


FITTED: tuple[FittedFinger, ...] = (
    _fitted(1, 0.345, 1.9e-6, 0.514, 0.0651),
    _fitted(2, 0.469, 1.49e-6, 0.805, 0.0991),
    _fitted(3, 0.54, 2.49e-6, 0.415, 0.051),
    _fitted(4, 0.69, 1.48e-6, 1.49, 0.0208),
)
"""In the order of Table I."""
