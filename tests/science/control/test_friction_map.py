"""The friction map of a finger: its shapes, its inverse, and learning from two levels."""

import math
import random
import runpy
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttac_can.science.control.friction_map import (
    FIRST,
    LAST,
    MEAN,
    PRIOR,
    SECOND,
    SPACING,
    THIRD,
    Plateau,
    amplitude_for,
    learned,
    shape,
    value,
)

weights = st.builds(
    lambda a, b, c: PRIOR._replace(a=a, b=b, c=c),
    *[st.floats(-4.0, 4.0) for _ in range(3)],
)


TOOL = Path(__file__).parents[3] / "tools" / "pages" / "shapes.py"


def test_the_shapes_are_those_of_the_tool(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOL.parent))
    mean, components = runpy.run_path(str(TOOL))["shapes"]()
    for held, found in zip((MEAN, FIRST, SECOND, THIRD), (mean, *components), strict=True):
        np.testing.assert_allclose(held, found, rtol=0.0, atol=5.1e-4)


def test_without_weights_the_shape_is_the_mean():
    assert shape(PRIOR) == MEAN


@given(weights)
def test_no_weights_make_the_map_turn_round_or_flat(w):
    nodes = shape(w)
    for (above, below), (mean_above, mean_below) in zip(
        pairwise(nodes), pairwise(MEAN), strict=True
    ):
        assert above - below >= 0.199 * (mean_above - mean_below)


@given(weights, st.floats(0.0, 3.5e-6))
def test_the_inverse_finds_the_amplitude_again(w, W):
    nodes = shape(w)
    assert amplitude_for(nodes, value(nodes, W)) == pytest.approx(W, abs=1e-15)


@given(weights, st.floats(1e-3, 1.0))
def test_amplitude_for_friction_above_mu0_is_below_0(w, h):
    assert amplitude_for(shape(w), h) < 0.0


def finger(W0, p, rho):
    """ln mu(W)/mu(0) of a finger that no component was made of."""
    return lambda W: math.log(rho + (1.0 - rho) * math.exp(-((W / W0) ** p)))


@pytest.mark.parametrize(
    ("W0", "p", "rho"), [(1.2e-6, 1.2, 0.3), (1.5e-6, 1.9, 0.2), (3.0e-6, 1.1, 0.5)]
)
def test_pairs_of_levels_tell_the_map_between_them(W0, p, rho):
    h = finger(W0, p, rho)
    draw = random.Random(3)
    w = PRIOR
    for _ in range(60):
        one, other = draw.uniform(0.5e-6, 2.0e-6), draw.uniform(0.5e-6, 2.0e-6)
        w = learned(w, Plateau(1.0 + h(one), one, 0.0), Plateau(1.0 + h(other), other, 0.1), 1e-5)
    nodes = shape(w)
    for low, high in ((0.5e-6, 1.0e-6), (1.0e-6, 1.5e-6), (1.5e-6, 2.0e-6)):
        assert value(nodes, high) - value(nodes, low) == pytest.approx(h(high) - h(low), abs=0.015)
    prior = max(abs(value(MEAN, W) - value(MEAN, 0.5e-6) - h(W) + h(0.5e-6)) for W in (1e-6, 2e-6))
    assert prior > 0.05


def test_a_noisier_pair_teaches_less():
    pair = Plateau(-0.5, 1.0e-6, 0.0), Plateau(-1.0, 1.5e-6, 0.1)
    sure, unsure = (learned(PRIOR, *pair, variance) for variance in (1e-5, 1e-2))
    assert sure.a > 2.0 * unsure.a > 0.0
    assert sure.aa < unsure.aa < 1.0


@given(
    st.lists(
        st.tuples(*[st.floats(0.0, 4e-6)] * 2, st.floats(-5.0, 5.0), st.floats(1e-6, 1.0)),
        max_size=30,
    )
)
def test_whatever_is_taught_the_belief_stays_one_of_a_finger(pairs):
    w = PRIOR
    for one, other, fall, variance in pairs:
        w = learned(w, Plateau(0.0, one, 0.0), Plateau(fall, other, 0.1), variance)
        assert all(abs(weight) <= 4.0 for weight in w[:3])
        assert min(w.aa, w.bb, w.cc) > 0.0
        assert max(w.aa, w.bb, w.cc) <= 1.0 + 1e-12
        assert w.aa * w.bb >= w.ab * w.ab - 1e-9


def test_map_components_are_0_at_rest_and_span_the_range():
    assert {len(nodes) for nodes in (MEAN, FIRST, SECOND, THIRD)} == {LAST + 1}
    assert {nodes[0] for nodes in (MEAN, FIRST, SECOND, THIRD)} == {0.0}
    assert round(LAST * SPACING * 1e9) == 3000


def test_a_pair_is_that_of_a_kalman_filter():
    w, P, x = PRIOR, np.eye(3), np.zeros(3)
    pairs = ((0.6e-6, 1.3e-6, -0.3), (1.1e-6, 2.6e-6, -0.6), (0.2e-6, 0.9e-6, -0.2))
    for one, other, fall in pairs:
        w = learned(w, Plateau(0.0, one, 0.0), Plateau(fall, other, 0.1), 1e-3)
        P = 0.98 * P + 0.02 * np.eye(3)
        H = np.array([value(n, other) - value(n, one) for n in (FIRST, SECOND, THIRD)])
        K = P @ H / (H @ P @ H + 1e-3)
        x = x + K * (fall - value(MEAN, other) + value(MEAN, one) - H @ x)
        P = P - np.outer(K, H @ P)
    np.testing.assert_allclose([w.a, w.b, w.c], x, rtol=1e-12)
    found = [w.aa, w.ab, w.ac, w.bb, w.bc, w.cc]
    np.testing.assert_allclose(found, P[np.triu_indices(3)], rtol=1e-9)
