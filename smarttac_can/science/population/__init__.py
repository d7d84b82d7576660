"""Random fingers in closed loop with the plate, and a fit of one; compiled if there is numba."""

from smarttac_can.science.population.finger_fit import (
    Estimate,
    FingerFit,
    FingerRecording,
    fit_finger,
)
from smarttac_can.science.population.fingers import CASES, draw_finger
from smarttac_can.science.population.trial import Campaign, outcome_of

__all__ = [
    "CASES",
    "Campaign",
    "Estimate",
    "FingerFit",
    "FingerRecording",
    "draw_finger",
    "fit_finger",
    "outcome_of",
]
