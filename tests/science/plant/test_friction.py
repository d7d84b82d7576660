import dataclasses
import inspect

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.plant.finger import Stroke
from smarttac_can.science.plant.friction import (
    bare_friction,
    check_reach,
    friction_map,
    sliding_coefficient,
    sliding_friction,
)
from smarttac_can.science.plant.parameters import ResonatorParameters
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.science.population.fingers import Case, draw_finger

F0 = 43390.0
subjects = st.sampled_from(
    [*SUBJECTS, *(draw_finger(3, number, Case()).subject for number in range(20))]
)


def coefficient(subject, W, v=0.06, Fn=0.5, occlusion=0.0):
    return sliding_coefficient(subject, W, v, Fn, occlusion, f0=F0)


def reduction(subject, W, v):
    plain = dataclasses.replace(subject, stribeck=1.0)
    return sliding_friction(friction_map(plain, F0), 1.0, W, v)[0]


def stribeck(subject, v):
    return sliding_friction(friction_map(subject, F0), 1.0, 0.0, v)[0]


@given(subject=subjects, W=st.floats(0.0, 5e-6), more=st.floats(1e-8, 1e-6), v=st.floats(0.0, 1.0))
@settings(max_examples=100)
def test_more_vibration_never_means_more_friction(subject, W, more, v):
    g0 = reduction(subject, W, v)
    g1 = reduction(subject, W + more, v)
    assert subject.rho <= g1 <= g0 <= 1.0


@given(subject=subjects, W=st.floats(1e-8, 5e-6), v=st.floats(0.0, 0.5))
@settings(max_examples=100)
def test_speed_weakens_the_reduction(subject, W, v):
    slow = reduction(subject, W, v)
    assert reduction(subject, W, v + 0.1) >= slow


def test_at_the_speed_v1_half_of_the_vibration_counts():
    subject = SUBJECTS[1]
    v1 = subject.mu0 * np.pi * F0 * 2e-6
    half = reduction(subject, 1e-6, 0.0)
    assert reduction(subject, 2e-6, v1) == pytest.approx(half, rel=1e-9)


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda s: s.name)
def test_without_vibration_friction_is_bare(subject):
    assert reduction(subject, 0.0, 0.0) == 1.0
    assert reduction(subject, 0.0, 0.1) == 1.0
    assert bare_friction(friction_map(subject, F0), 0.5, 0.0) == pytest.approx(0.5 * subject.mu0)


def test_force_and_occlusion():
    subject = SUBJECTS[0]
    assert bare_friction(friction_map(subject, F0), 0.0, 0.0) == 0.0
    low, high = (bare_friction(friction_map(subject, F0), Fn, 0.0) for Fn in (0.25, 1.0))
    assert np.log(high / low) / np.log(4.0) == pytest.approx(subject.exponent)
    wet = bare_friction(friction_map(subject, F0), 0.5, 1.0)
    assert wet == pytest.approx(0.5 * subject.mu0 * (1.0 + subject.occlusion))


def test_stribeck_falls_from_its_ratio_to_one():
    subject = SUBJECTS[0]
    assert stribeck(subject, 0.0) == subject.stribeck
    assert stribeck(subject, subject.stribeck_speed) == pytest.approx((1 + subject.stribeck) / 2)
    assert stribeck(subject, 1e3) == pytest.approx(1.0)


def test_out_of_reach_is_refused():
    subject = SUBJECTS[1]
    with pytest.raises(ValueError, match=r"^fair: COF 0\.4\d\d is not above 1\.05 x 0\.45$"):
        check_reach(subject, 0.3, 0.45)
    with pytest.raises(ValueError, match=r"^fair: COF 0\.\d+ is not below 0\.95 x 0\.1$"):
        check_reach(subject, 0.1, 0.4)
    with pytest.raises(ValueError, match="not below"):
        check_reach(subject, 0.3, 0.4, W_max=1e-6)
    check_reach(dataclasses.replace(subject, mu0=0.45), 0.3, 0.4)
    with pytest.raises(ValueError, match="not above"):
        check_reach(dataclasses.replace(subject, mu0=0.42), 0.3, 0.4)


@given(
    subject=subjects,
    forces=st.tuples(st.floats(0.1, 0.5), st.floats(0.5, 2.0)),
    speeds=st.tuples(st.floats(0.005, 0.05), st.floats(0.05, 0.3)),
    W_max=st.floats(0.5e-6, 3e-6),
)
@settings(max_examples=30)
def test_reach_is_that_of_the_worst_place_with_5_percent_margin(subject, forces, speeds, W_max):
    places = [
        (v, Fn, occlusion)
        for v in np.linspace(*speeds, 33)
        for Fn in forces
        for occlusion in (0.0, 1.0)
    ]
    least = max(coefficient(subject, W_max, *place) for place in places)
    most = min(coefficient(subject, 0.0, *place) for place in places)
    ranges = {"forces": forces, "speeds": speeds, "W_max": W_max, "f0": F0}
    check_reach(subject, 1.001 * least / 0.95, 0.999 * most / 1.05, **ranges)
    with pytest.raises(ValueError, match="is not below"):
        check_reach(subject, 0.98 * least / 0.95, 0.999 * most / 1.05, **ranges)
    with pytest.raises(ValueError, match="is not above"):
        check_reach(subject, 1.001 * least / 0.95, 1.001 * most / 1.05, **ranges)


def test_default_reach_is_over_the_stroke_and_amplitude_limits():
    asked = {n: p.default for n, p in inspect.signature(check_reach).parameters.items()}
    stroke = {n: p.default for n, p in inspect.signature(Stroke).parameters.items()}
    for name in ("force", "speed"):
        variation = stroke[f"{name}_variation"]
        around = [stroke[name] * (1.0 + side * variation) for side in (-1.0, 1.0)]
        assert asked[f"{name}s"] == pytest.approx(around)
    assert asked["W_max"] == CascadeParameters().W_max
    assert asked["f0"] == ResonatorParameters().f0


def test_five_subjects_differ_as_in_fig_2():
    ratios = np.array(
        [[coefficient(s, W * 1e-6) / coefficient(s, 0.0) for W in (0, 0.5, 1, 1.5, 2)]
         for s in SUBJECTS]
    )  # fmt: skip
    assert np.all(np.diff(ratios, axis=1) < 0)
    assert np.ptp(ratios[:, -1]) > 0.2
    assert 0.3 < ratios[:, -1].mean() < 0.8


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda s: s.name)
@pytest.mark.parametrize("W", [0.0, 0.3e-6, 2e-6])
@pytest.mark.parametrize("v", [1e-3, 0.02, 0.3])
def test_friction_slopes_are_those_over_speed_and_vibration(subject, W, v):
    friction = friction_map(subject, F0)

    def difference(more_W, more_v):
        before, after = (
            sliding_friction(friction, 0.2, W + sign * more_W, v + sign * more_v)[0]
            for sign in (-1, 1)
        )
        return (after - before) / 2.0

    _, per_v, per_W = sliding_friction(friction, 0.2, W, v)
    assert per_v * 1e-4 * v == pytest.approx(difference(0.0, 1e-4 * v), rel=1e-5, abs=1e-12)
    assert per_W * 1e-4 * W == pytest.approx(difference(1e-4 * W, 0.0), rel=1e-5, abs=1e-12)
