"""Four fingers with their own force and speed, fitted to Table I by tools/pages/make fingers.

The presets of Table I share one force and one speed, and do not reproduce the slow rise of subject
4. For each finger here four numbers were fitted: W0, load_damping, force and speed. rho and p are
those of the corresponding preset, which were fitted to the same table. mu0 gives, at the finger's
own force and speed, the middle of the range in the paper. The fingers show what the model can
reproduce; they do not predict anything.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from smarttac_can.science.plant.subjects import SUBJECTS, Subject


class FittedFinger(NamedTuple):
    """A fingertip with its force and speed."""

    subject: Subject
    force: float
    """Mean normal force in N."""
    speed: float
    """Mean sliding speed in m/s."""


def _fitted(
    number: int, mu0: float, W0: float, load_damping: float, force: float, speed: float
) -> FittedFinger:
    subject = replace(
        SUBJECTS[number - 1],
        name=f"fitted-{number}",
        mu0=mu0,
        W0=W0,
        load_damping=load_damping,
    )
    return FittedFinger(subject, force, speed)


FITTED: tuple[FittedFinger, ...] = (
    _fitted(1, 0.348, 1.83e-06, 12.5, 0.545, 0.0735),
    _fitted(2, 0.430, 2.45e-06, 7.88, 0.474, 0.0358),
    _fitted(3, 0.574, 1.48e-06, 7.6, 0.89, 0.0706),
    _fitted(4, 0.679, 1.48e-06, 10.5, 1.49, 0.0208),
)
"""Fitted fingers, in the order of Table I."""
