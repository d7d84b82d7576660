"""The predictive friction law against the plate, through the dead time of a bus.

Fingers of a population that nothing was tuned on; COF is the true one under the finger.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from smarttac_can.control.cascade import Cascade
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.plant.finger import Stroke
from smarttac_can.plant.friction import sliding_coefficient
from smarttac_can.plant.parameters import PlateParameters
from smarttac_can.plant.plate import Plate
from smarttac_can.plant.subjects import SUBJECTS
from smarttac_can.population.fingers import UNIFORM
from smarttac_can.vocabulary.signals import Drive, Setpoint
from smarttac_can.vocabulary.states import Law, Mode, VibrationLaw

BUS = 540e-6
SPEED, FORCE, TRAVEL = 0.06, 0.5, 0.024
STEP = 0.1
# All but the skin.
DRAWN = ("mu0", "rho", "W0", "p", "load_damping", "exponent")
PASSES = 12
LAWS = {
    "paper": (Law.MEASURED, VibrationLaw.PI),
    "predictive": (Law.PREDICTIVE, VibrationLaw.PREDICTIVE),
}


@cache
def fingers():
    """Return six fingers with the lower of two references that are in their reach."""
    found = []
    for draws in np.random.default_rng([404, 0x5B]).random((20, len(DRAWN))).tolist():
        ranges = zip(DRAWN, (UNIFORM[name] for name in DRAWN), draws, strict=True)
        values = {name: low + (high - low) * draw for name, (low, high), draw in ranges}
        subject = replace(SUBJECTS[1], **values)
        high, low = (
            sliding_coefficient(subject, W, SPEED, FORCE, 0.0, f0=43390.0) for W in (0.4e-6, 2.5e-6)
        )
        if high - low > STEP:
            found.append((subject, 0.5 * (high + low - STEP)))
    return found[:6]


@cache
def up_step(number, laws):
    """Return the mean curve of the up-steps after the fourth, -20 to 80 ms, 0 to 1."""
    subject, low = fingers()[number]
    law, vibration_law = LAWS[laws]
    stroke = Stroke(FORCE, SPEED, TRAVEL, seed=number, rest=0.07)
    plate = Plate(PlateParameters(), subject, stroke, seed=number, dead_time=BUS)
    cascade = Cascade(CascadeParameters(law=law, vibration_law=vibration_law, dead_time=BUS))
    target = Setpoint(0.0, 43390.0, 1e-6, low, low + STEP, 0.0)
    old = Drive(0.0, 43390.0)
    mu, mu_ref = [], []
    for tick in range(round((0.2 + PASSES * 1.2 * TRAVEL / SPEED) * 1e3)):
        if tick == 66:
            cascade.zero = cascade.null()
            cascade.set_mode(Mode.FRICTION)
        mu.append(plate.mu_true)
        drive = cascade.update(plate.sample(), target)
        mu_ref.append(cascade.mu_ref)
        plate.step(old, drive)
        old = drive
    rises = [k for k in range(1, len(mu) - 80) if mu_ref[k] > mu_ref[k - 1] > 0.0][2:]
    assert len(rises) >= 3
    return (np.mean([mu[k - 20 : k + 80] for k in rises], axis=0) - low) / STEP


@pytest.mark.parametrize("number", range(6))
def test_a_step_is_quick_and_lands(number):
    curve = up_step(number, "predictive")
    assert curve[20] < 0.15  # The reference steps here.
    assert curve[23] > 0.8
    assert curve[26] > 0.85  # What is left is the skin.
    assert curve[20:].max() < 1.1
    assert curve[60:].std() < 0.05
    assert curve[:20].mean() == pytest.approx(0.0, abs=0.05)
    assert curve[60:].mean() == pytest.approx(1.0, abs=0.05)


def test_the_papers_law_is_slower_and_overshoots():
    curves = [up_step(number, "paper") for number in range(6)]
    assert min(np.argmax(curve > 0.8) for curve in curves) > 23
    assert max(curve.max() for curve in curves) > 1.1
