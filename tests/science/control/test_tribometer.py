import math
import random
import statistics
from itertools import pairwise

import numpy as np
import pytest
from first_order_plate import GAUGE_X, gauges, setpoint
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.science.control.budget import UNCALIBRATED, Calibrated
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.science.control.friction import is_right
from smarttac_can.science.control.parameters import CascadeParameters
from smarttac_can.science.control.tribometer import (
    UNTOUCHED,
    Nulls,
    calibration,
    centre_uncertainty,
    contact_of,
    first_of,
    followed,
    gauging_of,
)
from smarttac_can.vocabulary.signals import Contact, Measurement

CROSSTALK = ((1.0, 0.04), (-0.03, 1.02))
NULLS = (0.7, -1.1, 0.3, -0.2, 1.2, -0.9)
SIGMA = 4.3e-3


class Instrument:
    """A tribometer between two ticks."""

    def __init__(self, crosstalk, contact_force, calibrated=UNCALIBRATED):
        self.gauging = gauging_of(calibration(crosstalk), GAUGE_X, SIGMA, contact_force, calibrated)
        self.temperature = 20.0
        self.zero, self.touch, self.nulls = (0.0,) * 6, UNTOUCHED, Nulls()

    def update(self, raw):
        self.nulls.add(raw)
        self.touch, contact, self.centre = contact_of(
            self.gauging, self.zero, self.touch, raw, self.temperature
        )
        return Contact(*contact)


def tribometer(crosstalk=((1.0, 0.0), (0.0, 1.0)), contact_force=0.1):
    return Instrument(crosstalk, contact_force)


def seen_through(crosstalk, forces, nulls=(0.0,) * 6):
    Fx, Fy, *normal = forces
    (xx, xy), (yx, yy) = crosstalk
    raw = (xx * Fx + xy * Fy, yx * Fx + yy * Fy, *normal)
    return tuple(s + n for s, n in zip(raw, nulls, strict=True))


@given(
    Fx=st.floats(-2.0, 2.0),
    Fy=st.floats(-2.0, 2.0),
    Fn=st.floats(0.2, 3.0),
    x=st.floats(-0.02, 0.02),
)
@settings(max_examples=50)
def test_forces_and_position_come_back(Fx, Fy, Fn, x):
    instrument = tribometer(CROSSTALK)
    for _ in range(64):
        instrument.update(NULLS)
    instrument.zero, instrument.touch = instrument.nulls.mean(), UNTOUCHED
    contact = instrument.update(seen_through(CROSSTALK, gauges(Fx, Fy, Fn, x), NULLS))
    assert contact.Fx == pytest.approx(Fx, abs=1e-12)
    assert contact.Fy == pytest.approx(Fy, abs=1e-12)
    assert contact.Fn == pytest.approx(Fn)
    assert contact.mu == pytest.approx(math.hypot(Fx, Fy) / Fn, abs=1e-12)
    assert contact.position == pytest.approx(x, abs=1e-12)
    assert contact.touching


@pytest.mark.parametrize(
    "crosstalk",
    [((1.0, 1.0), (1.0, 1.0)), ((math.nan, 0.0), (0.0, 1.0)), ((0.099, 0.0), (0.0, 1.0))],
)
def test_loads_that_cannot_be_told_apart(crosstalk):
    with pytest.raises(ValueError, match=r"^crosstalk determinant .* is inside -0\.1\.\.0\.1$"):
        calibration(crosstalk)


def test_loads_of_a_tenth_are_told_apart():
    assert calibration(((0.1, 0.0), (0.0, 1.0))) == ((10.0, 0.0), (0.0, 1.0))


@pytest.mark.parametrize("temperature", [math.nan, math.inf, -math.inf, 1e200])
def test_uncertainty_with_a_broken_thermometer_is_finite(temperature):
    for calibrated in (UNCALIBRATED, Calibrated(0.01, 1e-3, 1e-3, 20.0)):
        instrument = Instrument(((1.0, 0.0), (0.0, 1.0)), 0.1, calibrated)
        sound = instrument.update(gauges(Fx=0.2, Fn=0.5))
        instrument.temperature = temperature
        contact = instrument.update(gauges(Fx=0.2, Fn=0.5))
        assert contact.mu == sound.mu
        assert sound.u_mu <= contact.u_mu < 10.0


def test_uncertainty_is_the_spread_of_the_measured_cof():
    noise = random.Random(1)
    instrument = tribometer()
    clean = gauges(Fx=0.2, Fn=0.5)
    contacts = [
        instrument.update(tuple(s + noise.gauss(0.0, SIGMA) for s in clean)) for _ in range(4000)
    ]
    spread = statistics.stdev(contact.mu for contact in contacts)
    assert statistics.fmean(contact.u_mu for contact in contacts) == pytest.approx(spread, rel=0.05)
    assert spread == pytest.approx(0.011, rel=0.05)


def test_cof_is_masked_below_the_contact_force_with_hysteresis():
    instrument = tribometer(contact_force=0.1)
    touching = []
    for Fn in (-0.5, 0.09, 0.11, 0.09, 0.071, 0.069, 0.09, 0.11):
        contact = instrument.update(gauges(Fx=0.05, Fn=Fn))
        touching.append(contact.touching)
        if not contact.touching:
            assert contact.mu == contact.u_mu == contact.speed == 0.0
    assert touching == [False, False, True, True, True, False, False, True]


def test_a_finger_touches_from_the_contact_force_on():
    assert tribometer(contact_force=0.5).update(gauges(Fn=0.5)).touching


def test_position_is_held_until_the_next_touch():
    instrument = tribometer()
    assert instrument.update(gauges(Fn=0.0)).position == 0.0
    for _ in range(100):
        instrument.update(gauges(Fn=0.5, x=4e-3))
    lifted = instrument.update(gauges(Fn=0.0))
    assert lifted.position == pytest.approx(4e-3)
    # The next touch has nothing to do with the last.
    touch = instrument.update(gauges(Fn=0.5, x=-4e-3))
    assert touch.position == pytest.approx(-4e-3)
    assert touch.speed == 0.0


def test_tare_needs_64_samples():
    nulls = Nulls()
    for _ in range(63):
        nulls.add(NULLS)
    with pytest.raises(RuntimeError, match=r"^a tare needs 64 samples, 63 were seen$"):
        nulls.mean()
    nulls.add(NULLS)
    assert nulls.mean() == pytest.approx(NULLS)


@pytest.mark.parametrize("seen", [64, 65, 100, 128, 129, 200])
def test_tare_is_the_mean_of_the_last_64_raw_samples(seen):
    nulls = Nulls()
    for i in range(seen):
        nulls.add((i / 256.0, *NULLS[1:]))
    assert nulls.mean()[0] == pytest.approx(statistics.fmean(range(seen - 64, seen)) / 256.0)


def seen(cascade, raw):
    cascade.update(Measurement(0j, raw, 20.0, 0), setpoint())
    return cascade.contact


def test_another_zero_ends_the_touch_and_the_same_does_not():
    cascade = Cascade(CascadeParameters(contact_force=0.1))
    assert not cascade.tared
    cascade.zero = NULLS
    assert cascade.tared
    assert seen(cascade, NULLS)[:3] == (0.0, 0.0, 0.0)
    pressed = tuple(n + s for n, s in zip(NULLS, gauges(Fn=0.09), strict=True))
    seen(cascade, tuple(n + s for n, s in zip(NULLS, gauges(Fn=0.2), strict=True)))
    cascade.zero = NULLS
    assert seen(cascade, pressed).touching
    cascade.zero = (0.0, *NULLS[1:])
    assert not seen(cascade, pressed).touching


def test_an_absurd_zero_is_refused():
    cascade = Cascade()
    with pytest.raises(ValueError, match=r"^zero of S3 20.5 is outside -20\.\.20$"):
        cascade.zero = (0.0, 0.0, 20.5, 0.0, 0.0, 0.0)
    assert cascade.zero == (0.0,) * 6
    for most in (20.0, -20.0):
        cascade.zero = (most,) * 6
        assert cascade.zero == (most,) * 6


@pytest.mark.parametrize("speed", [-0.2, 0.05])
def test_steady_speed_is_followed_without_lag(speed):
    line = first_of(0.01)
    for k in range(1, 200):
        line = followed(line, 0.01 + speed * k * 1e-3)
        _, position, slope, _ = line
        assert position == pytest.approx(0.01 + speed * k * 1e-3, abs=1e-12)
        assert slope == pytest.approx(speed)


def test_filter_cuts_the_noise_of_the_position_to_a_quarter():
    noise, line = random.Random(2), first_of(0.0)
    positions = []
    for _ in range(20000):
        line = followed(line, noise.gauss(0.0, 1e-3))
        positions.append(line[1])
    assert statistics.pstdev(positions[500:]) == pytest.approx(0.25e-3, rel=0.05)


def test_tribometer_sample_weighs_as_in_least_squares_at_first():
    """Its share in the line at its own place is the leverage of the last of n samples."""
    faded = followed((True, 0.0, 0.0, 10_000), 1.0)[1]
    for n in range(2, 80):
        x = np.column_stack([np.ones(n), np.arange(n)])
        leverage = x[-1] @ np.linalg.solve(x.T @ x, x[-1])
        _, share, _, samples = followed((True, 0.0, 0.0, n - 1), 1.0)
        assert share == pytest.approx(max(leverage, faded))
        assert samples <= n


@pytest.mark.parametrize("seed", range(10))
def test_noisy_boundary_is_crossed_once_a_pass(seed):
    """Light finger, slow stroke: 0.2 N at 20 mm/s, where a raw position errs by 1.2 mm."""
    noise, instrument, right = random.Random(seed), tribometer(), False
    sides = []
    for k in range(1000):
        clean = gauges(Fn=0.2, x=2e-5 * k - 0.01)
        contact = instrument.update(tuple(s + noise.gauss(0.0, SIGMA) for s in clean))
        right = is_right(right, contact.position, 0.0, 0.5e-3)
        sides.append(right)
    assert sum(a != b for a, b in pairwise(sides[20:])) == 1


def test_the_centre_of_a_tick_alone_is_as_unsure_as_it_is_spread():
    instrument, draw = tribometer(), random.Random(1)
    instrument.zero = NULLS
    centres = []
    for _ in range(2000):
        noisy = [
            s + n + draw.gauss(0.0, SIGMA)
            for s, n in zip(gauges(0.2, 0.0, 0.8, 3e-3), NULLS, strict=True)
        ]
        contact = instrument.update(tuple(noisy))
        unsure = centre_uncertainty(instrument.gauging, contact.Fn)
        centres.append((instrument.centre, unsure))
    places, unsure = zip(*centres, strict=True)
    assert statistics.fmean(places) == pytest.approx(3e-3, abs=0.03e-3)
    assert unsure[0] == pytest.approx(0.30e-3, rel=0.03)
    assert statistics.stdev(places) == pytest.approx(statistics.fmean(unsure), rel=0.05)
