"""The loop of a campaign, compiled and not, against the objects that a node runs."""

import numpy as np
import pytest
from by_objects import traces_by_objects

from smarttac_can.science.population import trial
from smarttac_can.science.population.fingers import CASES, PLATES, draw_finger, draw_plate, lift
from smarttac_can.science.population.trial import Campaign, fastest, plain, traces_of
from smarttac_can.vocabulary.states import Law, VibrationLaw

pytestmark = pytest.mark.usefixtures("compiled_once")
TICKS = 2500
"""Some 4 passes of a fast finger, 2 of a slow one, or two lifts."""
BOUND = 1e-9
CAMPAIGNS = [
    Campaign(7, vibration_law=VibrationLaw.PI),
    Campaign(7, dead_time=540e-6),
    Campaign(8, vibration_law=VibrationLaw.SCHEDULED, dead_time=540e-6),
    Campaign(9, vibration_law=VibrationLaw.PREDICTIVE),
    Campaign(9, vibration_law=VibrationLaw.PREDICTIVE, dead_time=540e-6),
    Campaign(10, law=Law.ACCUMULATE),
    Campaign(10, law=Law.NOMINAL, dead_time=300e-6),
    Campaign(10, law=Law.PREDICTIVE, dead_time=540e-6),
    Campaign(10, Law.PREDICTIVE, VibrationLaw.PREDICTIVE, 540e-6),
    Campaign(10, Law.PREDICTIVE, VibrationLaw.PREDICTIVE, 540e-6, "lifting"),
    # Where friction falls with speed, most fingers stick and slip: that magnifies a last bit.
    *(Campaign(36 if case == "stribeck" else 11, dead_time=540e-6, case=case) for case in CASES),
    *(
        Campaign(12, *laws, 540e-6, "film-lag", plates)
        for plates in PLATES[1:]
        for laws in ((Law.MEASURED, VibrationLaw.PI), (Law.PREDICTIVE, VibrationLaw.PREDICTIVE))
    ),
]
FINGERS = 2


def name_of(campaign):
    laws = f"{campaign.law.name}-{campaign.vibration_law.name}".lower()
    return f"{laws}-{campaign.dead_time * 1e6:.0f}us-{campaign.case}-{campaign.plates}"


def apart(campaign, number):
    """Return the largest difference of the true COF to that by objects, and of the measured one.

    It is taken up to the first tick at which a converter, the touch or the side decides otherwise.
    """
    finger = draw_finger(campaign.seed, number, CASES[campaign.case])
    under = draw_plate(campaign.seed, number, campaign.plates)
    run = traces_of(campaign, finger, under)
    mine = np.stack([run.mu_true, run.mu, run.right], axis=1)[:TICKS]
    assert np.ptp(mine[1000:, 0]) > 0.05
    theirs = traces_by_objects(campaign, finger, under, len(mine))
    # The side counts in mode FRICTION alone: before it, none is reported.
    mine[:64, 2] = 0.0
    return np.abs(mine - theirs).max(axis=0)


@pytest.mark.parametrize("campaign", CAMPAIGNS, ids=name_of)
def test_the_fastest_loop_is_that_of_plate_and_cascade(campaign):
    """To 1e-9 over the whole run: none of these fingers comes to another discrete decision."""
    for number in range(FINGERS):
        assert apart(campaign, number).max() <= BOUND


@pytest.mark.parametrize(
    ("law", "vibration_law"),
    [*((Law.MEASURED, law) for law in VibrationLaw), (Law.PREDICTIVE, VibrationLaw.PREDICTIVE)],
)
def test_the_loop_that_is_not_compiled_is_the_same(law, vibration_law, monkeypatch):
    monkeypatch.setattr(trial, "fastest", plain)
    assert apart(Campaign(12, law, vibration_law, 540e-6), 0).max() <= BOUND


def test_it_is_compiled_here():
    assert fastest()[0].__class__.__module__.startswith("numba")


def test_every_friction_law_is_among_those_that_are_compared():
    assert {campaign.law for campaign in CAMPAIGNS} == set(Law)


def test_a_lift_takes_a_tenth_of_each_second():
    share = np.array([lift(n * 1e-3) for n in range(3000)])
    assert (share == 0.0).mean() == pytest.approx(0.09, abs=0.002)
    assert (share == 1.0).mean() == pytest.approx(0.89, abs=0.002)
    assert np.abs(np.diff(share)).max() < 0.2
    assert share[1000] == share[2000] == 1.0
    assert share[1050] == 0.0


def test_there_is_no_such_case():
    with pytest.raises(ValueError, match=r"^there is no case 'x': nominal, "):
        Campaign(case="x")
    with pytest.raises(ValueError, match=r"^there are no plates 'x': model, varied, identified$"):
        Campaign(plates="x")
