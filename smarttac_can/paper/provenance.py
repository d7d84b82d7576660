"""Which numbers of the reproduction were chosen to meet the paper, and which come out of it."""

from __future__ import annotations

from typing import Any, Final

from smarttac_can.paper.experiments import SubjectSet
from smarttac_can.paper.references import PUBLISHED, Origin

_FINGERS: Final[dict[SubjectSet, str]] = {
    "presets": "The friction map of each subject (friction without vibration, residual share, "
    "characteristic amplitude, shape) and the damping its finger adds were chosen, within "
    "plausible ranges, for rise time and overshoot of the mean curve in Table I: 20 numbers for 8.",
    "fitted": "Characteristic amplitude, damping, force and speed of each finger were searched "
    "for, with rise time and overshoot of its mean curve in Table I as the aim: 16 numbers for 8, "
    "on top of 8 of the presets (residual share, shape) that were fitted to the same 8. It shows "
    "what the model can do, and predicts nothing.",
}
_FREE_PARAMETERS: Final[dict[SubjectSet, int]] = {"presets": 20, "fitted": 24}
"""Of the fingers; they aim at the 8 numbers of Table I."""


def provenance(subjects: SubjectSet) -> dict[str, Any]:
    """Sort the results of a run, by their keys, for JSON.

    Returns
    -------
    dict
        The keys of the results by their `Origin`, with the number of the fingers' free parameters
        and of the numbers they aim at.
    """
    aims = _keys("fitted")
    return {
        "fitted": aims,
        "chosen": _keys("chosen"),
        "emerges": [*_keys("emerges"), "table1.touches", "table1.down"],
        "free_parameters": _FREE_PARAMETERS[subjects],
        "numbers_aimed_at": sum(key.startswith("table1.subjects") for key in aims),
    }


def _keys(origin: Origin) -> list[str]:
    return [published.key for published in PUBLISHED if published.origin == origin]


def fitted(subjects: SubjectSet) -> tuple[str, ...]:
    """Return what was taken from the figures it is compared with, or searched for to meet them."""
    return (*_FITTED, _FINGERS[subjects])


_FITTED: Final = (
    "The time constant of the plate, 0.944 ms, is computed from the paper's 30 % of voltage at "
    "140 Hz of detuning: the voltage difference of Fig. 6 confirms the loops, not the plate.",
    "The resonance at 20 and 30 °C is the paper's.",
    "The force path, a second-order lag of 100 Hz, is an assumption: without some lag the rise "
    "times and overshoots of Table I do not appear. A faster path and a squeeze film that lags by "
    "2 ms give the same means.",
)

CHOSEN: Final = (
    "The poles of the amplitude loop (0.2) and of the resonance loop (0.3) are design choices from "
    "the range in which both response times of Fig. 5 come out together. The response times are "
    "then checked, with controllers designed from a model that was identified on the warm plate in "
    "the same run.",
)
"""What was decided with the paper's figures in sight, and then checked against them."""

EMERGES: Final = (
    "The frequency the resonance loop finds, and the amplitude it takes to.",
    "The static error of the friction loop, the values of single touches, and the down-steps.",
    "That the result is the same for other seeds of noise, force and speed.",
)
"""What nobody typed in."""
