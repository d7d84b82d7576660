"""Random fingers in closed loop with the plate: the formulas of both, compiled where numba is."""

from smarttac_can.population.fingers import CASES, draw_finger
from smarttac_can.population.trial import Campaign, outcome_of

__all__ = ["CASES", "Campaign", "draw_finger", "outcome_of"]
