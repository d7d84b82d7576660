"""Print how the figures of random fingers depend on the sub-steps of the plate; some minutes.

Each finger is regulated by both laws predictive through a dead time of 540 us. A row has the
sub-steps of a tick. The rise time and the overshoot are compared with those of 64 sub-steps. The
last row has 64, too, on a plate whose dead time is 0.1 us longer than the controllers assume: how
far a change that small moves these figures. A finger is chaotic if 64 and 65 sub-steps differ by
more than is allowed: no number of sub-steps gives its figures.

Example: tools/pages/make substeps --fingers 400
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from pages import columns, parser_of

from smarttac_can.science.plant import motion
from smarttac_can.science.population import trial
from smarttac_can.science.population.trial import Campaign, outcome_of
from smarttac_can.vocabulary.states import Law, VibrationLaw

NEAR: Final = np.array([0.05, 1.0])
"""Allowed differences of the rise time in ms and of the overshoot in %."""
FINE: Final = 64
STEPS: Final = (1, 2, 3, 4, 5, 8, 16)
LIMIT_CYCLE: Final = 0.03
DEAD_TIME: Final = 540e-6
NUDGE: Final = 0.1e-6
Rows = np.ndarray[Any, Any]


def figures(seed: int, fingers: int, steps: int, later: float = 0.0) -> Rows:
    """Return rise time in ms, overshoot in % and chatter of the true COF, a row a finger.

    The dead time of the plate is longer by `later`, in s, than the controllers assume.
    """
    vars(motion)["SUBSTEPS"] = steps

    def later_plate(*plate: Any, dead_time: float, **others: Any) -> motion.Coefficients:
        return motion.coefficients(*plate, dead_time=dead_time + later, **others)

    vars(trial)["coefficients"] = later_plate
    campaign = Campaign(seed, Law.PREDICTIVE, VibrationLaw.PREDICTIVE, DEAD_TIME)
    ran = (outcome_of(campaign, number)[0].true for number in range(fingers))
    return np.array([(true.rise_time_ms, true.overshoot_percent, true.chatter) for true in ran])


def apart(one: Rows, other: Rows) -> Rows:
    """Return the distances of rise time and overshoot; that of a rise one lacks is inf."""
    with np.errstate(invalid="ignore"):
        distance = np.abs(one[:, :2] - other[:, :2])
    return np.where(np.isnan(distance), 0.0, distance)


def main() -> int:
    """Print the table, and the chaotic fingers."""
    parser = parser_of(__doc__)
    parser.add_argument("--fingers", type=int, default=400, help="how many")
    parser.add_argument("--seed", type=int, default=71, help="of the fingers")
    options = parser.parse_args()

    def of(steps: int, later: float = 0.0) -> Rows:
        return figures(options.seed, options.fingers, steps, later)

    fine = of(FINE)
    chaotic = np.any(apart(fine, of(FINE + 1)) > NEAR, axis=1)
    rows = []
    for steps, later in (*((steps, 0.0) for steps in STEPS), (FINE, NUDGE)):
        found = of(steps, later)
        distance = apart(found, fine)
        near = np.all(distance <= NEAR, axis=1)
        middle, most = np.quantile(distance, (0.5, 0.99), axis=0, method="inverted_cdf")
        rows.append(
            (
                f"{steps}" + (", later" if later else ""),
                f"{100 * np.mean(near):.1f}",
                f"{100 * np.mean(near[~chaotic]):.1f}",
                f"{middle[0]:.3f} {most[0]:.2f}",
                f"{middle[1]:.2f} {most[1]:.1f}",
                str(np.count_nonzero(found[:, 2] > LIMIT_CYCLE)),
            )
        )
    head = "Sub-steps|within, %|without chaotic, %|rise, ms|overshoot, %|limit cycles"
    print("\n".join(columns(head, rows)).strip())
    print(f"chaotic: {', '.join(map(str, np.flatnonzero(chaotic))) or 'none'}")
    return 0
