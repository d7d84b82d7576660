import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from smarttac_can.science.plant.friction import friction_map, sliding_friction
from smarttac_can.science.plant.skin import skin_of, skin_step, slide
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.science.population.fingers import Case, draw_finger

F0 = 43390.0
BARE = 0.2
STEP = 0.25e-3


def level(subject, W, v, bare=BARE):
    return sliding_friction(friction_map(subject, F0), bare, W, v)[0]


class Finger:
    """Skin and friction of a subject, from rest."""

    def __init__(self, subject):
        self.subject = subject
        self.friction = friction_map(subject, F0)
        self.skin = (0.0, 0.0, 0.0, 0.0)

    def slide(self, duration, vibrations, v_bone, bare):
        step = skin_step(skin_of(self.subject), duration, v_bone)
        forces = []
        for W in vibrations:
            self.skin = slide(step, self.friction, bare, (W, W), self.skin)
            forces.append(self.skin[3])
        return forces

    def ramp(self, duration, Ws, v_bone):
        """Slide while the vibration changes at a constant rate, and return the friction."""
        step = skin_step(skin_of(self.subject), duration, v_bone)
        self.skin = slide(step, self.friction, BARE, Ws, self.skin)
        return self.skin[3]

    @property
    def v(self):
        return self.skin[0]

    @property
    def stretch(self):
        return self.skin[1]

    @property
    def z(self):
        return self.skin[2]


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_steady_slide(direction):
    subject = SUBJECTS[1]
    skin = Finger(subject)
    Ft = skin.slide(STEP, [1e-6] * 400, direction * 0.05, BARE)[-1]
    assert skin.v == pytest.approx(direction * 0.05, rel=1e-9)
    assert Ft == pytest.approx(direction * level(subject, 1e-6, 0.05), rel=1e-9)
    assert skin.stretch == pytest.approx(Ft / subject.skin_stiffness, rel=1e-6)


def test_friction_builds_up_over_the_relaxation_length():
    subject = SUBJECTS[0]
    skin = Finger(subject)
    way, last = 0.0, 0.0
    while way < subject.relaxation_length:
        last = skin.z
        skin.slide(2e-6, [0.0], 0.05, BARE)
        way += skin.v * 2e-6
    assert last == pytest.approx(1 - math.exp(-1), abs=0.01)


def test_agrees_with_the_differential_equations():
    """Against SciPy's Radau over a start from rest, ramps of vibration and a reversal."""
    subject = SUBJECTS[2]
    phases = [
        (0.010, (0.0, 0.2e-6), 0.06), (0.004, (2e-6, 0.5e-6), 0.06),
        (0.004, (0.5e-6, 3e-6), 0.06), (0.012, (0.0, 0.0), -0.06),
    ]  # fmt: skip

    def rates(time, y, duration, W, v_bone):
        stretch, v, z = y
        F = level(subject, W[0] + (W[1] - W[0]) * time / duration, abs(v))
        pull = subject.skin_stiffness * stretch + subject.skin_damping * (v_bone - v)
        return [
            v_bone - v,
            (pull - F * z) / subject.skin_mass,
            (v - abs(v) * z) / subject.relaxation_length,
        ]

    def rms_error(step):
        y = np.zeros(3)
        skin = Finger(subject)
        errors = []
        for duration, W, v_bone in phases:
            times = np.linspace(0, duration, round(duration / step) + 1)
            solution = solve_ivp(
                rates, (0, duration), y, "Radau", times, args=(duration, W, v_bone),
                rtol=1e-9, atol=[1e-12, 1e-9, 1e-9],
            )  # fmt: skip
            y = solution.y[:, -1]
            Ws = np.interp(times, (0, duration), W).tolist()
            ends = itertools.pairwise(Ws)
            for (_, v, z), ramp in zip(solution.y.T[1:].tolist(), ends, strict=True):
                Ft = skin.ramp(step, ramp, v_bone)
                errors.append(Ft - level(subject, ramp[1], abs(v)) * z)
        return math.sqrt(np.mean(np.square(errors)))

    coarse, fine = rms_error(STEP / 20), rms_error(STEP / 80)
    assert coarse < 5e-4 * BARE
    assert fine < 0.125 * coarse, "a sixteenth at second order, a quarter at first"


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
    finger.skin = (1.1 * v, F / subject.skin_stiffness, 1.0, F)
    finger.slide(duration, [W] * (20 + int(0.2 / duration)), v, bare)
    before = finger.v
    finger.slide(duration, [W], v, bare)
    assert finger.v == pytest.approx(before, rel=1e-6)
    assert finger.v == pytest.approx(v, rel=1e-3)


def test_bone_may_start_fast_under_steeply_falling_friction():
    subject = dataclasses.replace(SUBJECTS[0], stribeck=2.0, stribeck_speed=1e-4)
    finger = Finger(subject)
    finger.skin = (6e-5, 0.0, 1.0, 0.5)
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
    for duration, W, v_bone, bare in steps:
        (Ft,) = skin.slide(duration, [W], v_bone, bare)
        assert abs(Ft) <= bare * subject.stribeck * (1 + 1e-12)
        assert abs(skin.z) <= 1.0 + 1e-12
        assert math.isfinite(skin.stretch)
        # Stored energy cannot throw the skin faster than some multiple of the bone.
        assert abs(skin.v) <= 4 * fastest + 1e4 * abs(skin.stretch) + 1.0


def test_a_resting_finger_sticks_and_a_lifted_one_slides_free():
    skin = Finger(SUBJECTS[0])
    assert skin.slide(STEP, [1e-6] * 20, 0.0, BARE) == [0.0] * 20
    skin.slide(STEP, [1e-6] * 40, 0.05, BARE)
    assert skin.stretch > 50e-6
    assert skin.slide(STEP, [1e-6] * 80, 0.05, 0.0) == [0.0] * 80
    assert abs(skin.stretch) < 1e-6
    assert skin.z == 0.0
