"""The resonator against the carrier-level equation (1), integrated by SciPy."""

import cmath
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from smarttac_can.plant.parameters import TWO_PI, ResonatorParameters
from smarttac_can.plant.resonator import rate_in_frame, response, vibrate

PLATE = ResonatorParameters()
FREE = (PLATE.damping, PLATE.stiffness(20.0))
TOUCHED = (PLATE.damping + 8.0, PLATE.stiffness(20.0) + 1.5e5)


def carrier(segments):
    """Integrate m y" + d y' + c y = Re(N jV e^{j theta}) and return W at the end of each segment.

    The real displacement and its rate give the envelope: y = Re(W e^{j theta}) holds for the
    analytic solution, so the imaginary twin, driven by the imaginary part, is integrated with it.
    """
    y = np.zeros(4)
    theta = 0.0
    envelopes = []
    for duration, voltage, frequency, (damping, stiffness) in segments:
        omega = TWO_PI * frequency
        force = PLATE.conversion * voltage

        def rates(
            t, y, theta=theta, omega=omega, force=force, damping=damping, stiffness=stiffness
        ):
            drive = 1j * force * cmath.exp(1j * (theta + omega * t))
            return [
                y[1],
                (drive.real - damping * y[1] - stiffness * y[0]) / PLATE.mass,
                y[3],
                (drive.imag - damping * y[3] - stiffness * y[2]) / PLATE.mass,
            ]

        solution = solve_ivp(
            rates, (0.0, duration), y, method="DOP853", rtol=1e-11, atol=[1e-18, 1e-13] * 2
        )
        y = solution.y[:, -1]
        theta += omega * duration
        envelopes.append(complex(y[0], y[2]) * cmath.exp(-1j * theta))
    return np.array(envelopes)


class Mode:
    """The mode from rest, in the frame of whatever drives it."""

    def __init__(self):
        self.W = self.rate = 0j
        self.omega = 0.0

    def step(self, duration, omega, force, damping, stiffness):
        rate = rate_in_frame(self.W, self.rate, omega - self.omega)
        self.omega = omega
        step = response(PLATE.mass, duration, omega, force, damping, stiffness)
        self.W, self.rate = vibrate(step, self.W, rate)
        return self.W


def envelope(segments):
    mode = Mode()
    envelopes = []
    for duration, voltage, frequency, (damping, stiffness) in segments:
        omega = TWO_PI * frequency
        envelopes.append(mode.step(duration, omega, PLATE.conversion * voltage, damping, stiffness))
    return np.array(envelopes)


@pytest.mark.parametrize(
    "segments",
    [
        [(0.4e-3, 20.0, 43390.0, FREE)] * 3,
        [(0.4e-3, 20.0, 43250.0, FREE)] * 3,
        [(0.3e-3, 20.0, 40000.0, FREE)] * 2,
        [
            (0.5e-3, 20.0, 43390.0, FREE),
            (0.5e-3, 20.0, 43390.0, TOUCHED),
            (0.5e-3, 20.0, 43390.0, FREE),
        ],
        [
            (0.4e-3, 20.0, 43250.0, FREE),
            (0.4e-3, 30.0, 43500.0, FREE),
            (0.4e-3, 0.0, 43100.0, TOUCHED),
            (0.4e-3, 10.0, 43390.0, TOUCHED),
        ],
    ],
    ids=["resonance", "detuned", "far", "damping changes", "frequency steps"],
)
def test_agrees_with_the_carrier(segments):
    expected = carrier(segments)
    assert np.max(np.abs(envelope(segments) - expected)) < 1e-6 * np.max(np.abs(expected))


def test_voltage_at_140_hz_of_detuning_is_30_percent_higher():
    def steady(frequency):
        return abs(envelope([(0.1, 10.0, frequency, FREE)])[-1])

    assert steady(43390.0) / steady(43250.0) == pytest.approx(1.30, abs=0.01)
    assert steady(43390.0) == pytest.approx(10 * PLATE.gain, rel=1e-9)


def test_at_resonance_the_vibration_is_on_the_d_axis():
    W = envelope([(0.1, 10.0, 43390.0, FREE)])[-1]
    assert W.real > 0
    assert abs(W.imag) < 1e-9 * W.real


@given(
    voltage=st.floats(0.0, 200.0),
    detuning=st.floats(-2000.0, 2000.0),
    damping=st.floats(0.0, 100.0),
    parts=st.integers(2, 9),
)
@settings(max_examples=60)
def test_many_short_steps_are_one_long_step(voltage, detuning, damping, parts):
    load = (PLATE.damping + damping, PLATE.stiffness(20.0))
    whole = envelope([(1e-3, voltage, 43390.0 + detuning, load)])[-1]
    split = envelope([(1e-3 / parts, voltage, 43390.0 + detuning, load)] * parts)[-1]
    assert abs(split - whole) <= 1e-9 * abs(whole) + 1e-24


@given(
    steps=st.lists(st.tuples(st.floats(1e-6, 1e-3), st.floats(0.0, 1e5)), min_size=2, max_size=20),
    damping=st.floats(0.0, 200.0),
)
@settings(max_examples=60)
def test_without_drive_the_energy_falls_whatever_the_frame_does(steps, damping):
    mode = Mode()
    stiffness = PLATE.stiffness(20.0)
    mode.step(2e-3, TWO_PI * 43390.0, PLATE.conversion * 20.0, PLATE.damping, stiffness)
    omega = TWO_PI * 43390.0
    last = math.inf
    for duration, frequency in steps:
        omega = TWO_PI * frequency
        mode.step(duration, omega, 0.0, PLATE.damping + damping, stiffness)
        velocity = mode.rate + 1j * omega * mode.W
        energy = PLATE.mass * abs(velocity) ** 2 + stiffness * abs(mode.W) ** 2
        assert energy < last
        last = energy
