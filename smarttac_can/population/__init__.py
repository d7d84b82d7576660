"""Random fingers in closed loop with the plate: the formulas of both, compiled where numba is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.population.fingers import CASES, draw_finger
    from smarttac_can.population.trial import Campaign, outcome_of

__all__ = ["CASES", "Campaign", "draw_finger", "outcome_of"]

__getattr__ = lazily(
    __name__,
    {
        "CASES": "fingers",
        "draw_finger": "fingers",
        "Campaign": "trial",
        "outcome_of": "trial",
    },
)
