import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from smarttac_can.plant.friction import friction_map, sliding_friction
from smarttac_can.plant.skin import skin_of, skin_step, slide
from smarttac_can.plant.subjects import SUBJECTS
from smarttac_can.population.fingers import Case, draw_finger

F0 = 43390.0
BARE = 0.2
STEP = 0.25e-3


def level(subject, W, v, bare=BARE):
    return sliding_friction(friction_map(subject, F0), bare, W, v)


class Finger:
    """Skin and friction of a subject, from rest."""

    def __init__(self, subject):
        self.subject = subject
        self.v = self.stretch = self.z = 0.0

    def slide(self, duration, vibrations, v_bone, bare):
        step = skin_step(skin_of(self.subject), duration, v_bone, bare)
        forces = []
        for W in vibrations:
            F = level(self.subject, W, abs(self.v), bare)
            self.v, self.stretch, self.z, Ft = slide(step, self.v, self.stretch, self.z, F)
            forces.append(Ft)
        return forces


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
    """Against SciPy's Radau over a start from rest, a step of vibration and a reversal."""
    subject = SUBJECTS[2]
    phases = [(0.010, 0.0, 0.06), (0.010, 2e-6, 0.06), (0.010, 0.5e-6, 0.06), (0.012, 0.0, -0.06)]

    def rates(_, y, W, v_bone):
        stretch, v, z = y
        F = level(subject, W, abs(v))
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
                rates, (0, duration), y, "Radau", times, args=(W, v_bone),
                rtol=1e-9, atol=[1e-12, 1e-9, 1e-9],
            )  # fmt: skip
            y = solution.y[:, -1]
            for _, v, z in solution.y.T[1:].tolist():
                (Ft,) = skin.slide(step, [W], v_bone, BARE)
                errors.append(Ft - level(subject, W, abs(v)) * z)
        return math.sqrt(np.mean(np.square(errors)))

    coarse, fine = rms_error(STEP), rms_error(STEP / 10)
    assert coarse < 0.03 * BARE
    assert fine < 0.3 * coarse


@pytest.mark.parametrize(("share", "swings"), [(0.98, False), (1.02, True)])
@pytest.mark.parametrize("length", [0.05e-3, STEP])
def test_a_friction_that_rises_steeply_with_speed_swings_from_step_to_step(share, swings, length):
    subject = SUBJECTS[1]
    mass, stiffness = subject.skin_mass, subject.skin_stiffness
    bound = 2.0 * mass / length + subject.skin_damping + 0.5 * stiffness * length
    step = skin_step(skin_of(subject), length, 0.05, BARE)
    v, stretch, z = 0.0501, BARE / stiffness, 1.0
    for _ in range(1000):
        F = max(0.0, BARE + share * bound * (abs(v) - 0.05))
        v, stretch, z, _ = slide(step, v, stretch, z, F)
    following, *_ = slide(step, v, stretch, z, max(0.0, BARE + share * bound * (abs(v) - 0.05)))
    assert (abs(following - v) > 1e-3) is swings
    if not swings:
        assert v == pytest.approx(0.05, rel=1e-6)


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
