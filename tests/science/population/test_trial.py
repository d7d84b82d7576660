import math

import numpy as np
import pytest

from smarttac_can.science.population.fingers import CASES, MODEL_PLATE, draw_plate
from smarttac_can.science.population.steps import (
    TIME_MS,
    Step,
    UndefinedError,
    overshoot_percent,
    rise_time,
    single_steps,
)
from smarttac_can.science.population.trial import (
    NO_STEP,
    TOUCHES,
    Campaign,
    Traces,
    outcome,
    parameters_of,
    plate_of,
)

LOW, HIGH = 0.3, 0.4
PASS = 300
"""Ticks between two switches."""
SWITCHES = 12


def synthetic(rise=4, over=0.0, wobble=0.0, noise=0.0, **changes):
    """A run whose COF follows the side with a linear rise in ms, and some overshoot for 5 ms."""
    ticks = PASS * (SWITCHES + 1)
    right = np.arange(ticks) // PASS % 2.0
    mu = np.where(right > 0, HIGH, LOW)
    for switch in range(PASS, ticks, PASS):
        low, high = mu[switch - 1], mu[switch]
        mu[switch : switch + rise + 1] = low + (high - low) * np.arange(rise + 1) / rise
        mu[switch + rise + 1 : switch + rise + 6] = high + over * (high - low)
    mu = mu + wobble * np.sin(np.arange(ticks))
    measured = mu + noise * np.random.default_rng(1).standard_normal(ticks)
    run = Traces(mu, measured, right, np.ones(ticks, dtype=np.bool_))
    return run._replace(**changes)


def test_a_step_is_judged_by_its_own_levels():
    true, measured, _ = outcome(synthetic(over=0.3, noise=1e-3), LOW, HIGH)
    assert true.rise_time_ms == pytest.approx(0.8 * 4)
    assert true.overshoot_percent == pytest.approx(30.0)
    assert true.static_error_percent == pytest.approx(0.0, abs=1e-9)
    assert true.chatter == pytest.approx(0.0, abs=1e-9)
    assert measured.rise_time_ms == pytest.approx(3.2, abs=0.1)
    assert measured.chatter == pytest.approx(1e-3, rel=0.1)


def test_chatter_is_the_standard_deviation_where_all_is_steady():
    run = synthetic(wobble=0.05)
    true, *_ = outcome(run, LOW, HIGH)
    assert true.chatter == pytest.approx(0.05 / math.sqrt(2.0), rel=0.01)
    turns = np.zeros(len(run.mu), dtype=np.bool_)
    turns[PASS // 2 :: PASS] = True
    spiked = np.where(turns, 0.0, synthetic().mu)
    assert outcome(synthetic(mu_true=spiked), LOW, HIGH).true.chatter > 0.02
    still, *_ = outcome(synthetic(mu_true=spiked, steady=~turns), LOW, HIGH)
    assert still.chatter == pytest.approx(0.0, abs=1e-9)


def test_levels_of_either_side_are_no_chatter():
    run = synthetic()
    drift = np.where(np.arange(len(run.mu)) // PASS % 3 == 0, 0.02, 0.0)
    assert outcome(run._replace(mu_true=run.mu + drift), LOW, HIGH).true.chatter < 1e-9


def test_trial_judges_from_the_fourth_switch_on():
    run = synthetic()
    early = run.mu.copy()
    early[: 4 * PASS] += 0.1 * np.sin(np.arange(4 * PASS))
    assert outcome(run._replace(mu_true=early), LOW, HIGH).true == outcome(run, LOW, HIGH).true


def test_lost_touch_and_the_tick_after_it_are_left_out():
    run = synthetic()
    lost = run.mu.copy()
    ragged = run.mu_true.copy()
    lost[5 * PASS + 10 : 5 * PASS + 20] = 0.0
    ragged[5 * PASS + 10 : 5 * PASS + 60] += 0.2
    true, *_ = outcome(run._replace(mu=lost, mu_true=ragged), LOW, HIGH)
    assert true.overshoot_percent == pytest.approx(0.0, abs=1e-9)
    assert true.chatter == pytest.approx(0.0, abs=1e-9)


def test_a_finger_without_a_usable_touch_counts_as_bad():
    run = synthetic()
    true, measured, _ = outcome(run._replace(mu=np.zeros(len(run.mu))), LOW, HIGH)
    assert (true.rise_time_ms, true.overshoot_percent) == (math.inf, NO_STEP)
    assert math.isnan(true.static_error_percent)
    assert math.isnan(measured.chatter)


def test_finger_without_a_step_is_bad_with_its_static_error():
    run = synthetic()
    flat = np.full(len(run.mu), 0.35)
    true, *_ = outcome(run._replace(mu_true=flat), LOW, HIGH)
    assert (true.rise_time_ms, true.overshoot_percent) == (math.inf, NO_STEP)
    assert true.static_error_percent == pytest.approx(100 * 0.05 / 0.3)


def test_no_switch_at_all():
    ticks = 500
    run = Traces(*(np.full(ticks, 0.3),) * 2, np.zeros(ticks), np.ones(ticks, dtype=np.bool_))
    true, *_ = outcome(run, LOW, HIGH)
    assert true.rise_time_ms == math.inf
    assert math.isnan(true.chatter)


def test_single_touches_show_more_than_the_mean_curve():
    run = synthetic()
    mu = run.mu_true.copy()
    for number, switch in enumerate(range(5 * PASS, len(mu), 2 * PASS)):
        # Even touches overshoot where odd ones fall short.
        mu[switch + 10 : switch + 14] += 0.03 * (-1) ** number
    true, _, touches = outcome(run._replace(mu_true=mu), LOW, HIGH)
    assert true.overshoot_percent < 10.0
    assert touches[:, 0] == pytest.approx([3.2] * 4 + [math.nan] * 2, nan_ok=True)
    assert touches[:, 1] == pytest.approx([30, 0, 30, 0] + [math.nan] * 2, abs=1e-9, nan_ok=True)


def test_touch_without_a_step_is_bad_and_a_lost_one_is_not():
    run = synthetic()
    mu, lost = run.mu_true.copy(), run.mu.copy()
    mu[5 * PASS : 6 * PASS] = LOW
    lost[7 * PASS + 10] = 0.0
    touches = outcome(run._replace(mu_true=mu, mu=lost), LOW, HIGH).touches
    assert touches.shape == (TOUCHES, 2)
    assert touches[0].tolist() == [math.inf, NO_STEP]
    assert touches[1:3, 0] == pytest.approx(3.2)
    assert np.isnan(touches[3:]).all()


def test_many_steps_at_once_are_judged_as_each_alone():
    rng = np.random.default_rng(1)
    shape = 1.0 - np.exp(-np.maximum(TIME_MS, 0.0) / rng.uniform(0.5, 6.0, (300, 1)))
    curves = LOW + rng.uniform(0.03, 0.13, (300, 1)) * shape
    curves += rng.choice([0.0, 0.005, 0.05], (300, 1)) * rng.standard_normal(curves.shape)
    alone = []
    for curve in curves:
        step = Step(TIME_MS, curve, LOW, HIGH)
        try:
            alone.append((rise_time(step), overshoot_percent(step)))
        except UndefinedError:
            alone.append((math.inf, NO_STEP))
    assert single_steps(curves, HIGH - LOW, NO_STEP) == pytest.approx(np.array(alone), abs=1e-9)
    assert 30 < np.isinf(np.array(alone)[:, 0]).sum() < 270


@pytest.mark.parametrize(
    ("excess", "assumed"), [(0.0, 540), (150e-6, 690), (-150e-6, 390), (500e-6, 999), (-1e-3, 0)]
)
def test_the_laws_assume_the_dead_time_of_the_plate(excess, assumed):
    plate = MODEL_PLATE._replace(excess=excess)
    parameters = parameters_of(Campaign(dead_time=540e-6), plate)
    assert parameters.dead_time * 1e6 == pytest.approx(assumed)


@pytest.mark.parametrize("dead_time", [0.0, 540e-6, 999e-6])
def test_model_plate_laws_have_the_campaign_parameters(dead_time):
    campaign = Campaign(dead_time=dead_time)
    assert parameters_of(campaign, MODEL_PLATE) == campaign.parameters


def test_a_plate_that_is_drawn_takes_part_in_every_case():
    drawn = draw_plate(3, 1, "varied")
    plate = plate_of(CASES["path-slower"], drawn)
    assert plate.resonator == drawn.resonator
    assert plate.sensors.pickup_window == drawn.window > 0.0
    assert plate.sensors.path_frequency == 0.7 * plate_of(CASES["nominal"]).sensors.path_frequency
