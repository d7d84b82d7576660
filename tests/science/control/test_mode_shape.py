"""The mode shape, and how it is learned from errors that ln mu without vibration follows."""

import math
import random

import pytest

from smarttac_can.science.control.mode_shape import (
    FLAT,
    follow,
    learned,
    regressors,
    restored,
    shape_of,
    share_at,
    unsureness,
)

BY_SHARE = -0.6
"""Change of ln mu with the share of the vibration that acts."""


def learn(c, s, ticks, noise=0.03, gain=0.1, speed=60e-3):
    """Return the shape that a law learns whose m0 follows each error with a gain."""
    rng = random.Random(3)
    shape, followed = FLAT, regressors(FLAT, 0.0, BY_SHARE)
    m0 = BY_SHARE * c
    for tick in range(ticks):
        by = regressors(shape, speed * 1e-3 * tick, BY_SHARE)
        true = by[0] * (c - shape.c) + by[1] * (s - shape.s)
        error = true - m0 + rng.gauss(0.0, noise)
        shape, change = learned(shape, by, followed, error, noise)
        m0 += change + gain * error
        followed = follow(followed, by, gain)
    return shape


def test_share_repeats_with_the_distance_of_the_nodes():
    shape = shape_of(8e-3, 0.1, -0.05)
    assert share_at(shape, 0.0) == pytest.approx(1.1)
    assert share_at(shape, 2e-3) == pytest.approx(0.95)
    assert share_at(shape, 11e-3) == pytest.approx(share_at(shape, 3e-3))
    assert share_at(FLAT, 1.234e-3) == 1.0


@pytest.mark.parametrize(("c", "s"), [(0.1, 0.0), (-0.05, 0.08), (0.0, 0.0)])
def test_shape_is_learned_while_m0_follows(c, s):
    shape = learn(c, s, 3000)
    assert (shape.c, shape.s) == pytest.approx((c, s), abs=0.012)
    unsure = math.sqrt(shape.cc)
    assert 0.001 < unsure < 0.01
    assert abs(shape.c - c) < 3.0 * unsure


def test_nothing_is_learned_at_rest():
    shape = learn(0.1, 0.0, 3000, speed=0.0)
    assert (shape.c, shape.s) == (0.0, 0.0)
    assert (shape.cc, shape.ss) == (FLAT.cc, FLAT.ss)


def test_coefficients_stay_in_their_bounds():
    shape, _ = learned(FLAT, (1e-3, 1e3), (0.0, 0.0), 1e6, 0.01)
    assert (shape.c, shape.s) == (pytest.approx(0.001, abs=0.4), 0.4)


def test_a_stored_shape_replaces_another_but_not_its_origin():
    known = learn(0.1, 0.0, 1000)
    assert restored(known, shape_of(8e-3, round(known.c, 4), round(known.s, 4))) is known
    for stored in (shape_of(8e-3, known.c + 0.01, known.s), shape_of(7e-3, known.c, known.s)):
        assert restored(known, stored) is stored


def test_unsureness_falls_as_the_shape_is_learned():
    by = regressors(FLAT, 1e-3, BY_SHARE)
    assert unsureness(FLAT, by) == pytest.approx(0.6**2 * 0.07**2)
    assert unsureness(learn(0.1, 0.0, 1000), by) < 1e-4
