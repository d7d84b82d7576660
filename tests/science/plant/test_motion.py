"""Within a tick: the film over the skin, the ripple of the mode, and sub-steps enough."""

import math

import numpy as np
import pytest

from smarttac_can.science.plant import motion
from smarttac_can.science.plant.finger import Stroke, Trajectory
from smarttac_can.science.plant.force_path import propagator
from smarttac_can.science.plant.friction import friction_map
from smarttac_can.science.plant.motion import lag_kept, shape_at
from smarttac_can.science.plant.parameters import (
    ContactParameters,
    PlateParameters,
    SensorParameters,
)
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.skin import skin_of, skin_step, slide
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.vocabulary.signals import Drive

OFF, ON = Drive(0.0, 43390.0), Drive(60.0, 43390.0)
SLIDE = Trajectory([(0.0, -0.03, 0.5), (1.0, 0.03, 0.5)])


def make(finger, **contact):
    parameters = PlateParameters(contact=ContactParameters(**contact))
    return Plate(parameters, SUBJECTS[1], finger)


@pytest.mark.parametrize("steps", [1, 4, 16])
def test_film_follows_a_ramp_as_first_order_lag_at_any_step(steps):
    lag, duration = 2e-3, 3e-3
    length, rate = duration / steps, 3e-6 / duration
    contact = (0.2, 1.0, lag / length, lag_kept(length, lag))
    skin = skin_step(skin_of(SUBJECTS[1]), length, 0.05)
    ramp = (1.0 + 0j, length + 0j, 0j, 1.0 + 0j, 0j)
    path = propagator(length, 300.0, 0.7)
    moving = (1e-6 + 0j, rate + 0j, *[0.0] * 7)
    moving = slide(steps, (ramp, skin, path), contact, friction_map(SUBJECTS[1], 43390.0), moving)
    acting = moving[2]
    steady = 4e-6 - rate * lag
    assert acting == pytest.approx(steady + (rate * lag - 1e-6) * math.exp(-1.5), rel=1e-12)


def test_the_shape_is_that_of_the_place():
    for x, shape in ((0.0, 1.1), (4e-3, 0.9), (8e-3, 1.1), (-2e-3, 1.0), (-12e-3, 0.9)):
        assert shape_at(x, 0.1, 8e-3) == pytest.approx(shape)
    assert lag_kept(1e-3, 0.0) == 0.0, "without a lag the film is where the vibration is"


def test_off_by_default_to_the_bit():
    plain = Plate(PlateParameters(), SUBJECTS[1], Stroke())
    other = make(Stroke(), node_distance=5e-3)
    for _ in range(600):
        assert plain.sample() == other.sample()
        plain.step(ON, ON)
        other.step(ON, ON)
        assert plain.mu_true == other.mu_true


def friction(plate, ticks):
    mus = []
    for _ in range(ticks):
        plate.step(ON, ON)
        mus.append(plate.mu_true)
    return np.array(mus)


def test_friction_falls_later_behind_a_film_and_ends_the_same():
    drops = []
    for lag in (0.0, 2e-3, 10e-3):
        plate = make(SLIDE, film_lag=lag)
        for _ in range(200):
            plate.step(OFF, OFF)
        mu = friction(plate, 120)
        drops.append((int(np.argmax(mu < 0.5 * (mu[0] + mu[-1]))), mu[-1]))
    assert drops[0][0] < drops[1][0] < drops[2][0]
    assert drops[1][1] == pytest.approx(drops[0][1], rel=1e-3)


@pytest.mark.sources
def test_substeps_behind_a_film_are_enough(monkeypatch):
    """The reference takes 64 sub-steps; the vibration begins under a sliding finger."""

    def cof(substeps):
        monkeypatch.setattr(motion, "SUBSTEPS", substeps)
        plate = make(SLIDE, film_lag=2e-3)
        for _ in range(200):
            plate.step(OFF, OFF)
        return friction(plate, 60)

    chosen, reference, coarse = cof(motion.SUBSTEPS), cof(64), cof(1)
    assert np.max(np.abs(chosen - reference)) < 5e-4
    assert np.max(np.abs(coarse - reference)) > 3e-3


def test_vibration_and_friction_of_a_moving_finger_beat():
    """At one voltage the load's beat nearly cancels in friction, so W shows it: by 8 to 11 %."""
    speed = 0.04
    plate = make(Trajectory([(0.0, -0.035, 0.5), (1.75, 0.035, 0.5)]), ripple=0.1)
    Ws, mus = [], []
    for _ in range(1500):
        plate.step(ON, ON)
        Ws.append(abs(plate.W))
        mus.append(plate.mu_true)
    for beat in (np.array(Ws[200:]), np.array(mus[200:])):
        spectrum = np.abs(np.fft.rfft((beat - beat.mean()) * np.hanning(len(beat))))
        frequency = np.fft.rfftfreq(len(beat), 1e-3)[np.argmax(spectrum)]
        assert frequency == pytest.approx(speed / 8e-3, abs=1.0)
    swing = 0.5 * np.ptp(Ws[200:]) / np.mean(Ws[200:])
    assert 0.08 < swing < 0.11


@pytest.mark.parametrize(("x", "more"), [(0.0, True), (4e-3, False)])
def test_the_load_on_the_mode_is_that_of_the_place(x, more):
    finger = Trajectory([(0.0, x, 0.5), (60.0, x, 0.5)])
    even, shaped = make(finger), make(finger, ripple=0.1)
    for plate in (even, shaped):
        for _ in range(40):
            plate.step(ON, ON)
    assert (abs(shaped.W) < abs(even.W)) == more


@pytest.mark.sources
def test_substeps_are_enough(monkeypatch):
    """While the finger slides, the lateral force is within a fiftieth of the gauges' noise.

    The vibration steps by a third every 20 ms; the reference takes 64 sub-steps.
    """

    def lateral(substeps):
        monkeypatch.setattr(motion, "SUBSTEPS", substeps)
        exact = SensorParameters(
            null=0.0, gauge_noise=0.0, drift=0.0, gauge_resolution=1e-7, full_scale=10**9
        )
        plate = Plate(PlateParameters(sensors=exact), SUBJECTS[2], Stroke(seed=3))
        forces = []
        for tick in range(700):
            forces.append(plate.sample().gauges[0])
            drive = Drive(30.0 + 20.0 * (tick // 20 % 2), 43390.0)
            plate.step(drive, drive)
        return np.array(forces[420:])

    steps = motion.SUBSTEPS
    reference = lateral(64)
    chosen = np.max(np.abs(lateral(steps) - reference))
    coarse = np.max(np.abs(lateral(1) - reference))
    assert steps <= 16
    assert chosen < 0.02 * SensorParameters().gauge_noise
    assert coarse > 10 * chosen
