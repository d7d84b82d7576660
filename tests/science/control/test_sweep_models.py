"""Models of two sweeps: growth with the amplitude, bent lines, and two modes, each alone."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.science.control.sweep_models import (
    FIT_STEPS,
    Point,
    growths,
    inverses,
    is_bent,
    modes_of,
    next_fit,
    noise_of,
    unexplained_by,
    without,
)
from smarttac_can.vocabulary.model import PlateModel

MODEL = PlateModel()
T = 2.0 * math.pi * MODEL.tau
HALF = 1.0 / T
V = 16.0
CHECK = (0, 3, 5, 8, 11, 13, 16)


def response(f, share=0.0, offset=0.0, tau=1.0):
    """Return W/V of a linear plate with a second mode; its tau is relative to the first one's."""
    x = f - MODEL.f0
    first = 1.0 / complex(1.0, T * x)
    return MODEL.gain * (first + share / complex(1.0, tau * T * (x - offset)))


def swept(of, voltage=V, which=range(17), noise=0.0, seed=1):
    """Return a sweep of one half bandwidth to each side, with the noise of a point in m."""
    draw = random.Random(seed)
    return [
        Point(
            f,
            voltage,
            of(f, voltage) + complex(draw.gauss(0.0, noise), draw.gauss(0.0, noise)),
            noise,
        )
        for i in which
        for f in (MODEL.f0 + HALF * (i / 8.0 - 1.0),)
    ]


def linear(**second):
    return lambda f, voltage: response(f, **second) * voltage


def growing(losses=0.0, falls=0.0, power=1):
    """Return the steady state of a plate whose losses in 1/m, or fall of f0 in Hz/m, grow."""

    def steady(f, voltage):
        size = MODEL.gain * voltage
        for _ in range(200):
            a = size**power
            W = MODEL.gain * voltage / complex(1.0 + losses * a, T * (f - MODEL.f0 + falls * a))
            size = 0.5 * (size + abs(W))
        return W

    return steady


def both(of, noise=0.0):
    """Return y of a sweep, and of its check at half the voltage."""
    first = swept(of, noise=noise)
    check = swept(of, 0.5 * V, CHECK, noise, seed=2)
    assert noise_of(first, check) == pytest.approx(noise)
    return inverses(first, noise), inverses(check, noise)


@pytest.mark.parametrize("noise", [0.0, 0.3e-9])
@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize(
    ("losses", "falls"), [(0.05, 0.0), (0.3, 0.0), (0.0, 10.0), (0.0, 100.0), (0.2, -60.0)]
)
def test_growth_is_that_of_the_plate_and_its_power(losses, falls, power, noise):
    of = growing(losses * 1e6**power, falls * 1e6**power, power)
    full, half = both(of, noise)
    of_losses, of_falls = growths(full, half, 0.0)
    for growth, value in (
        (of_losses, losses / MODEL.gain),
        (of_falls, T * falls / MODEL.gain),
    ):
        # 0.7 Hz or 0.4 % besides, four standard deviations of this noise.
        assert growth.of(1e-6) == pytest.approx(value, rel=0.02, abs=0.004 / MODEL.gain)
        assert growth.power == (power if value else 1)
    assert unexplained_by(of_losses, of_falls, 0.8e-6, len(half)) == 0.0


@given(share=st.floats(-0.3, 0.3), offset=st.floats(-900.0, 900.0), tau=st.floats(0.5, 2.0))
@settings(max_examples=50)
def test_a_linear_plate_has_no_growth_whatever_its_modes(share, offset, tau):
    full, half = both(linear(share=share, offset=offset, tau=tau), 0.3e-9)
    for growth in growths(full, half, 0.0):
        assert growth.value == 0.0


def test_growth_within_what_an_offset_adds_is_none():
    offset = 3e-9
    full, half = both(lambda f, voltage: response(f) * voltage + offset, 0.3e-9)
    assert growths(full, half, 0.0)[0].value
    found = growths(full, half, offset)
    assert [growth.value for growth in found] == [0.0, 0.0]
    assert unexplained_by(*found, 0.8e-6, len(half)) == 0.0


def test_difference_that_no_growth_explains_is_told():
    """A pick-up that reads less of a larger vibration turns no phase, as losses do."""
    full, half = both(lambda f, V: response(f) * V * (1.0 - 0.1e6 * abs(response(f) * V)), 0.3e-9)
    found = unexplained_by(*growths(full, half, 0.0), 0.8e-6, len(half))
    assert found * MODEL.gain == pytest.approx(0.03, abs=0.015)


@pytest.mark.parametrize("power", [1, 2])
def test_sweep_without_its_growth_is_that_of_a_linear_plate(power):
    full, half = both(growing(0.1 * 1e6**power, 60.0 * 1e6**power, power))
    losses, falls = growths(full, half, 0.0)
    for sweep in (full, half):
        for point in without(sweep, losses, falls, T / MODEL.gain):
            assert point.y * response(point.f) == pytest.approx(1.0, abs=2e-4)
    # Losses that are left show.
    kept = without(full, None, falls, T / MODEL.gain)[8]
    assert kept.y.real * MODEL.gain == pytest.approx(1.0 + 0.1 * 0.74**power, abs=0.01)


@pytest.mark.parametrize("reads", [-1, 0, 1])
@pytest.mark.parametrize("seed", range(10))
def test_carrier_of_one_resonance_is_straight_to_any_pickup(reads, seed):
    """A pick-up reads displacement, speed, or acceleration."""

    def at_carrier(f, voltage):
        u = f / MODEL.f0
        return MODEL.gain * voltage * u**reads / complex(1.0, 0.5 * T * (f - MODEL.f0 / u))

    assert not is_bent(inverses(swept(at_carrier, noise=0.3e-9, seed=seed), 0.3e-9), 0.0)


def test_an_offset_bends_the_line_by_what_is_allowed():
    def shifted(f, voltage):
        return response(f) * voltage + 8e-9j

    sweep = inverses(swept(shifted, noise=0.3e-9), 0.3e-9)
    assert is_bent(sweep, 0.0)
    assert not is_bent(sweep, 4e-9)


@pytest.mark.parametrize(
    ("share", "offset", "tau"),
    [
        (0.1, 60.0, 1.0),
        (0.05, -138.0, 1.0),
        (0.02, 300.0, 1.0),
        (0.03, 0.0, 2.0),
        (0.03, 20.0, 0.5),
    ],
)
def test_second_mode_bends_the_line(share, offset, tau):
    of = linear(share=share, offset=offset, tau=tau)
    assert is_bent(inverses(swept(of, noise=0.3e-9), 0.3e-9), 0.25e-9)


def fitted(of, noise):
    sweep = inverses(swept(of, noise=noise), noise)
    fit = None
    for step in range(FIT_STEPS):
        fit = next_fit(sweep, MODEL.gain, fit, step)
    return modes_of(sweep, MODEL.gain, fit)


@pytest.mark.parametrize("tau", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("offset", [-300.0, 138.0, 250.0])
@pytest.mark.parametrize("share", [0.05, 0.3])
def test_two_modes_are_told_apart_whatever_the_second_ones_tau(share, offset, tau):
    modes = fitted(linear(share=share, offset=offset, tau=tau), 0.1e-9)
    assert modes.gain == pytest.approx(MODEL.gain, rel=0.015)
    assert modes.tau == pytest.approx(MODEL.tau, rel=0.01)
    assert modes.f0 == pytest.approx(MODEL.f0, abs=1.5)
    assert modes.share == pytest.approx(share, rel=0.25)
    assert modes.offset == pytest.approx(offset, rel=0.15)


@pytest.mark.parametrize(("share", "offset"), [(0.1, 30.0), (0.05, 60.0), (0.01, 138.0)])
def test_modes_that_noise_does_not_part_are_not_told_apart(share, offset):
    assert fitted(linear(share=share, offset=offset), 0.3e-9) is None


def test_sweep_of_more_than_two_modes_is_not_told_apart():
    def three(f, voltage):
        x = f - MODEL.f0
        third = 0.3 / complex(1.0, 20.0 * T * (x - 100.0))
        return voltage * (response(f, 0.1, -200.0) + MODEL.gain * third)

    assert fitted(three, 0.3e-9) is None


def test_equations_without_a_single_solution_are_an_error():
    # One frequency does not tell four numbers.
    point = inverses(swept(linear()), 0.0)[0]
    with pytest.raises(ArithmeticError):
        next_fit([point, point._replace(f=point.f + 1.0)], MODEL.gain, None, 0)


def test_sweep_of_too_few_points_is_no_line():
    points = inverses(swept(linear()), 0.0)
    assert is_bent(points[:2], 0.0)
    assert is_bent([points[0]] * 3, 0.0)
