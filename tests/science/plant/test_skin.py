"""The skin beside its equations, and beside what was measured on fingers."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from smarttac_can.science.plant.force_path import Propagator
from smarttac_can.science.plant.friction import friction_map, sliding_friction
from smarttac_can.science.plant.skin import skin_of, skin_step, slide
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.science.population.fingers import Case, draw_finger

F0 = 43390.0
BARE = 0.2
STEP = 0.25e-3
AT_ONCE = Propagator(0.0, 0.0, 0.0, 0.0)
"""A force path without a lag: behind it is the mean of the friction force."""


def level(subject, W, v, bare=BARE):
    return sliding_friction(friction_map(subject, F0), bare, W, v)[0]


class Finger:
    """Skin and friction of a subject, from rest."""

    def __init__(self, subject):
        self.subject = subject
        self.friction = friction_map(subject, F0)
        self.skin = (0.0, 0.0, 0.0, 0.0)
        """Velocity, stretch, creep and friction force."""

    def slide(self, duration, vibrations, v_bone, bare):
        return [self.ramp(duration, (W, W), v_bone, bare)[0] for W in vibrations]

    def ramp(self, duration, Ws, v_bone, bare=BARE):
        """Slide while the vibration changes at a constant rate; return friction and its mean."""
        step = skin_step(skin_of(self.subject), duration, v_bone)
        W0, W1 = map(complex, Ws)
        ramp = (1.0 + 0j, duration + 0j, 0j, 1.0 + 0j, 0j)
        moving = (W0, (W1 - W0) / duration, Ws[0], *self.skin, 0.0, 0.0)
        moving = slide(1, (ramp, step, AT_ONCE), (bare, 1.0, 0.0, 0.0), self.friction, moving)
        self.skin = moving[3:7]
        return self.skin[3], moving[7]

    @property
    def v(self):
        return self.skin[0]

    @property
    def stretch(self):
        return self.skin[1]


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_steady_slide(direction):
    subject = SUBJECTS[1]
    skin = Finger(subject)
    Ft = skin.slide(STEP, [1e-6] * 1000, direction * 0.05, BARE)[-1]
    assert skin.v == pytest.approx(direction * 0.05, rel=1e-9)
    assert Ft == pytest.approx(direction * level(subject, 1e-6, 0.05), rel=1e-9)
    soft = (1.0 + subject.creep_ratio) / subject.skin_stiffness
    assert skin.stretch == pytest.approx(soft * Ft, rel=1e-6)


def test_pre_sliding_is_that_of_dahl():
    """Friction builds up over the relaxation length from rest, and again after a reversal."""
    subject = dataclasses.replace(SUBJECTS[0], stribeck=1.0)
    skin, step = Finger(subject), 2e-6
    Ft = 0.0
    for v_bone in (0.05, -0.05):
        before, way = Ft, 0.0
        full = math.copysign(BARE, v_bone)
        for _ in range(5000):
            (Ft,) = skin.slide(step, [0.0], v_bone, BARE)
            if skin.v * v_bone <= 0.0:
                before, way = Ft, 0.0
                continue
            way += abs(skin.v) * step
            expected = full + (before - full) * math.exp(-way / subject.relaxation_length)
            assert Ft == pytest.approx(expected, abs=5e-3 * BARE)
        assert way > 5 * subject.relaxation_length


def response(subject, v, frequency):
    """Return gain and phase by which Ft of a sliding finger follows a swing of F."""
    finger, step = Finger(subject), 1.0 / (40.0 * frequency)
    settled, periods = math.ceil(0.01 / step), 5
    spring = BARE / subject.skin_stiffness
    creep = subject.creep_ratio * spring
    finger.skin = (v, spring + creep, creep, BARE)
    sums = [0j, 0j]
    for number in range(settled + 40 * periods):
        # F is that of the middle of a step, as an electrostatic force holds the finger.
        turned = 2j * math.pi * frequency * step * np.array((number + 0.5, number + 1.0))
        F = BARE * (1.0 + 0.02 * math.sin(turned[0].imag))
        (Ft,) = finger.slide(step, [0.0], v, F)
        if number >= settled:
            sums[0] += F * np.exp(-turned[0])
            sums[1] += Ft * np.exp(-turned[1])
    return sums[1] / sums[0]


def test_cut_off_grows_with_speed_as_measured_on_ten_fingers():
    """By 13.8 Hz per mm/s, first order: arXiv:2505.11162, electrovibration at 20 to 100 mm/s."""
    subject = dataclasses.replace(SUBJECTS[1], stribeck=1.0)
    speeds, cut_offs = np.array([20.0, 40.0, 60.0, 80.0, 100.0]), []
    for speed in speeds:
        for beside in (0.5, 1.0, 2.0):
            followed = response(subject, 1e-3 * speed, beside * 13.8 * speed)
            assert np.degrees(np.angle(followed)) == pytest.approx(
                -math.degrees(math.atan(beside)), abs=3.0
            )
            # The cut-off of the first order that has this gain.
            cut_offs.append(beside * 13.8 * speed / math.sqrt(abs(followed) ** -2.0 - 1.0))
    assert cut_offs == pytest.approx(np.repeat(13.8 * speeds, 3), rel=0.05)
    assert np.polyfit(np.repeat(speeds, 3), cut_offs, 1)[0] == pytest.approx(13.8, rel=0.03)


def released(subject):
    """Return the time in ms in which 95 % of a held stretch are gone under vibration."""
    finger, step = Finger(subject), 1e-4
    finger.slide(step, [0.0] * 1000, 0.03, BARE)
    finger.slide(step, [0.0] * 1000, 0.0, BARE)
    # Not even the rest of a motion helps.
    finger.skin = (0.0, *finger.skin[1:])
    stretch = [finger.stretch]
    for _ in range(2000):
        finger.slide(step, [2.5e-6], 0.0, BARE)
        stretch.append(finger.stretch)
    gone = (stretch[0] - np.array(stretch)) / (stretch[0] - stretch[-1])
    assert gone[-1] == 1.0
    assert stretch[-1] < 0.8 * stretch[0]
    return float(np.argmax(gone >= 0.95) * step * 1e3)


@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda s: s.name)
def test_held_stretch_is_released_within_the_measured_20_ms(subject):
    """doi:10.1098/rsif.2022.0718. Without its slow part it would be gone much sooner."""
    assert released(subject) == pytest.approx(20.0, abs=4.0)
    assert released(dataclasses.replace(subject, creep_ratio=0.0)) < 10.0


def test_agrees_with_the_differential_equations():
    """Against SciPy's Radau over a start from rest, ramps of vibration and a reversal.

    The mean of the friction over a step is that of the integral.
    """
    subject = SUBJECTS[2]
    phases = [
        (0.010, (0.0, 0.2e-6), 0.06), (0.004, (2e-6, 0.5e-6), 0.06),
        (0.004, (0.5e-6, 3e-6), 0.06), (0.012, (0.0, 0.0), -0.06),
    ]  # fmt: skip

    def rates(time, y, duration, W, v_bone):
        stretch, v, creep, Ft, _ = y
        F = level(subject, W[0] + (W[1] - W[0]) * time / duration, abs(v))
        spring = stretch - creep
        pull = subject.skin_stiffness * spring + subject.skin_damping * (v_bone - v)
        excess = max(abs(Ft) - F, 0.0)
        return [
            v_bone - v,
            (pull - Ft) / subject.skin_mass,
            (subject.creep_ratio * spring - creep) / subject.creep_time,
            (v * F - abs(v) * Ft) / subject.relaxation_length
            - math.copysign(excess, Ft) / subject.release_time,
            Ft,
        ]

    def rms_errors(step):
        y = np.zeros(5)
        skin = Finger(subject)
        errors = []
        for duration, W, v_bone in phases:
            times = np.linspace(0, duration, round(duration / step) + 1)
            solution = solve_ivp(
                rates, (0, duration), y, "Radau", times, args=(duration, W, v_bone),
                rtol=1e-9, atol=[1e-12, 1e-9, 1e-12, 1e-9, 1e-13],
            )  # fmt: skip
            means = np.diff(solution.y[4]) / step
            y = solution.y[:, -1]
            Ws = np.interp(times, (0, duration), W).tolist()
            ends = itertools.pairwise(Ws)
            for Ft, mean, ramp in zip(solution.y[3, 1:], means, ends, strict=True):
                errors.append(np.subtract(skin.ramp(step, ramp, v_bone), (Ft, mean)))
        return np.sqrt(np.mean(np.square(errors), axis=0))

    coarse, fine = rms_errors(STEP / 20), rms_errors(STEP / 80)
    assert np.all(coarse < 5e-4 * BARE)
    assert np.all(fine < 0.125 * coarse), "a sixteenth at second order, a quarter at first"


@pytest.mark.parametrize("skin_mass", [0.0, 1e-5, 1e-4])
@pytest.mark.parametrize("duration", [0.02e-3, 0.25e-3, 1e-3, 10e-3])
def test_a_slide_swings_at_no_length_of_a_step(skin_mass, duration):
    """Also where friction rises with speed more steeply than any finger of a campaign has it."""
    subject = dataclasses.replace(
        SUBJECTS[4], skin_mass=skin_mass, skin_damping=0.01, p=4.0, W0=0.3e-6, rho=0.0
    )
    v, W, bare = 0.05, 0.6e-6, 3.0
    F, slope, _ = sliding_friction(friction_map(subject, F0), bare, W, v)
    assert slope > 2.0 * 1e-4 / STEP, "what a step of 0.25 ms with an explicit friction can bear"
    finger = Finger(subject)
    stretch = F / subject.skin_stiffness
    creep = subject.creep_ratio * stretch
    finger.skin = (1.1 * v, stretch + creep, creep, F)
    finger.slide(duration, [W] * (20 + int(0.2 / duration)), v, bare)
    before = finger.v
    finger.slide(duration, [W], v, bare)
    assert finger.v == pytest.approx(before, rel=1e-6)
    assert finger.v == pytest.approx(v, rel=1e-3)


def test_bone_may_start_fast_under_steeply_falling_friction():
    subject = dataclasses.replace(SUBJECTS[0], stribeck=2.0, stribeck_speed=1e-4)
    finger = Finger(subject)
    finger.skin = (6e-5, 0.0, 0.0, 0.5)
    (Ft,) = finger.slide(1e-3, [0.0], 2.0, 0.5)
    assert 0.0 < Ft <= 1.0
    assert 0.0 < finger.v < 5.0


@given(
    subject=st.sampled_from(
        [*SUBJECTS, *(draw_finger(5, number, Case()).subject for number in range(10))]
    ),
    steps=st.lists(
        st.tuples(
            st.floats(1e-6, 1.0), st.floats(0.0, 1e-5), st.floats(-2.0, 2.0), st.floats(0.0, 5.0)
        ),
        min_size=1,
        max_size=40,
    ),
)
@settings(max_examples=100)
def test_friction_is_bounded_at_any_step(subject, steps):
    skin = Finger(subject)
    fastest = max(abs(v_bone) for _, _, v_bone, _ in steps)
    most = 0.0
    for duration, W, v_bone, bare in steps:
        most = max(most, bare * subject.stribeck * (1 + 1e-12)) if bare else 0.0
        Ft, mean = skin.ramp(duration, (W, W), v_bone, bare)
        assert max(abs(Ft), abs(mean)) <= most
        assert math.isfinite(skin.stretch)
        # Stored energy cannot throw the skin faster than some multiple of the bone.
        assert abs(skin.v) <= 4 * fastest + 1e4 * abs(skin.stretch) + 1.0


def test_a_resting_finger_sticks_and_a_lifted_one_slides_free():
    skin = Finger(SUBJECTS[0])
    assert skin.slide(STEP, [1e-6] * 20, 0.0, BARE) == [0.0] * 20
    skin.slide(STEP, [1e-6] * 40, 0.05, BARE)
    assert skin.stretch > 50e-6
    assert skin.slide(STEP, [1e-6] * 400, 0.05, 0.0) == [0.0] * 400
    assert abs(skin.stretch) < 1e-6
