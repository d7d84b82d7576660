"""Random fingers in closed loop with the plate, compiled if numba is installed."""

from smarttac_can.science.population.fingers import CASES, draw_finger
from smarttac_can.science.population.trial import Campaign, outcome_of

__all__ = ["CASES", "Campaign", "draw_finger", "outcome_of"]
