"""C_mu of mode TEXTURE: what it learns of a finger while a texture plays, and what it asks for."""

import math
import random
from itertools import pairwise

import numpy as np
import pytest

from smarttac_can.control.friction_map import MEAN, value
from smarttac_can.control.predictive_friction import FROZEN_TICKS, MU_MIN, PATH, FrictionSample
from smarttac_can.control.texture import (
    ANYBODY,
    BEHIND_TICKS,
    FLATTEST,
    FORGOTTEN,
    GATE,
    LEVEL_DRIFT,
    LOST_VARIANCE,
    MODEL_VARIANCE,
    SLOPE,
    STEEPEST,
    Known,
    begin_texture,
    follow_texture,
    learned,
)

M0 = math.log(0.6)
W_MAX = 3e-6
NOISE = 0.02
"""Of ln mu in a tick."""


class Finger:
    """ln mu = m0 + s h(W) lag_ticks the force path; it vibrates as was asked for a tick before."""

    def __init__(self, s, m0=M0, noise=NOISE, seed=1):
        self.s, self.m0, self.noise = s, m0, noise
        self.way = 1.0
        self.W = self.before = 1e-6
        self.y = value(MEAN, self.W)
        self.rate = 0.0
        self._random = random.Random(seed)

    def feel(self, mu_ref):
        middle = 0.5 * (value(MEAN, self.before) + value(MEAN, self.W))
        away = self.y - middle
        self.y = middle + PATH.yy * away + PATH.yr * self.rate
        self.rate = PATH.ry * away + PATH.rr * self.rate
        ln_mu = self.m0 + self.s * self.y + self._random.gauss(0.0, self.noise)
        mu = math.exp(ln_mu)
        return FrictionSample(mu, self.noise * mu, self.way * mu, 0.0, self.W, mu_ref)

    def vibrate(self, asked):
        self.before, self.W = self.W, min(max(asked, 0.0), 3e-6)

    @property
    def mu(self):
        """COF in the steady state."""
        return math.exp(self.m0 + self.s * value(MEAN, self.W))


def played(finger, references, known=ANYBODY):
    """Return the states of the law in a touch, and the COF in steady state."""
    touches, cofs = [], []
    for mu_ref in references:
        sample = finger.feel(mu_ref)
        touches.append(
            follow_texture(touches[-1], sample, W_MAX) if touches else begin_texture(sample, known)
        )
        finger.vibrate(touches[-1].W_ref)
        cofs.append(finger.mu)
    return touches, cofs


def grating(ticks):
    return [0.50 if tick // 17 % 2 else 0.40 for tick in range(ticks)]


@pytest.mark.parametrize("s", [0.6, 1.0, 1.8])
def test_the_map_is_learned_from_the_texture(s):
    finger = Finger(s)
    touches, cofs = played(finger, grating(1000))
    assert touches[-1].known.m0 == pytest.approx(M0, abs=0.03)
    assert touches[-1].known.s == pytest.approx(s, rel=0.06)
    for tick in range(800, 1000):
        assert cofs[tick] == pytest.approx(grating(1000)[tick], rel=0.03)


def test_the_amplitude_is_held_until_the_finger_is_known_to_slide_and_then_moves_without_a_bump():
    finger = Finger(1.0)
    touches, _ = played(finger, [0.5] * 100)
    assert [touch.W_ref for touch in touches[:FROZEN_TICKS]] == [1e-6] * FROZEN_TICKS
    first = touches[FROZEN_TICKS]
    assert first.slides
    assert first.W_ref == pytest.approx(1e-6, rel=1e-9)
    steps = [abs(after.W_ref - before.W_ref) for before, after in pairwise(touches[20:60])]
    assert max(steps) < 0.1e-6
    assert touches[-1].bump == pytest.approx(0.0, abs=1e-12)


def test_a_touch_begins_settled_and_without_an_error():
    begun = begin_texture(Finger(1.0).feel(0.5), ANYBODY)
    assert (begun.lasting, begun.bump, begun.risen, begun.lag_ticks) == (0.0, 0.0, 0.0, 0)
    later = follow_texture(begun, begun.sample, W_MAX)
    assert later.path == begun.path


def test_a_finger_that_pulls_by_nothing_has_not_turned():
    touches, _ = played(Finger(1.0), [0.5] * 10)
    resting = touches[-1].sample._replace(Fx=0.0)
    assert follow_texture(touches[-1], resting, W_MAX).since_turn == touches[-1].since_turn + 1


@pytest.mark.parametrize(("mu_ref", "W"), [(1.5, 0.0), (0.01, W_MAX)])
def test_what_no_amplitude_reaches_ends_at_the_limit(mu_ref, W):
    touches, _ = played(Finger(1.0), [mu_ref] * 200)
    assert touches[-1].W_map == W


def test_a_finger_that_hardly_pulls_does_not_slide():
    touches, _ = played(Finger(1.0, m0=math.log(0.5 * MU_MIN), noise=0.0), [0.5] * 100)
    assert not any(touch.slides for touch in touches)


def test_nothing_is_learned_where_the_finger_turns():
    finger = Finger(1.0)
    touches, _ = played(finger, grating(200))
    finger.way = -1.0
    last = touches[-1]
    for tick in range(FROZEN_TICKS):
        sample = finger.feel(0.45)
        last = follow_texture(last, sample._replace(mu=0.05), W_MAX)
        finger.vibrate(last.W_ref)
        assert last.known == touches[-1].known, tick
        assert last.lasting == 0.0
    last = follow_texture(last, sample._replace(mu=0.05), W_MAX)
    assert last.known != touches[-1].known


@pytest.mark.parametrize("change", [-0.5, 0.5])
def test_another_level_of_friction_is_found_again(change):
    finger = Finger(1.0)
    touches, _ = played(finger, grating(500))
    finger.m0 += change
    last = touches[-1]
    for _ in range(300):
        last = follow_texture(last, finger.feel(0.45), W_MAX)
        finger.vibrate(last.W_ref)
    assert last.known.m0 == pytest.approx(M0 + change, abs=0.05)


@pytest.mark.parametrize("error", [-1e3, 1e3])
def test_no_errors_make_the_map_turn_round(error):
    known = ANYBODY
    for tick in range(500):
        known = learned(known, -0.3 - 0.2 * (tick % 2), error, 0.02, False)
    assert FLATTEST <= known.s <= STEEPEST
    assert known.mm > 0.0
    assert known.ss > 0.0
    assert known.mm * known.ss >= known.ms * known.ms


def test_a_tick_is_that_of_a_kalman_filter_whose_errors_are_bounded():
    known, x, P = ANYBODY, np.array(ANYBODY[:2]), np.diag([ANYBODY.mm, ANYBODY.ss])
    draw = random.Random(4)
    for tick in range(300):
        h, relative, lost = -draw.uniform(0.05, 0.8), draw.uniform(0.005, 0.05), tick % 50 == 0
        error = draw.gauss(0.0, 0.1) + (3.0 if tick % 20 == 0 else 0.0)
        known = learned(known, h, error, relative, lost)
        # m0 wanders, and s is forgotten.
        P[0, 0] += LEVEL_DRIFT
        P[0, 0] = max(P[0, 0], LOST_VARIANCE) if lost else P[0, 0]
        P[0, 1] = P[1, 0] = P[0, 1] * (1.0 - FORGOTTEN)
        P[1, 1] += FORGOTTEN * (ANYBODY.ss - P[1, 1])
        H = np.array([1.0, h])
        spread = H @ P @ H + relative**2 + MODEL_VARIANCE
        most = GATE * math.sqrt(spread)
        x = x + P @ H / spread * min(max(error, -most), most)
        x[1] = min(max(x[1], FLATTEST), STEEPEST)
        P = P - np.outer(P @ H, H @ P) / spread
        assert known == pytest.approx((*x, P[0, 0], P[0, 1], P[1, 1]), rel=1e-9)


def test_what_is_not_excited_is_not_unlearned_beyond_any_finger():
    known = ANYBODY
    for _ in range(200_000):
        known = learned(known, -0.3, 0.0, 0.02, False)
    assert known.ss <= ANYBODY.ss + 1e-12
    assert known.s == 1.0


def test_what_was_learned_outlives_a_touch_but_not_the_level():
    finger = Finger(1.8)

    def touched(known, ticks):
        touch = None
        for mu_ref in grating(ticks):
            sample = finger.feel(mu_ref)
            touch = (
                begin_texture(sample, known)
                if touch is None
                else follow_texture(touch, sample, W_MAX)
            )
            finger.vibrate(touch.W_ref)
        return touch.known

    before = touched(ANYBODY, 1000)
    finger.m0 += 0.3
    after = touched(before, FROZEN_TICKS + 1)
    assert after.s == before.s
    assert after.m0 == pytest.approx(M0 + 0.3, abs=0.1)
    assert Known(0.0, 1.0, 0.04, 0.0, 0.25) == ANYBODY


def test_a_plate_that_does_not_follow_is_driven_by_the_error_and_teaches_nothing_at_first():
    finger = Finger(1.0)
    touches, _ = played(finger, grating(500))
    last = touches[-1]
    behind_before, known = 0, last.known
    for tick in range(BEHIND_TICKS + 20):
        # A pick-up that reads 0.4 of the vibration, whose friction is as asked for.
        sample = FrictionSample(0.4 * 1.02, 0.004, 0.4, 0.0, 0.4e-6, 0.4)
        last = follow_texture(last, sample, W_MAX)
        if 1 <= behind_before <= BEHIND_TICKS:
            assert last.known == known
            assert last.lasting == 0.0
        if 4 < tick < BEHIND_TICKS:
            assert last.W_map > 1e-6
            assert last.W_ref == pytest.approx(0.4e-6 + SLOPE * 2.0)
            assert last.known == known
        behind_before, known = last.lag_ticks, last.known
    assert last.known != touches[-1].known
    last = follow_texture(last, sample._replace(W=last.W_map), W_MAX)
    assert (last.lag_ticks, last.W_ref) == (0, last.W_map)
