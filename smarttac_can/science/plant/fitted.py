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
    _fitted(1, 0.349, 1.83e-06, 13.2, 0.55, 0.0752),
    _fitted(2, 0.431, 2.7e-06, 8.11, 0.488, 0.0354),
    _fitted(3, 0.578, 1.5e-06, 7.83, 0.944, 0.0749),
    _fitted(4, 0.670, 1.44e-06, 15.7, 1.2, 0.0248),
)
"""Fitted fingers, in the order of Table I."""
