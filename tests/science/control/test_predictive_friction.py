"""The predictive friction law around a finger that follows the amplitude a tick later."""

import math
import random

import pytest
from first_order_plate import setpoint

from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.friction_map import PRIOR, Plateau, learned, shape, value
from smarttac_can.science.control.mode_shape import FLAT
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.predictive_friction import (
    ANYBODY,
    FROZEN_TICKS,
    NOTHING,
    PATH,
    PLATEAU_TICKS,
    QUIET_TICKS,
    SETTLED_TICKS,
    SPEED_VARIANCE,
    FrictionSample,
    Known,
    Path,
    _taught,
    amplitude_asked,
    begin_map,
    cut_short,
    follow_map,
    gathered,
    path_step,
    tells,
)
from smarttac_can.science.plant.force_path import follow as through_path
from smarttac_can.science.plant.force_path import propagator
from smarttac_can.science.plant.parameters import SensorParameters
from smarttac_can.vocabulary.signals import Measurement
from smarttac_can.vocabulary.states import Law, Mode

STEEP = PRIOR._replace(a=1.5, b=-0.5)
KNOWN = Known(STEEP, shape(STEEP), 1, FLAT)
"""A finger from a pair of levels."""
LOW, HIGH = 0.35, 0.45


class Bench:
    """A finger of a friction map of its own, felt through a force path of 100 Hz.

    A share ``late/(1 + late)`` of its friction follows the rest, by a fifth of the way in a tick.
    """

    def __init__(self, weights=STEEP, mu0=0.6, noise=0.0, known=ANYBODY, speed=0.0, late=0.0):
        self.nodes, self.ln_mu0 = shape(weights), math.log(mu0)
        self.W, self.push, self.noise = 1e-6, 1.0, noise
        self.x, self.speed = 0.0, speed
        self.step = propagator(1e-3, 100.0, 0.7)
        self.late, self.slow = late, value(self.nodes, self.W)
        self.y, self.rate = math.exp(self.slow), 0.0
        self.random = random.Random(5)
        self.touch = begin_map(self.sample(LOW), known)

    @property
    def mu(self):
        return math.exp(self.ln_mu0 + self.felt(self.W))

    def felt(self, W):
        """Return ln mu at an amplitude, relative to that without vibration."""
        return (value(self.nodes, W) + self.late * self.slow) / (1.0 + self.late)

    def sample(self, mu_ref):
        mu = math.exp(self.ln_mu0) * self.y + self.random.gauss(0.0, self.noise)
        force = self.push * mu * 0.5
        return FrictionSample(
            mu, self.noise, force, 0.0, self.W, mu_ref, self.x, self.push * self.speed
        )

    def run(self, ticks, mu_ref):
        """Return the true COF at each tick; mu_ref may be a function of the tick."""
        found = []
        for tick in range(ticks):
            found.append(self.mu)
            self.x += 1e-3 * self.push * self.speed
            self.touch = follow_map(
                self.touch, self.sample(mu_ref(tick) if callable(mu_ref) else mu_ref)
            )
            before = self.felt(self.W)
            self.slow += 0.2 * (before - self.slow)
            self.W = min(max(amplitude_asked(self.touch), 0.0), 3e-6)
            middle = 0.5 * (math.exp(before) + math.exp(self.felt(self.W)))
            self.y, self.rate = through_path(self.step, self.y, self.rate, middle)
        return found

    def turn(self):
        """Slide the other way."""
        self.push = -self.push

    def passes(self, number):
        for _ in range(number):
            for mu_ref in (LOW, HIGH) if self.push > 0.0 else (HIGH, LOW):
                self.run(80, mu_ref)
            self.turn()
        return self


@pytest.mark.parametrize(("frequency", "damping"), [(100.0, 0.7), (60.0, 0.3), (250.0, 0.95)])
def test_the_model_of_the_force_path_is_the_path_of_the_plate(frequency, damping):
    assert path_step(frequency, damping) == pytest.approx(propagator(1e-3, frequency, damping))
    sensors = SensorParameters()
    assert path_step(sensors.path_frequency, sensors.path_damping) == PATH


def test_it_begins_with_the_amplitude_there_is():
    bench = Bench()
    assert amplitude_asked(bench.touch) == pytest.approx(1e-6)
    # Before the first pair the reference is approached slowly.
    bench.run(1, HIGH)
    assert abs(bench.W - 1e-6) < 0.15e-6


def test_touch_starts_settled_and_learns_after_frozen_ticks():
    bench = Bench()
    begun = bench.touch
    assert follow_map(begun, begun.sample).path == pytest.approx(begun.path)
    gains = []
    for _ in range(FROZEN_TICKS + 1):
        bench.run(1, LOW)
        gains.append(bench.touch.gain)
    assert [gain != begun.gain for gain in gains].index(True) == FROZEN_TICKS - 1


def test_a_model_of_the_path_that_rings_below_0_teaches_nothing():
    bench = Bench().passes(1)
    bench.run(60, LOW)
    touch = bench.touch._replace(path=Path(-0.9, 0.0))
    assert follow_map(touch, bench.sample(LOW)).m0 == touch.m0


def test_plateau_is_the_mean_of_its_ticks_and_starts_afresh():
    draw, so_far = random.Random(2), NOTHING
    for made in range(3):
        ticks = [
            (draw.gauss(-1.0, 0.1), draw.uniform(0.97e-6, 1.03e-6)) for _ in range(PLATEAU_TICKS)
        ]
        for ln_mu, W in ticks:
            assert so_far.made == made
            so_far = gathered(so_far, ln_mu, W, -0.9, 0.1)
        means = [sum(column) / PLATEAU_TICKS for column in zip(*ticks, strict=True)]
        assert so_far.made == made + 1
        assert so_far.last == pytest.approx((*means, -0.9), rel=1e-9, abs=0.0)


@pytest.mark.parametrize(
    ("dW", "dm0"), [(0.15e-6, 0.0), (-0.15e-6, 0.0), (0.0, 0.05), (0.0, -0.05)]
)
def test_a_plateau_begins_anew_where_amplitude_or_level_leave_it(dW, dm0):
    so_far = NOTHING
    for _ in range(PLATEAU_TICKS - 1):
        so_far = gathered(so_far, -1.0, 1e-6, -0.9, 0.1)
    kept = gathered(so_far, -1.0, 1e-6 + 0.3 * dW, -0.9, 0.1 + 0.3 * dm0)
    assert (kept.made, kept.ticks) == (1, 0)
    left = gathered(so_far, -1.0, 1e-6 + dW, -0.9, 0.1 + dm0)
    assert (left.made, left.ticks) == (0, 1)
    assert (left.sum_ln, left.sum_W, left.sum_m0) == (-1.0, 1e-6 + dW, 0.1 + dm0)


@pytest.mark.parametrize("turned", [True, False])
def test_plateau_cut_short_leaves_no_sample(turned):
    so_far = NOTHING
    for _ in range(PLATEAU_TICKS + 7):
        so_far = gathered(so_far, -1.3, 1e-6, -0.9, 0.1)
    last, so_far = so_far.last, cut_short(so_far, turned)
    assert (so_far.made, so_far.last) == (0 if turned else 1, last)
    for _ in range(PLATEAU_TICKS):
        so_far = gathered(so_far, -0.7, 1.01e-6, -0.5, 0.1)
    assert so_far.made == (1 if turned else 2)
    assert so_far.last == pytest.approx((-0.7, 1.01e-6, -0.5), rel=1e-9, abs=0.0)


def test_step_and_turn_end_a_plateau_and_restart_their_counts():
    bench = Bench().passes(1)
    bench.run(60, LOW)
    for event, counted in ((HIGH, "since_step"), (None, "since_turn")):
        bench.run(SETTLED_TICKS + 5, bench.touch.sample.mu_ref)
        assert bench.touch.gathered.ticks > 0
        if event is None:
            bench.turn()
        bench.run(1, event or bench.touch.sample.mu_ref)
        assert bench.touch.gathered.ticks == 0
        for number in range(5):
            assert getattr(bench.touch, counted) == number
            bench.run(1, bench.touch.sample.mu_ref)


def test_a_finger_that_pulls_by_nothing_has_not_turned():
    bench = Bench()
    bench.run(5, LOW)
    still = follow_map(bench.touch, bench.sample(LOW)._replace(Fx=0.0))
    assert still.since_turn == bench.touch.since_turn + 1


def test_levels_differ_because_they_were_asked_to():
    before = Plateau(-1.0, 1e-6, -0.9)
    assert tells(before, Plateau(-0.7, 0.8e-6, -0.6))
    assert not tells(before, Plateau(-0.7, 0.8e-6, -0.89))
    assert not tells(before, Plateau(-0.7, 0.99e-6, -0.6))


def test_two_levels_are_as_unsure_as_the_means_of_their_ticks():
    sample = FrictionSample(0.4, 0.02, 0.2, 0.0, 1e-6, 0.4, 0.0, 0.0)
    before, after = Plateau(-1.0, 1e-6, -0.9), Plateau(-0.7, 0.7e-6, -0.6)
    of_means = 2.0 * (0.02 / 0.4) ** 2 / PLATEAU_TICKS
    expected = learned(PRIOR, before, after, SPEED_VARIANCE + of_means)
    found = _taught(ANYBODY, before, after, (0.0, 0.0), sample)
    assert found.weights == pytest.approx(expected)
    assert (found.nodes, found.pairs) == (shape(found.weights), 1)


def test_two_levels_of_a_pass_make_a_pair_at_once():
    bench = Bench()
    bench.run(100, LOW)
    bench.turn()
    bench.run(SETTLED_TICKS + PLATEAU_TICKS + 4, LOW)
    assert (bench.touch.gathered.made, bench.touch.known.pairs) == (1, 0)
    bench.run(SETTLED_TICKS + PLATEAU_TICKS + 4, HIGH)
    assert (bench.touch.gathered.made, bench.touch.known.pairs) == (2, 1)


def test_without_a_pair_it_reaches_the_reference_all_the_same():
    assert Bench().run(300, LOW)[-1] == pytest.approx(LOW, rel=1e-3)


@pytest.mark.parametrize(
    ("weights", "mu0"), [(PRIOR, 0.6), (STEEP, 0.6), (PRIOR._replace(a=-1.0, b=0.5), 0.5)]
)
def test_a_learned_step_lands_at_once(weights, mu0):
    bench = Bench(weights, mu0, speed=0.1, late=0.1).passes(6)
    bench.run(80, LOW)
    up = bench.run(80, HIGH)
    step = HIGH - LOW
    assert up[0] == pytest.approx(LOW, abs=0.01 * step)
    assert up[3] == pytest.approx(HIGH, abs=0.03 * step)
    assert max(up) < HIGH + 0.02 * step
    assert up[-1] == pytest.approx(HIGH, abs=0.005 * step)


def test_any_fingers_step_does_not_land_before_it_is_learned():
    knowing, learning = Bench(known=KNOWN, late=0.1), Bench(late=0.1)
    for bench in (knowing, learning):
        bench.run(300, LOW)
    assert knowing.run(4, HIGH)[-1] == pytest.approx(HIGH, rel=0.005)
    assert learning.run(4, HIGH)[-1] < HIGH - 0.3 * (HIGH - LOW)


def test_the_lag_of_the_force_path_is_no_error():
    bench = Bench(known=KNOWN)
    bench.run(200, LOW)
    m0 = []
    for _ in range(15):
        bench.run(1, HIGH)
        m0.append(bench.touch.m0)
    assert max(m0) - min(m0) < 1e-6
    assert m0[-1] == pytest.approx(bench.ln_mu0, abs=1e-3)


def test_sweat_is_regulated_away():
    bench = Bench().passes(2)
    bench.ln_mu0 += 0.08
    assert abs(bench.run(80, LOW)[-1] - LOW) < 0.002 * LOW


def test_nothing_is_learned_after_a_turn():
    bench = Bench().passes(2)
    bench.run(60, LOW)
    bench.turn()
    bench.ln_mu0 -= 1.0  # It sticks.
    bench.run(1, LOW)
    m0 = bench.touch.m0
    bench.run(FROZEN_TICKS - 1, LOW)
    assert bench.touch.m0 == m0
    bench.run(2, LOW)
    assert bench.touch.m0 != m0


def test_a_turn_brings_back_the_finger_that_slid():
    bench = Bench().passes(4)
    bench.run(100, LOW)
    m0, W = bench.touch.m0, bench.W
    for _ in range(60):  # It stops.
        bench.ln_mu0 -= 0.02
        bench.run(1, LOW)
    assert bench.touch.m0 < m0 - 0.3
    assert bench.W == 0.0
    bench.turn()
    bench.ln_mu0 += 1.2
    bench.run(1, LOW)
    assert bench.touch.m0 == pytest.approx(m0, abs=0.01)
    assert abs(bench.W - W) < 0.02 * W


def test_a_turn_before_any_level_leaves_m0():
    bench = Bench()
    bench.run(FROZEN_TICKS + 5, LOW)
    m0 = bench.touch.m0
    bench.turn()
    bench.run(1, LOW)
    assert bench.touch.m0 == m0


def test_a_finger_that_stops_makes_no_level():
    bench = Bench().passes(4)
    bench.run(100, HIGH)
    known = bench.touch.known
    bench.run(10, LOW)
    for _ in range(90):
        bench.ln_mu0 -= 0.02
        bench.run(1, LOW)
    assert bench.W == 0.0  # It rests there, and the friction falls.
    assert bench.touch.known is known


def test_a_map_that_was_learned_flat_does_not_make_it_hunt():
    flat = PRIOR._replace(a=-2.5, b=0.3, c=-0.7)
    bench = Bench(
        PRIOR._replace(a=-1.1), mu0=0.5, noise=0.005, known=Known(flat, shape(flat), 5, FLAT)
    )
    bench.run(300, LOW)
    found = bench.run(300, LOW)
    assert max(found) - min(found) < 0.2 * LOW


def test_a_step_makes_m0_of_a_finger_that_is_known_quiet():
    def answer(ticks_before, pairs=1):
        """By how much m0 that is off follows in a tick."""
        bench = Bench(known=KNOWN)
        bench.run(300, LOW)
        bench.run(ticks_before, HIGH)
        known = bench.touch.known._replace(pairs=pairs)
        off = bench.touch._replace(m0=bench.touch.m0 + 0.01, known=known)
        return abs(follow_map(off, bench.sample(HIGH)).m0 - off.m0)

    assert answer(1) < 0.3 * answer(QUIET_TICKS + 1)
    assert answer(1) < 0.5 * answer(1, pairs=0)


def test_levels_of_two_passes_make_no_pair():
    bench = Bench()
    bench.run(100, LOW)
    bench.turn()
    bench.run(100, HIGH)
    assert bench.touch.known.pairs == 0
    bench.run(SETTLED_TICKS + 25, LOW)
    assert bench.touch.known.pairs == 1


def test_it_does_not_learn_from_its_own_noise():
    bench = Bench(noise=0.05)
    levels = set()
    for _ in range(2000):
        bench.run(1, LOW)
        levels.add(bench.touch.gathered.last.W)
    assert max(levels - {0.0}) - min(levels - {0.0}) > 0.1e-6
    assert bench.touch.known.pairs == 0


@pytest.mark.parametrize("noise", [0.0, 0.011])
def test_references_on_a_stair_teach_the_whole_map(noise):
    bench = Bench(noise=noise)
    stair = (0.5, 0.44, 0.38, 0.33, 0.29)
    for _ in range(6):
        for mu_ref in (*stair, *stair[::-1]):
            bench.run(60, mu_ref)
        bench.turn()
        bench.run(40, stair[0])
    nodes = bench.touch.known.nodes
    for low, high in ((0.5e-6, 1e-6), (0.75e-6, 1.25e-6)):
        true = value(bench.nodes, high) - value(bench.nodes, low)
        found = value(nodes, high) - value(nodes, low)
        assert found == pytest.approx(true, rel=0.12)


def test_a_ramp_of_the_reference_is_followed():
    bench = Bench().passes(4)
    bench.run(80, LOW)

    def ramp(tick):
        return LOW + (HIGH - LOW) * tick / 50

    found = bench.run(50, ramp)
    late = [abs(mu - ramp(tick)) for tick, mu in enumerate(found)]
    # One tick of the plate and a little of the pole: 1.1 ticks of 0.002.
    assert max(late) < 0.004


def test_amplitude_for_unreachable_friction_is_below_0():
    bench = Bench()
    bench.run(300, 0.7)
    assert bench.W == 0.0
    assert amplitude_asked(bench.touch) < 0.0
    assert bench.run(200, LOW)[-1] == pytest.approx(LOW, rel=1e-3)


@pytest.mark.parametrize("mu", [0.0, 1e-9, 50.0])
def test_absurd_friction_leaves_numbers(mu):
    bench = Bench().passes(1)
    for tick in range(500):
        sample = FrictionSample(mu, 0.01, (-1.0) ** (tick // 200), 0.0, 1e-6, LOW, 0.0, 0.0)
        bench.touch = follow_map(bench.touch, sample)
        assert math.isfinite(amplitude_asked(bench.touch))


def test_learned_map_alone_outlasts_the_touch():
    cascade = Cascade(CascadeParameters(law=Law.PREDICTIVE))
    cascade.set_mode(Mode.FRICTION)

    def sample(Fn):
        forces = (0.4 * Fn, 0.0, *(0.25 * Fn,) * 4)
        target = setpoint(mu_left=LOW, mu_right=LOW)
        cascade.update(Measurement(1.2e-6 + 0j, forces, 20.0, 0), target)
        return cascade.state

    sliding = sample(0.5).sliding
    known = Known(STEEP, shape(STEEP), 7, FLAT)
    cascade._state = cascade.state._replace(sliding=sliding._replace(known=known, m0=-9.0))
    assert not sample(0.0).slides
    state = sample(0.5)
    assert (state.slides, state.W_ref) == (True, pytest.approx(1.2e-6))
    assert state.sliding.known.pairs == 7
    assert state.sliding.m0 == pytest.approx(math.log(0.4) - value(shape(STEEP), 1.2e-6))


@pytest.mark.parametrize("steepness", [0.4, 2.0, 4.5])
def test_finger_of_another_slope_does_not_ring(steepness):
    bench = Bench(PRIOR, mu0=0.5, known=Known(PRIOR, shape(PRIOR), 1, FLAT))
    bench.nodes = tuple(steepness * h for h in bench.nodes)
    bench.run(300, HIGH)
    found = bench.run(300, 0.43)
    assert found[-1] == pytest.approx(0.43, rel=1e-3)
    assert max(found[-50:]) - min(found[-50:]) < 1e-4


def test_amplitude_is_held_until_sliding_then_friction_counts():
    bench = Bench()
    bench.ln_mu0 -= 3.0  # It rests, and hardly pulls.
    bench.touch = begin_map(bench.sample(LOW), ANYBODY)
    for _ in range(100):
        bench.push = -bench.push
        bench.run(1, LOW)
        assert abs(bench.W - 1e-6) < 1e-12
    bench.ln_mu0 += 3.0
    bench.run(FROZEN_TICKS - 1, LOW)
    assert abs(bench.W - 1e-6) < 1e-12
    bench.run(1, LOW)
    assert abs(bench.W - 1e-6) < 0.3e-6
    expected = bench.touch.m0 + value(bench.touch.known.nodes, 1e-6)
    assert expected == pytest.approx(bench.ln_mu0 + value(bench.nodes, 1e-6), abs=0.02)
    assert bench.run(60, LOW)[-1] == pytest.approx(LOW, rel=0.01)
