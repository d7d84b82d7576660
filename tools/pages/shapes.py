"""Print the shapes of friction maps that `smarttac_can/science/control/friction_map.py` holds.

tools/pages/make shapes

Fingers are drawn at random, each at a force and a speed of its own, and ``ln mu(W) - ln mu(0)`` is
taken at the nodes. The mean over all fingers is the first line; then come the components that
explain most of the rest (principal components), each for a weight of one standard deviation.
Maps that span less than 0.13 between 0.25 and 2.5 um are drawn again: no two references 0.1 apart
are in their reach.

Example: tools/pages/make shapes
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from pages import parser_of

from smarttac_can.science.control.friction_map import LAST, SPACING
from smarttac_can.science.plant.friction import sliding_coefficient
from smarttac_can.science.plant.parameters import ResonatorParameters
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.science.population.fingers import SPAN, UNIFORM, W_LEAST, W_MOST

FINGERS: Final = 4000
SEED: Final = 20
COMPONENTS: Final = 3
RANGES: Final = {name: UNIFORM[name] for name in ("mu0", "rho", "W0", "p", "force", "speed")}
"""Parameters of a map, uniform, in SI units; all else moves it up or down as a whole."""
_NARROW, _WIDE = round(W_LEAST / SPACING), round(W_MOST / SPACING)


def maps() -> np.ndarray:
    """Return the COF of all fingers at the nodes, one row a finger."""
    rng = np.random.default_rng(SEED)
    f0 = ResonatorParameters().f0
    found: list[list[float]] = []
    while len(found) < FINGERS:
        drawn = {name: rng.uniform(low, high) for name, (low, high) in RANGES.items()}
        force, speed = drawn["force"], drawn["speed"]
        subject = replace(
            SUBJECTS[0], mu0=drawn["mu0"], rho=drawn["rho"], W0=drawn["W0"], p=drawn["p"]
        )
        row = [
            sliding_coefficient(subject, node * SPACING, speed, force, 0.0, f0=f0)
            for node in range(LAST + 1)
        ]
        if row[_NARROW] - row[_WIDE] >= SPAN:
            found.append(row)
    return np.array(found)


def shapes() -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of ``ln mu(W)/mu(0)`` and its components, one row each."""
    mu = maps()
    h = np.log(mu / mu[:, :1])
    mean = h.mean(axis=0)
    _, deviations, directions = np.linalg.svd(h - mean, full_matrices=False)
    rows = directions[:COMPONENTS] * deviations[:COMPONENTS, None] / np.sqrt(FINGERS)
    # The sign is a convention: a positive weight first makes friction fall more.
    return mean, rows * -np.sign(rows[:, 1:2])


def main() -> None:
    """Print the shapes."""
    parser_of(__doc__).parse_args()
    average, components = shapes()
    for shape in (average, *components):
        print("(" + ", ".join(f"{value + 0.0:.3f}" for value in shape) + ")")
