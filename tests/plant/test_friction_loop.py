"""Table I of the paper from the presets, with the least controller that closes the loop.

Real sampling at 1 ms, measured vibration, measured and tared gauges; law W_ref = |W| + dW(E) of
eq. (8), (9) over an amplitude PI with its zero on the plate's pole and a closed-loop pole of 0.2.
"""

import math

import numpy as np
import pytest

from smarttac_can.plant.finger import Stroke
from smarttac_can.plant.parameters import PlateParameters
from smarttac_can.plant.plate import Plate
from smarttac_can.plant.subjects import SUBJECTS
from smarttac_can.vocabulary.signals import Drive

REFERENCES = [(0.2, 0.3), (0.3, 0.4), (0.4, 0.5), (0.5, 0.6)]
PARAMETERS = PlateParameters()
CALIBRATION = np.linalg.inv(np.array(PARAMETERS.sensors.crosstalk)).tolist()
A = math.exp(-1e-3 / PARAMETERS.resonator.tau)
KP = (1 - 0.2) / (PARAMETERS.resonator.gain * (1 - A))
TOUCHES, PASS_TICKS = 20, 600


def friction_loop(subject, low, high, seed):
    """Return measured mu and its reference, tick by tick; the reference is high on the right."""
    plate = Plate(PARAMETERS, subject, Stroke(0.5, 0.06, 0.03, seed=seed), seed)
    (xx, xy), (yx, yy) = CALIBRATION
    rest, mus, references = [], [], []
    tare = [0.0] * 6
    drive, integral, x, right = Drive(0.0, 43390.0), 0.0, -0.015, False
    for tick in range(400 + 2 * TOUCHES * PASS_TICKS):
        report = plate.sample()
        amplitude, W_ref, mu, reference = abs(report.W), 0.0, 0.0, 0.0
        if tick < 64:
            rest.append(report.gauges)
            tare = np.mean(rest, axis=0).tolist()
        s1, s2, s3, s4, s5, s6 = (s - t for s, t in zip(report.gauges, tare, strict=True))
        Fn = s3 + s4 + s5 + s6
        if tick >= 64 and Fn > 0.1:
            mu = math.hypot(xx * s1 + xy * s2, yx * s1 + yy * s2) / Fn
            x += 0.06 * (PARAMETERS.sensors.node_x * (s4 + s6 - s3 - s5) / Fn - x)
            right = x > (-0.5e-3 if right else 0.5e-3)
            reference = high if right else low
            E = 100 * (mu - reference) / reference
            W_ref = min(max(amplitude + min(max(0.04e-6 * E, -1e-6), 1e-6), 0.0), 3e-6)
        error = W_ref - amplitude
        voltage = min(max(integral + KP * error, 0.0), 150.0)
        integral = voltage - KP * A * error
        last, drive = drive, Drive(voltage, 43390.0)
        plate.step(last, drive)
        mus.append(mu)
        references.append(reference)
    return np.array(mus), np.array(references)


def up_steps(mu, reference):
    rises = np.flatnonzero((np.diff(reference) > 0) & (reference[:-1] > 0)) + 1
    return np.array([mu[k - 20 : k + 80] for k in rises if k + 80 <= len(mu)])


def figures(curve):
    """Rise time in ms, overshoot in % of the step, and the two levels of a mean curve."""
    before, after = curve[:21].mean(), curve[60:].mean()
    share = (curve - before) / (after - before)
    upper = 20 + int(np.argmax(share[20:] >= 0.9))
    lower = int(np.flatnonzero(share[:upper] < 0.1)[-1])
    start = lower + (0.1 - share[lower]) / (share[lower + 1] - share[lower])
    end = upper - (share[upper] - 0.9) / (share[upper] - share[upper - 1])
    return end - start, 100 * (share[20:].max() - 1), before, after


@pytest.fixture(scope="module")
def mean_curves():
    curves = []
    for subject, (low, high) in zip(SUBJECTS, REFERENCES, strict=False):
        touches = up_steps(*friction_loop(subject, low, high, seed=1))
        assert len(touches) >= 18
        curves.append(touches.mean(axis=0))
    return [figures(curve) for curve in curves]


def test_mean_rise_time(mean_curves):
    assert np.mean([rise for rise, *_ in mean_curves]) == pytest.approx(3.84, abs=1.27)


def test_mean_overshoot(mean_curves):
    assert np.mean([overshoot for _, overshoot, *_ in mean_curves]) == pytest.approx(37.5, abs=10.2)


def test_static_error(mean_curves):
    for (_, _, before, after), (low, high) in zip(mean_curves, REFERENCES, strict=True):
        assert before == pytest.approx(low, rel=0.05)
        assert after == pytest.approx(high, rel=0.05)
