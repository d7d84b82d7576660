"""The resonator against the carrier-level equation (1), integrated by SciPy."""

import cmath
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from smarttac_can.science.plant import SUBJECTS, Lifted, Plate, PlateParameters
from smarttac_can.science.plant.parameters import TWO_PI, ResonatorParameters, SensorParameters
from smarttac_can.science.plant.resonator import rate_in_frame, response, vibrate
from smarttac_can.vocabulary import Drive

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
        return envelope([(0.1, 10.0, frequency, FREE)])[-1]

    assert abs(steady(43390.0) / steady(43250.0)) == pytest.approx(1.30, abs=0.01)
    assert steady(43390.0) == pytest.approx(10 * PLATE.gain, rel=1e-9), "on the d-axis"


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


def test_softening_agrees_with_a_nonlinear_spring_at_the_carrier():
    """``m y" + d y' + c y (1 - b |y|) = F(t)``: its resonance falls by 4 b f0/(3 pi) a m of |W|.

    Real numbers alone, no envelope and no frame: the first harmonic of ``|y| y`` is 8/(3 pi) A y.
    """
    softening = 150e6
    plate = Plate(
        PlateParameters(resonator=ResonatorParameters(softening=softening)), SUBJECTS[0], Lifted()
    )
    drives = [(60.0, 43390.0), (60.0, 43390.0), (60.0, 43200.0), (10.0, 43000.0), (0.0, 43000.0)]
    damping, stiffness = FREE
    yielding = 0.75 * math.pi * softening / PLATE.f0
    state, theta, seen, expected = np.zeros(2), 0.0, [], []
    for voltage, frequency in drives:
        omega, force = TWO_PI * frequency, PLATE.conversion * voltage

        def rates(t, y, theta=theta, omega=omega, force=force):
            spring = stiffness * y[0] * (1.0 - yielding * abs(y[0]))
            drive = -force * math.sin(theta + omega * t)
            return [y[1], (drive - damping * y[1] - spring) / PLATE.mass]

        # The mean over a turn of the drive belongs to its middle, the end of the tick.
        turns = 1e-3 + np.linspace(-0.5, 0.5, 65) / frequency
        solution = solve_ivp(
            rates, (0.0, turns[-1]), state, method="DOP853", rtol=1e-10, atol=1e-16, t_eval=turns
        )
        state = solution.y[:, 32]
        wave = 2.0 * solution.y[0] * np.exp(-1j * (theta + omega * turns))
        expected.append(np.mean(0.5 * (wave[1:] + wave[:-1])))
        theta += omega * 1e-3
        plate.step(Drive(0.0, frequency), Drive(voltage, frequency))
        seen.append(plate.W)
    error = np.abs(np.array(seen) - expected) / np.max(np.abs(expected))
    assert np.max(error) < 0.015


QUIET = SensorParameters(pickup_noise=0.0)


@pytest.mark.parametrize("dead_time", [0.0, 300e-6, 700e-6])
@pytest.mark.parametrize("window", [0.0, 461e-6, 1e-3])
@pytest.mark.parametrize("lag", [0.0, 150e-6])
@pytest.mark.parametrize("share", [0.0, 0.2])
def test_pickup_reads_the_filtered_mean_of_both_modes(dead_time, window, lag, share):
    """Against a thousand steps a tick, summed up."""
    sensors = replace(QUIET, pickup_window=window, pickup_lag=lag)
    mode = ResonatorParameters(neighbour_share=share, neighbour_offset=500.0)
    plate = Plate(
        PlateParameters(resonator=mode, sensors=sensors), SUBJECTS[0], Lifted(), dead_time=dead_time
    )
    both = (Mode(), PLATE.f0, 1.0), (Mode(), PLATE.f0 + 500.0, share)
    old, low, before = Drive(0.0, 43390.0), 0j, 0j
    for drive in (Drive(40.0, 43390.0), Drive(20.0, 43250.0), Drive(0.0, 43500.0)):
        total = []
        for us in range(1000):
            voltage, frequency = old if us < round(dead_time * 1e6) else drive
            now = sum(
                each.step(
                    1e-6,
                    TWO_PI * frequency,
                    gain * PLATE.conversion * voltage,
                    PLATE.damping,
                    PLATE.mass * (TWO_PI * f0) ** 2,
                )
                for each, f0, gain in both
            )
            mean, before = 0.5 * (before + now), now
            low_before = low
            low = low + (mean - low) * -math.expm1(-1e-6 / lag) if lag else now
            total.append(0.5 * (low_before + low))
        plate.step(old, drive)
        old = drive
        expected = np.mean(total[-round(window * 1e6) :]) if window else low
        # The plate cools a little, and the filter takes the mean of a part of the tick.
        assert abs(plate.sample().W - expected) < (0.01 if lag else 1e-3) * 1.3e-6


def test_a_neighbour_like_the_mode_itself_moves_as_it_does():
    """Whatever the drive: to the bit, also where its frequency changes."""
    mode = ResonatorParameters(neighbour_share=1.0, neighbour_offset=0.0)
    plate = Plate(PlateParameters(resonator=mode, sensors=QUIET), SUBJECTS[0], Lifted())
    old = Drive(0.0, 43390.0)
    for drive in (Drive(40.0, 43390.0), Drive(20.0, 43250.0), Drive(0.0, 43500.0)):
        plate.step(old, drive)
        old = drive
        motion = plate._state.motion
        assert (motion.pickup.W, motion.pickup.rate) == (motion.W, motion.rate)
        assert abs(plate.sample().W - 2.0 * motion.W) < 1e-10


def test_the_pickup_agrees_with_two_oscillators_at_the_carrier():
    """Eq. (1) for each of two modes; the mean of their sum over the window, by trapezes."""
    share, offset, dead_time, window, parts = 0.3, -400.0, 300e-6, 461e-6, 24
    plate = Plate(
        PlateParameters(
            resonator=ResonatorParameters(neighbour_share=share, neighbour_offset=offset),
            sensors=replace(QUIET, pickup_window=window),
        ),
        SUBJECTS[0], Lifted(), dead_time=dead_time,
    )  # fmt: skip
    drives = [Drive(0.0, 43390.0), Drive(40.0, 43390.0), Drive(20.0, 43250.0), Drive(0.0, 43100.0)]
    readings, sums = [], 0.0
    for old, new in itertools.pairwise(drives):
        plate.step(old, new)
        readings.append(plate.sample().W)
    for gain, f0 in ((1.0, PLATE.f0), (share, PLATE.f0 + offset)):
        load = (PLATE.damping, PLATE.mass * (TWO_PI * f0) ** 2)
        segments = []
        for old, new in itertools.pairwise(drives):
            segments.append((dead_time, gain * old.voltage, old.frequency, load))
            rest = (gain * new.voltage, new.frequency, load)
            segments.append((1e-3 - dead_time - window, *rest))
            segments += [(window / parts, *rest)] * parts
        sums = sums + carrier(segments)
    ends = sums.reshape(3, parts + 2)[:, 1:]
    expected = 0.5 * (ends[:, 1:] + ends[:, :-1]).mean(axis=1)
    # The plate cools by 2 mK, and the envelope bends within a part.
    assert np.max(np.abs(readings - expected)) < 1e-3 * np.max(np.abs(expected))
