"""Fingers of a campaign through two nodes and all frames of the bus in the process."""

import numpy as np
import pytest

from smarttac_can.bench import Mode, Stimulator
from smarttac_can.instrument.nodes import plate_block
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.population.fingers import CASES, F0, TRAVEL, draw_finger
from smarttac_can.science.population.trial import Campaign, outcome, traces_of
from smarttac_can.vocabulary.states import Law, VibrationLaw

pytestmark = [pytest.mark.usefixtures("compiled_once"), pytest.mark.sources]
CASE = CASES["nominal"]
DEAD_TIME_US = 540


class Watched(Plate):
    """The plate of the last run, with the true COF at each of its ticks."""

    mu_true: list[float]
    last = None

    def __init__(self, *what, **more):
        super().__init__(*what, **more)
        self.log = []
        Watched.last = self

    def step(self, old, new):
        self.log.append(Plate.mu_true.fget(self))
        super().step(old, new)


def rounded(campaign, number):
    """Return a finger in the steps of the object dictionary, with one seed for all, as there."""
    finger = draw_finger(campaign.seed, number, CASE)
    left = round(finger.mu_left, 4)
    return finger._replace(
        force=round(finger.force, 3),
        speed=round(finger.speed, 4),
        mu_left=left,
        mu_right=round(left + 0.1, 4),
        stroke_seed=finger.noise_seed,
    )


def through_nodes(campaign, finger, like, monkeypatch):
    """Return the run of a finger, with ticks as in the campaign's."""
    monkeypatch.setattr(plate_block, "_FINGERS", (finger.subject,))
    monkeypatch.setattr(plate_block, "Plate", Watched)
    with Stimulator.simulate("bus") as bench:
        bench.law, bench.vibration_law = campaign.law, campaign.vibration_law
        bench.set("Controller.Dead time", DEAD_TIME_US)
        bench.finger.stroke(
            1,
            force=finger.force,
            speed=finger.speed * 1e3,
            travel=TRAVEL * 1e3,
            force_variation=CASE.variation,
            speed_variation=CASE.variation,
        )
        bench.finger.surroundings(seed=finger.noise_seed, drive_instant=DEAD_TIME_US)
        bench.start_run()
        bench.tare()
        bench.frequency = F0
        bench.amplitude, bench.boundary = 1.0, 0.0
        bench.cof = (finger.mu_left, finger.mu_right)
        bench.mode = Mode.FRICTION
        trace = bench.run((len(like.mu) - 100) * 1e-3)
        log = np.array(Watched.last.log)
    # The plate steps to the last tick of the trace when the next SYNC comes.
    ticks = len(log)
    mu, right = np.zeros(ticks), np.zeros(ticks)
    mu[trace.tick[0] :] = trace.cof[:-1]
    right[trace.tick[0] :] = (trace.cof_reference > finger.mu_left + 0.05)[:-1]
    return like._replace(mu_true=log, mu=mu, right=right, steady=like.steady[:ticks])


@pytest.mark.parametrize(
    ("number", "law", "vibration_law"),
    # Fingers that do not end in a limit cycle, which would magnify the rounding of objects.
    [
        (1, Law.MEASURED, VibrationLaw.PI),
        (3, Law.MEASURED, VibrationLaw.PI),
        (6, Law.MEASURED, VibrationLaw.SCHEDULED),
        (1, Law.PREDICTIVE, VibrationLaw.PREDICTIVE),
    ],
)
def test_a_finger_through_two_nodes_is_that_of_the_campaign(
    number, law, vibration_law, monkeypatch
):
    campaign = Campaign(21, law, vibration_law, DEAD_TIME_US * 1e-6)
    finger = rounded(campaign, number)
    mine = traces_of(campaign, finger)
    theirs = through_nodes(campaign, finger, mine, monkeypatch)
    here, there = (outcome(run, finger.mu_left, finger.mu_right) for run in (mine, theirs))
    # The noise of the gauges moves the measured curve's passages of 10 and 90 %.
    for one, other, within_ms in zip(here[:2], there[:2], (0.1, 0.4), strict=True):
        assert one.rise_time_ms == pytest.approx(other.rise_time_ms, abs=within_ms)
        assert one.overshoot_percent == pytest.approx(other.overshoot_percent, abs=1.0)
        assert one.chatter == pytest.approx(other.chatter, abs=1e-3)
