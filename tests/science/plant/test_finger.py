import math
import re
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stated_bounds import made_at_bounds

from smarttac_can.science.plant.finger import GuidedFinger, Lifted, Stroke, Trajectory


def follow(finger, seconds):
    return np.array([finger.at(k * 1e-3) for k in range(round(seconds * 1000))])


def test_no_finger():
    assert Lifted().at(0.0) == Lifted().at(9.0) == (0.0, 0.0)


def test_stroke_rests_presses_and_slides():
    states = follow(Stroke(0.5, 0.06, 0.03, rest=0.2, press=0.1), 10.0)
    x, Fn = states.T
    assert np.all(Fn[:201] == 0.0)
    assert np.all(Fn[202:] > 0.0)
    assert np.all(x[:300] == -0.015)
    assert np.all(np.abs(x) <= 0.015 + 1e-12)
    assert np.count_nonzero(np.diff(np.sign(x[300:])) != 0) >= 14
    assert np.all((Fn[301:] >= 0.4 - 1e-9) & (Fn[301:] <= 0.6 + 1e-9))


def test_stroke_is_smooth():
    x, Fn = follow(Stroke(0.5, 0.06, 0.03), 10.0).T
    v = np.diff(x) / 1e-3
    # Raised cosine from 0 to 72 mm/s within 20 % of the way at that speed, here at most 83 ms.
    assert np.max(np.abs(np.diff(v))) < 0.5 * math.pi * 0.072 / 0.083 * 1e-3 * 1.01
    assert np.max(np.abs(np.diff(Fn))) < 0.6 * math.pi / 2 * 1e-3 / 0.1 * 1.01


def test_stroke_speed_is_constant_in_the_middle_of_each_pass():
    x, _ = follow(Stroke(0.5, 0.06, 0.03), 20.0).T
    v = np.abs(np.diff(x)) / 1e-3
    middle = np.flatnonzero(np.abs(x[:-1]) < 8e-3)
    passes = np.split(middle, np.flatnonzero(np.diff(middle) > 1) + 1)
    speeds = [v[p] for p in passes if len(p) > 50]
    assert len(speeds) > 25
    assert all(np.ptp(s) < 1e-9 for s in speeds)
    means = [s[0] for s in speeds]
    assert 0.048 <= min(means) < 0.053
    assert 0.067 < max(means) <= 0.072


@given(
    times=st.lists(st.floats(0.0, 30.0), min_size=1, max_size=20), seed=st.integers(0, 2**63 - 1)
)
@settings(max_examples=50)
def test_stroke_is_a_function_of_time_in_any_order(times, seed):
    asked = Stroke(seed=seed)
    answers = [asked.at(t) for t in times]
    assert answers == [Stroke(seed=seed).at(t) for t in times]
    assert answers == [asked.at(t) for t in times]


def test_passes_follow_each_other_and_fill_their_ranges():
    stroke = Stroke(0.5, 0.06, 0.03, force_variation=0.2, speed_variation=0.3, rest=0.7, press=0.1)
    passes = stroke.passes(300)
    assert len(passes) == 300
    assert passes[0].start == pytest.approx(0.8)
    for before, after in pairwise(passes):
        assert after.start == pytest.approx(before.start + before.duration, rel=1e-12)
    for values, mean, variation in (
        ([now.Fn for now in passes], 0.5, 0.2),
        ([now.speed for now in passes], 0.06, 0.3),
    ):
        low, high = min(values) / mean - 1.0, max(values) / mean - 1.0
        assert -variation <= low < -0.95 * variation
        assert 0.95 * variation < high <= variation
    # From one end of the way to the other.
    for number, now in enumerate(passes[:5]):
        side = 1.0 if number % 2 else -1.0
        assert stroke.at(now.start).x == pytest.approx(side * 0.015)
        assert stroke.at(now.start + 0.5 * now.duration).x == pytest.approx(0.0, abs=1e-12)


def test_seeds_give_other_passes():
    assert Stroke(seed=1).at(5.0) != Stroke(seed=2).at(5.0)


@pytest.mark.parametrize(
    "name", ["force", "speed", "travel", "force_variation", "speed_variation", "rest", "press"]
)
def test_stroke_slides_at_each_bound_and_refuses_values_beyond(name):
    for finger in made_at_bounds(name, lambda value: Stroke(**{name: value})):
        begins = finger.passes(1)[0].start
        for elapsed in (0.0, 0.1, 1.0, 10.0):
            x, Fn = finger.at(begins + elapsed)
            assert abs(x) <= 0.5 * finger.path.travel + 1e-12
            assert 0.0 < Fn < 10.0


def test_trajectory_is_limited_to_the_plate_and_a_fingers_force():
    finger = Trajectory([(0.0, -38e-3, 0.0), (1e9, 38e-3, 10.0)])
    assert finger.at(1e9) == (38e-3, 10.0)


def test_trajectory_is_linear_between_samples_and_lifted_outside():
    finger = Trajectory([(0.1, -0.01, 0.0), (0.2, 0.01, 0.4), (0.4, 0.01, 0.2)])
    assert finger.at(0.0) == (-0.01, 0.0)
    assert finger.at(0.15) == pytest.approx((0.0, 0.2))
    assert finger.at(0.2) == pytest.approx((0.01, 0.4))
    assert finger.at(0.3) == pytest.approx((0.01, 0.3))
    assert finger.at(0.4) == pytest.approx((0.01, 0.2))
    assert finger.at(0.401) == (0.01, 0.0)


@pytest.mark.parametrize(
    ("samples", "message"),
    [
        ([(0.0, 0.0, 0.5)], "1 samples of a trajectory are fewer than 2"),
        ([(0.0, 0.0, 0.5), (0.0, 0.0, 0.5)], "sample 1 time 0.0 is not after"),
        ([(t, 0.0, 0.5) for t in (0.0, 1.0, 0.5, 2.0, 1.5)], "sample 2 time 0.5 is not after"),
        ([(0.0, 0.0, 0.5), (1.001e9, 0.0, 0.5)], "sample 1 time 1001000000.0 is outside"),
        ([(0.0, 0.0, 0.5), (1.0, 0.0381, 0.5)], "sample 1 x 0.0381 is outside"),
        ([(0.0, 0.0, 0.5), (1.0, -0.0381, 0.5)], "sample 1 x -0.0381 is outside"),
        ([(0.0, 0.0, 0.5), (1.0, 0.0, 10.1)], "sample 1 Fn 10.1 is outside"),
        ([(0.0, 0.0, -0.5), (1.0, 0.0, 0.5)], "sample 0 Fn -0.5 is outside"),
        ([(math.nan, 0.0, 0.5), (1.0, 0.0, 0.5)], "sample 0 time nan is outside"),
    ],
)
def test_trajectory_refuses(samples, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Trajectory(samples)


def test_a_guided_finger_goes_where_it_is_guided_without_a_blow():
    finger = GuidedFinger()
    assert finger.at(0.0) == (0.0, 0.0)
    finger.guide(0.01, 0.5)
    down = np.array([finger.at(k * 1e-3) for k in range(1, 301)])
    assert down[-1] == pytest.approx((0.01, 0.5), abs=1e-4)
    finger.guide(-0.01, 1.0)
    over = np.array([finger.at(k * 1e-3) for k in range(301, 601)])
    assert np.all(np.diff(over[:, 0]) <= 0.0)
    assert np.all(np.diff(over[:, 1]) >= 0.0)
    assert np.max(np.abs(np.diff(over[:, 0]))) < 0.02 / 20  # 20 mm in 20 ms at most
    assert over[-1] == pytest.approx((-0.01, 1.0), abs=1e-4)
    finger.guide(0.03, 0.0)
    up = np.array([finger.at(k * 1e-3) for k in range(601, 901)])
    assert up[-1, 1] == 0.0
    assert np.all(np.diff(up[:, 1]) <= 0.0)


def test_a_guided_finger_presses_by_the_law_of_critical_damping():
    finger = GuidedFinger()
    finger.at(0.0)
    finger.guide(0.0, 0.5)
    time = np.arange(1, 100) * 1e-3
    Fn = np.array([finger.at(float(t)).Fn for t in time])
    assert Fn == pytest.approx(0.5 * (1.0 - (1.0 + time / 0.02) * np.exp(-time / 0.02)), rel=1e-9)


def test_a_guided_finger_lifts_below_a_millinewton():
    finger = GuidedFinger()
    finger.guide(0.0, 0.5)
    finger.at(1.0)
    finger.guide(0.0, 0.0)
    Fn = np.array([finger.at(1.0 + k * 1e-3).Fn for k in range(1, 400)])
    assert np.min(Fn[Fn > 0.0]) == pytest.approx(1e-3, rel=0.05)
    assert Fn[-1] == 0.0


def test_a_lifted_guided_finger_comes_down_where_it_is_guided():
    finger = GuidedFinger()
    finger.guide(0.02, 0.0)
    assert finger.at(1e-3) == (0.02, 0.0)
    finger.guide(-0.02, 0.5)
    x, _ = np.array([finger.at(k * 1e-3) for k in range(2, 100)]).T
    assert np.all(x == -0.02)


def test_a_guided_finger_begins_anew_with_a_run_and_at_any_pace():
    one, other = GuidedFinger(), GuidedFinger()
    for finger in (one, other):
        finger.at(5.0)
        finger.guide(0.01, 0.5)
        assert finger.at(0.0) == (0.01, 0.0)
    for k in range(1, 41):
        slow = one.at(k * 1e-3)
    assert other.at(0.04) == pytest.approx(slow, rel=1e-9)


@pytest.mark.parametrize(
    ("x", "Fn", "reason"),
    [(0.039, 0.5, "x 0.039 is outside -0.038..0.038"), (0.0, -0.1, "Fn -0.1 is outside 0..10")],
)
def test_a_guided_finger_stays_on_the_plate(x, Fn, reason):
    finger = GuidedFinger()
    with pytest.raises(ValueError, match=re.escape(reason)):
        finger.guide(x, Fn)
    assert finger.at(1.0) == (0.0, 0.0)


def test_a_guided_finger_is_the_same_when_asked_twice():
    finger = GuidedFinger()
    finger.guide(0.01, 0.5)
    for _ in range(3):
        assert finger.at(0.03).Fn == finger.at(0.03).Fn > 0.1
