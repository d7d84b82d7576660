"""Mode TEXTURE: the line of the finger, the reference ahead of it, and its C_mu.

The line has no lag, less noise the longer it holds, and a short memory at a turn.
"""

import cmath
import math
import random
from itertools import pairwise

import numpy as np
import pytest

from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.design import Inverse
from smarttac_can.science.control.friction_map import MEAN, value
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.predictive_friction import (
    FROZEN_TICKS,
    MU_MIN,
    PATH_DAMPING,
    PATH_FREQUENCY,
    FrictionSample,
)
from smarttac_can.science.control.texture import (
    ANYBODY,
    BEHIND_TICKS,
    FLATTEST,
    FORGOTTEN,
    GATE,
    LEVEL_DOUBT,
    LEVEL_DRIFT,
    LONG,
    POSITION_LAG,
    SHORT,
    SKIN_WAY,
    SLOPE,
    STEEPEST,
    STRETCH_KEPT,
    STRETCH_LEAD,
    Line,
    begin_texture,
    cof_ahead,
    follow_texture,
    learned,
    line_from,
    prolonged,
    texture_of,
    through_skin,
)
from smarttac_can.science.control.tribometer import calibration
from smarttac_can.science.plant.finger import Stroke
from smarttac_can.science.plant.force_path import follow, propagator
from smarttac_can.science.plant.friction import bare_friction, friction_map, sliding_friction
from smarttac_can.science.plant.parameters import PlateParameters, SensorParameters
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.skin import skin_of
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.science.population.fingers import CASES, draw_finger
from smarttac_can.vocabulary.signals import TICK, Drive, Setpoint
from smarttac_can.vocabulary.states import Mode
from smarttac_can.vocabulary.textures import Axis, TextureTable

PLACE_NOISE = 0.24e-3
"""Of the centre of pressure of a tick in m, under 1 N."""
SPEED = 0.06


def root_mean_square(values):
    return math.sqrt(sum(value * value for value in values) / len(values))


def followed(places, seed=1, noise=PLACE_NOISE, unsure=PLACE_NOISE):
    """Return the lines through places in m, one a tick."""
    draw = random.Random(seed)
    lines = []
    for place in places:
        measured = place + draw.gauss(0.0, noise)
        line = prolonged(lines[-1], measured, unsure) if lines else line_from(measured)
        lines.append(line)
    return lines


def test_a_line_begins_at_rest_where_the_finger_is():
    assert line_from(2e-3) == Line(2e-3, 0.0, 1.0, 0.0)


def test_steady_speed_is_followed_without_lag_from_sample_two():
    places = [1e-3 + SPEED * TICK * tick for tick in range(500)]
    for line, place in zip(followed(places, noise=0.0)[1:], places[1:], strict=True):
        assert line.position == pytest.approx(place, abs=1e-12)
        assert line.speed == pytest.approx(SPEED)


def test_the_noise_falls_while_the_finger_keeps_its_speed():
    places = [SPEED * TICK * tick for tick in range(400)]
    runs = [followed(places, seed) for seed in range(40)]
    off = [
        root_mean_square([run[tick].position - places[tick] for run in runs]) for tick in (40, 399)
    ]
    # The filter of the tribometer keeps a quarter of the noise: 0.06 mm.
    assert 0.05e-3 < off[0] < 0.11e-3
    assert off[1] < 0.03e-3


def test_a_turn_makes_the_memory_short_and_is_followed():
    there = [SPEED * TICK * tick for tick in range(400)]
    back = [there[-1] - SPEED * TICK * tick for tick in range(1, 200)]
    runs = [followed(there + back, seed) for seed in range(20)]
    assert all(run[399].samples > 300 for run in runs)
    assert all(min(line.samples for line in run[400:440]) == SHORT for run in runs)
    late = [run[520].position - back[120] for run in runs]
    assert root_mean_square(late) < 0.08e-3


def test_position_memory_is_bounded_and_shrinks_without_noise():
    places = [SPEED * TICK * tick for tick in range(600)]
    assert followed(places)[-1].samples == LONG
    assert followed(places, unsure=0.0)[-1].samples <= SHORT + 1.0


@pytest.mark.parametrize("samples", [1.0, 5.0, SHORT - 1.0])
def test_a_young_line_grows_by_a_sample_however_it_bends(samples):
    assert prolonged(Line(0.0, 0.0, samples, 1.0), 1.0, 1e-4).samples == samples + 1.0


def test_lag_of_the_force_path_is_compensated_at_steady_speed():
    sensors = SensorParameters()
    phi = propagator(TICK, sensors.path_frequency, sensors.path_damping)
    texture = texture_of(TextureTable(Axis.POSITION, False, 0, 10_000_000, (3000, 9000)))
    y = rate = 0.0
    for tick in range(100):
        y, rate = follow(phi, y, rate, SPEED * TICK * (tick + 0.5))
    place = 100 * TICK * SPEED
    found = cof_ahead(texture, 0, y, SPEED, 0.0)
    assert found - 0.3 == pytest.approx(0.6 * place / 10e-3, rel=1e-3)


@pytest.mark.parametrize("repeats", [True, False])
@pytest.mark.parametrize("axis", list(Axis))
def test_texture_reference_follows_position_or_time(axis, repeats):
    table = TextureTable(axis, repeats, 0, 1_000_000, (3000, 4000, 3500, 4200))
    texture = texture_of(table)
    for share in (0.0, 0.3, 1.6, 2.9, 3.4):
        ticks, place = (round(share * 1e3), 0.0) if axis is Axis.TIME else (7, share * 1e-3)
        assert cof_ahead(texture, ticks, place, 0.0, 0.0) == pytest.approx(table.at(share * 1e6))
        # A preview is the place at that time.
        ahead = cof_ahead(texture, ticks, place, SPEED, 0.01)
        way = 10_000.0 if axis is Axis.TIME else SPEED * (0.01 + POSITION_LAG) * 1e9
        assert ahead == pytest.approx(table.at(share * 1e6 + way))


M0 = math.log(0.6)
W_MAX = 3e-6
AT_ONCE = Inverse(1.0, 0.0, 0.0, 0.0)
VARIANCE = 8e-4
LN_NOISE = 0.02
"""Of ln mu in a tick."""


def followed_on(touch, sample, speed=SPEED, inverse=AT_ONCE):
    """Return the state of the law a tick later, for a plate without a lag."""
    return follow_texture(touch, sample, speed, W_MAX, inverse)


PARTS = 10
FINE = propagator(TICK / PARTS, PATH_FREQUENCY, PATH_DAMPING)


class Finger:
    """ln mu = m0 + s h(W) after stretch and force path; it vibrates as asked a tick before."""

    def __init__(self, s, m0=M0, noise=LN_NOISE, seed=1):
        self.s, self.m0, self.noise = s, m0, noise
        self.way = 1.0
        self.W = 1e-6
        self.y = self.slow = self.felt = value(MEAN, self.W)
        self.rate = 0.0
        self._random = random.Random(seed)

    def feel(self, mu_ref):
        h = (value(MEAN, self.W) + STRETCH_LEAD * self.slow) / (1.0 + STRETCH_LEAD)
        self.slow = h + STRETCH_KEPT * (self.slow - h)
        for part in range(PARTS):
            between = self.felt + (part + 0.5) / PARTS * (h - self.felt)
            self.y, self.rate = follow(FINE, self.y, self.rate, between)
        self.felt = h
        ln_mu = self.m0 + self.s * self.y + self._random.gauss(0.0, self.noise)
        mu = math.exp(ln_mu)
        return FrictionSample(mu, self.noise * mu, self.way * mu, 0.0, self.W, mu_ref, 0.0, 0.0)

    def vibrate(self, asked):
        self.W = min(max(asked, 0.0), 3e-6)

    @property
    def mu(self):
        """COF before the force path."""
        h = (value(MEAN, self.W) + STRETCH_LEAD * self.slow) / (1.0 + STRETCH_LEAD)
        return math.exp(self.m0 + self.s * h)


def played(finger, references, known=ANYBODY, speed=SPEED):
    """Return the states of the law in a touch, and the COF in steady state."""
    touches, cofs = [], []
    for mu_ref in references:
        sample = finger.feel(mu_ref)
        touches.append(
            followed_on(touches[-1], sample, speed) if touches else begin_texture(sample, known)
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


def test_amplitude_is_held_until_sliding_then_moves_smoothly():
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
    later = followed_on(begun, begun.sample)
    assert later.path == begun.path


def test_a_finger_that_pulls_by_nothing_has_not_turned():
    touches, _ = played(Finger(1.0), [0.5] * 10)
    resting = touches[-1].sample._replace(Fx=0.0)
    assert followed_on(touches[-1], resting).since_turn == touches[-1].since_turn + 1


@pytest.mark.parametrize(("mu_ref", "W"), [(1.5, 0.0), (0.01, W_MAX)])
def test_unreachable_texture_friction_ends_at_the_limit(mu_ref, W):
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
        last = followed_on(last, sample._replace(mu=0.05))
        finger.vibrate(last.W_ref)
        assert last.known == touches[-1].known, tick
        assert last.lasting == 0.0
    last = followed_on(last, sample._replace(mu=0.05))
    assert last.known != touches[-1].known


@pytest.mark.parametrize("change", [-0.5, 0.5])
def test_another_level_of_friction_is_found_again(change):
    finger = Finger(1.0)
    touches, _ = played(finger, grating(500))
    finger.m0 += change
    last = touches[-1]
    for _ in range(300):
        last = followed_on(last, finger.feel(0.45))
        finger.vibrate(last.W_ref)
    assert last.known.m0 == pytest.approx(M0 + change, abs=0.05)


@pytest.mark.parametrize("error", [-1e3, 1e3])
def test_no_errors_make_the_map_turn_round(error):
    known = ANYBODY
    for tick in range(500):
        known = learned(known, -0.3 - 0.2 * (tick % 2), error, VARIANCE, 0.0)
    assert FLATTEST <= known.s <= STEEPEST
    assert known.mm > 0.0
    assert known.ss > 0.0
    assert known.mm * known.ss >= known.ms * known.ms


def test_texture_filter_tick_is_a_bounded_kalman_filter():
    known, x, P = ANYBODY, np.array(ANYBODY[:2]), np.diag([ANYBODY.mm, ANYBODY.ss])
    draw = random.Random(4)
    for tick in range(300):
        h, variance = -draw.uniform(0.05, 0.8), draw.uniform(4e-4, 3e-3)
        doubt = draw.choice((-0.1, 0.1)) if tick % 50 == 0 else 0.0
        error = draw.gauss(0.0, 0.1) + (3.0 if tick % 20 == 0 else 0.0)
        known = learned(known, h, error, variance, doubt)
        # m0 wanders, and s is forgotten.
        P[0, 0] += LEVEL_DRIFT
        P[0, 0] = max(P[0, 0], doubt**2)
        P[0, 1] = P[1, 0] = P[0, 1] * (1.0 - FORGOTTEN)
        P[1, 1] += FORGOTTEN * (ANYBODY.ss - P[1, 1])
        H = np.array([1.0, h])
        spread = H @ P @ H + variance
        most = GATE * math.sqrt(spread)
        x = x + P @ H / spread * min(max(error, -most), most)
        x[1] = min(max(x[1], FLATTEST), STEEPEST)
        P = P - np.outer(P @ H, H @ P) / spread
        assert known == pytest.approx((*x, P[0, 0], P[0, 1], P[1, 1]), rel=1e-9)


def test_map_variance_without_excitation_is_bounded():
    known = ANYBODY
    for _ in range(200_000):
        known = learned(known, -0.3, 0.0, VARIANCE, 0.0)
    assert known.ss <= ANYBODY.ss + 1e-12
    assert known.s == 1.0


def test_learned_steepness_outlasts_a_touch_not_the_level():
    finger = Finger(1.8)
    touches, _ = played(finger, grating(1000))
    before = touches[-1].known
    finger.m0 += 0.3
    touches, _ = played(finger, grating(FROZEN_TICKS + 1), before)
    after = touches[-1].known
    assert after.s == before.s
    assert after.m0 == pytest.approx(M0 + 0.3, abs=0.1)


def test_plate_that_does_not_follow_is_driven_by_the_error():
    finger = Finger(1.0)
    touches, _ = played(finger, grating(500))
    last = touches[-1]
    behind_before, known = 0, last.known
    for tick in range(BEHIND_TICKS + 20):
        # A pick-up that reads 0.4 of the vibration, whose friction is as asked for.
        sample = FrictionSample(0.4 * 1.02, 0.004, 0.4, 0.0, 0.4e-6, 0.4, 0.0, 0.0)
        last = followed_on(last, sample)
        if 1 <= behind_before <= BEHIND_TICKS:
            assert last.known == known
            assert last.lasting == 0.0
        if 4 < tick < BEHIND_TICKS:
            assert last.W_map > 1e-6
            assert last.W_ref == pytest.approx(0.4e-6 + SLOPE * 2.0)
            assert last.known == known
        behind_before, known = last.lag_ticks, last.known
    assert last.known != touches[-1].known
    last = followed_on(last, sample._replace(W=last.W_map))
    assert (last.lag_ticks, last.W_ref) == (0, last.W_map)


def test_an_error_that_lasts_is_of_the_level_not_of_the_steepness():
    known = ANYBODY._replace(mm=1e-4, ss=0.01)
    sure = learned(known, -0.3, 0.1, VARIANCE, 0.0)
    lasting = learned(known, -0.3, 0.1, VARIANCE, LEVEL_DOUBT * 0.1)
    assert lasting.m0 > 0.09 > sure.m0
    assert abs(lasting.s - 1.0) < 0.1 * abs(sure.s - 1.0)


@pytest.mark.parametrize("speed", [0.01, 0.06])
def test_lag_of_the_skin_has_its_cutoff_by_speed(speed):
    lag = SKIN_WAY / speed
    hertz = speed * 13.8e3
    skin, before, found = 0.0, 0.0, []
    for tick in range(1, 4001):
        # Twentieths of a ms, of which the ramps are short beside the period.
        after = math.sin(2.0 * math.pi * hertz * tick * 5e-5)
        skin = through_skin(skin, before, after, 20.0 * lag)
        before = after
        found.append(skin)
    assert max(found[2000:]) == pytest.approx(math.sqrt(0.5), rel=0.02)


def test_steepness_by_a_sine_of_172_hz_has_no_bias():
    finger = Finger(0.8, noise=0.002)
    sines = [0.45 + 0.05 * math.sin(2.0 * math.pi * 0.172 * tick) for tick in range(2000)]
    touch = played(finger, sines, speed=1.0)[0][-1]
    assert touch.known.s == pytest.approx(0.8, rel=0.08)


def test_stretch_is_that_of_a_mean_finger():
    fingers = [draw_finger(1, number, CASES["nominal"]) for number in range(60)]
    for hertz in (50.0, 100.0, 172.0):
        s = 2j * math.pi * hertz
        falls = []
        for finger in fingers:
            skin = skin_of(finger.subject)
            friction = friction_map(finger.subject, 43390.0)
            middle = 0.5 * (finger.mu_left + finger.mu_right)
            slides = [
                sliding_friction(friction, bare_friction(friction, 1.0, 0.0), nm * 1e-9, SPEED)
                for nm in range(0, 3000, 50)
            ]
            per_v = min(slides, key=lambda each: abs(each[0] - middle))[1]
            creep = 1.0 + skin.creep_ratio / (1.0 + skin.creep_time * s)
            held = skin.mass * s + skin.b + skin.k / (s * creep)
            falls.append(1.0 / (1.0 + per_v / held))
        z = cmath.exp(s * TICK)
        lead = 1.0 + STRETCH_LEAD * (z - 1.0) / (z - STRETCH_KEPT)
        assert abs(lead * sum(falls) / len(falls)) == pytest.approx(1.0, abs=0.04)


def sine(hertz, seed, ticks=1500):
    """Play a sine of subject 2 over time, with the PIs and the dead time of a bus.

    Return what was learned in 1.2 s of sliding, and the gain in phase in the first pass.
    """
    step = round(1e4 / hertz)
    values = [round(3500 + 500 * math.sin(0.02 * math.pi * n)) for n in range(100)]
    parameters = PlateParameters()
    stroke = Stroke(1.0, SPEED, 0.05, force_variation=0.0, speed_variation=0.0, seed=seed)
    plate = Plate(parameters, SUBJECTS[1], stroke, seed=seed, dead_time=540e-6)
    lateral = calibration(parameters.sensors.crosstalk)
    cascade = Cascade(CascadeParameters(dead_time=540e-6, lateral=lateral))
    cascade.play(texture_of(TextureTable(Axis.TIME, True, 0, step, tuple(values))))
    old, cofs, phases = Drive(0.0, 43390.0), [], []
    for tick in range(ticks):
        if tick == 100:
            cascade.zero = cascade.null()
            cascade.set_mode(Mode.TEXTURE)
        drive = cascade.update(plate.sample(), Setpoint(0.0, 43390.0, 1e-6, 0.35, 0.35, 0.0))
        cofs.append(plate.mu_true)
        phases.append(2.0 * math.pi * (tick - 100) * 10.0 / step)
        plate.step(old, drive)
        old = drive
    kept = slice(550, 1050)
    basis = np.column_stack((np.sin(phases), np.cos(phases), np.ones(ticks)))[kept]
    gain = np.linalg.lstsq(basis, np.array(cofs)[kept], rcond=None)[0][0] / 0.05
    return cascade.state.playing.touch.known, gain


@pytest.mark.parametrize("seed", [1, 2])
def test_steepness_by_a_fast_texture_is_within_uncertainty(seed):
    slow, _ = sine(10, seed)
    fast, _ = sine(172, seed)
    assert abs(fast.s - slow.s) < 2.5 * math.sqrt(fast.ss + slow.ss)
    assert fast.ss > 2.0 * slow.ss


def test_gain_at_100_hz_with_a_dead_time_is_above_085():
    _, gain = sine(100, 1)
    assert 0.85 < gain < 1.1
