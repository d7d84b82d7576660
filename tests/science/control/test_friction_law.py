import random
from itertools import pairwise

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from smarttac_can.science.control.friction import (
    asked_amplitude,
    is_right,
    limited_step,
    relative_error,
)
from smarttac_can.vocabulary.states import Law


def step(E):
    return limited_step(slope=0.04e-6, step_max=1e-6, E=E)


def sides(positions, boundary):
    right, found = False, []
    for x in positions:
        right = is_right(right, x, boundary, half=0.5e-3)
        found.append(right)
    return found


def test_equation_8():
    assert relative_error(0.45, 0.3) == pytest.approx(50.0)
    assert relative_error(0.15, 0.3) == pytest.approx(-50.0)


@pytest.mark.parametrize(
    ("E", "dW"),
    [(100.0, 1e-6), (25.0, 1e-6), (10.0, 0.4e-6), (0.0, 0.0), (-10.0, -0.4e-6), (-25.0, -1e-6)],
)
def test_equation_9(E, dW):
    assert step(E) == pytest.approx(dW)


@given(st.floats(allow_nan=False))
@settings(max_examples=50)
def test_equation_9_is_odd_and_bounded(E):
    assert step(-E) == -step(E)
    assert abs(step(E)) <= 1e-6
    assert step(E) * E >= 0.0


@pytest.mark.parametrize(
    ("law", "W_ref"),
    [(Law.MEASURED, 1.4e-6), (Law.ACCUMULATE, 2.4e-6), (Law.NOMINAL, 3.4e-6)],
)
def test_friction_law_adds_its_step_to_its_base(law, W_ref):
    asked = asked_amplitude(law, step(10.0), amplitude=1e-6, W_ref=2e-6, W_nominal=3e-6)
    assert asked == pytest.approx(W_ref)


def test_side_changes_beyond_the_band_only():
    found = sides((0.0, 0.0104, 0.0106, 0.0096, 0.0104, 0.0094), 0.01)
    assert found == [False, False, True, True, True, False]


@given(half=st.floats(0.0, 1.0), share=st.floats(-1.0, 1.0), right=st.booleans())
@settings(max_examples=50)
@example(half=0.5, share=1.0, right=False)
@example(half=0.5, share=-1.0, right=True)
def test_within_the_band_and_at_its_edges_the_side_stays(half, share, right):
    assert is_right(right, share * half, 0.0, half) == right


def test_noise_within_the_band_crosses_once():
    noise = random.Random(1)
    found = sides([i * 2e-5 - 5e-3 + noise.uniform(-4e-4, 4e-4) for i in range(500)], 0.0)
    assert sum(a != b for a, b in pairwise(found)) == 1
