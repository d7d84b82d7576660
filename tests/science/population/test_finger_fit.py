"""A fingertip fitted to a recording: its numbers are found again, with honest limits."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import exp, log, pi
from typing import Any

import numpy as np
import pytest

from smarttac_can.science.plant.motion import PlatePlan, at_rest, coefficients, plate_step
from smarttac_can.science.plant.parameters import PlateParameters
from smarttac_can.science.plant.sensors import noise_block, sensing
from smarttac_can.science.plant.subjects import Subject
from smarttac_can.science.population import finger_fit
from smarttac_can.science.population.compiled import compiled
from smarttac_can.science.population.finger_fit import (
    FREE,
    FingerFit,
    FingerRecording,
    correlation_of,
    fit_finger,
)
from smarttac_can.science.population.fingers import CASES, draw_finger
from smarttac_can.vocabulary.signals import TICK

FINGERS, ENOUGH = 30, 26
SEED = 1
FITTED = [name for name in FREE if not name.startswith("_")]
PLATE = PlateParameters()
F0 = PLATE.resonator.f0
POSITION_NOISE = 0.5e-6
"""In m, of an encoder."""


def finger(number: int) -> Subject:
    """Draw a finger of a campaign; what is the same in all of them is drawn, too."""
    rng = np.random.default_rng([SEED, number])

    def between(low: float, high: float) -> float:
        return exp(float(rng.uniform(log(low), log(high))))

    return replace(
        draw_finger(SEED, number, CASES["nominal"]).subject,
        occlusion=float(rng.uniform(0.0, 0.2)),
        occlusion_time=between(10.0, 40.0),
        stribeck_speed=between(20e-3, 60e-3),
        creep_ratio=between(0.2, 1.2),
        creep_time=between(3e-3, 15e-3),
        release_time=between(8e-3, 50e-3),
    )


def smooth(count: int) -> np.ndarray:
    return 0.5 - 0.5 * np.cos(pi * np.arange(count) / count)


def motion(rng: np.random.Generator, ticks: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Strokes at 20 to 110 mm/s and 0.25 to 1.1 N, half of them with a rest behind, and voltages.

    A third of the voltages is 0, and in each rest one begins.
    """
    v, Fn, volts = np.zeros(ticks), np.zeros(ticks), np.zeros(ticks)
    at, sign, force, travel = 300, 1.0, 0.0, 20e-3
    quiet = []
    while at < ticks:
        speed, new = exp(rng.uniform(log(20e-3), log(110e-3))), rng.uniform(0.25, 1.1)
        ramp = round(0.2 * travel / speed / TICK)
        pace = np.concatenate([smooth(ramp), np.ones(4 * ramp), smooth(ramp)[::-1]])
        end = min(at + len(pace), ticks)
        v[at:end] = sign * speed * pace[: end - at]
        if not force:
            Fn[at - 100 : at], force = new * smooth(100), new
        change = np.concatenate([smooth(100), np.ones(ticks)])[: ticks - at]
        Fn[at:] = force + (new - force) * change
        at, sign, force = end, -sign, new
        if rng.random() < 0.5:
            quiet.append(at)
            at += 250
    at = 300
    while at < ticks:
        length = round(rng.uniform(30, 120))
        volts[at : at + length] = 0.0 if rng.random() < 0.35 else rng.uniform(8.0, 60.0)
        at += length
    for at in quiet:
        volts[at - 30 : at + 80] = 0.0
        volts[at + 80 : at + 230] = rng.uniform(20.0, 60.0)
    return np.cumsum(v) * TICK - 10e-3, Fn, volts


Ridden = Callable[..., None]


def ridden(
    plan: PlatePlan,
    state: Any,
    x: Sequence[float],
    Fn: Sequence[float],
    volts: Sequence[float],
    noise: Sequence[float],
    out: np.ndarray,
) -> None:
    """Move the plate, and fill lateral and normal force, vibration and speed of the skin."""
    for tick in range(1, len(x)):
        drive = (volts[tick - 1], 43390.0)
        fingers = ((x[tick - 1], Fn[tick - 1]), (x[tick], Fn[tick]))
        state, _ = plate_step(plan, state, (drive, drive), fingers, noise)
        out[tick, 0] = state.motion.Fx
        out[tick, 1] = state.Fn
        out[tick, 2] = abs(state.motion.W)
        out[tick, 3] = state.motion.v


def recorded(
    subject: Subject,
    seed: int,
    seconds: float,
    *,
    position_noise: float = POSITION_NOISE,
    run: Ridden = ridden,
    **others: Any,
) -> FingerRecording:
    """Record a finger with the noise of the gauges, of the pick-up and of an encoder."""
    rng = np.random.default_rng([SEED, seed, 7])
    ticks = round(seconds / TICK)
    x, Fn, volts = motion(rng, ticks)
    made = coefficients(PLATE, subject, ambient=20.0, dead_time=0.0, sound_f0=F0)
    out = np.zeros((ticks, 4))
    plan = PlatePlan(made, sensing(PLATE.sensors))
    columns = [x, Fn, volts, np.zeros_like(noise_block(PLATE.sensors, 1, 0)[0])]
    if run is ridden:
        columns = [column.tolist() for column in columns]
    run(plan, at_rest(20.0), *columns, out)
    noise = PLATE.sensors.gauge_noise
    tare = float(rng.normal(0.0, 0.3e-3))
    return FingerRecording(
        time=np.arange(ticks) * TICK,
        lateral=out[:, 0] + rng.normal(tare, noise, ticks),
        normal=out[:, 1] + rng.normal(0.0, 2.0 * noise, ticks),
        position=x + rng.normal(0.0, position_noise, ticks),
        amplitude=np.abs(out[:, 2] + rng.normal(0.0, PLATE.sensors.pickup_noise, ticks)),
    )._replace(**others)


def held(fit: FingerFit, subject: Subject) -> dict[str, bool]:
    """Return for each fitted number whether it is inside its limits."""
    return {
        name: fit.numbers[name].low <= getattr(subject, name) <= fit.numbers[name].high
        for name in FITTED
    }


@pytest.mark.long
@pytest.mark.timeout(3600)  # 10 to 60 s a finger
def test_thirty_fingers_are_inside_their_95_percent_limits() -> None:
    """Of the numbers that are told; a fit that leaves too much tells none."""
    run = compiled(ridden)
    told: dict[str, list[bool]] = {name: [] for name in FITTED}
    refused = 0
    for number in range(FINGERS):
        subject = finger(number)
        try:
            fit = fit_finger(recorded(subject, number, 12.0, run=run))
        except ValueError as error:
            assert "the fit leaves" in str(error)
            refused += 1
            continue
        for name, inside in held(fit, subject).items():
            if fit.numbers[name].told:
                told[name].append(inside)
    assert refused <= 1
    fitted = FINGERS - refused
    missed = {name: inside.count(False) for name, inside in told.items()}
    assert {name: count for name, count in missed.items() if count > FINGERS - ENOUGH} == {}
    assert {name for name, inside in told.items() if len(inside) == fitted} >= MAP


MAP = {"mu0", "exponent", "W0", "p", "stribeck", "stribeck_speed"}
"""What every one of these recordings tells."""


@pytest.mark.long
def test_one_finger_is_found_again_without_acceleration() -> None:
    subject = finger(4)
    shares: list[float] = []
    fit = fit_finger(recorded(subject, 4, 5.0), name="four", progress=shares.append)
    inside = held(fit, subject)
    assert {name for name in MAP if inside[name] and fit.numbers[name].told} >= {"mu0", "W0", "p"}
    assert fit.subject.name == "four"
    assert fit.subject.mu0 == fit.numbers["mu0"].value
    assert fit.residual == pytest.approx(PLATE.sensors.gauge_noise, rel=0.1)
    assert 1000 < fit.independent <= fit.rows < 5000
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    mass, load = fit.numbers["skin_mass"], fit.numbers["load_damping"]
    assert not mass.told
    assert "do not part mass, stiffness" in mass.reason
    assert not load.told
    assert "load on the vibration" in load.reason


def test_residuals_of_an_autoregression_tell_less() -> None:
    rng = np.random.default_rng(2)
    white = rng.standard_normal(50_000)
    slow = np.zeros_like(white)
    for at in range(1, len(white)):
        slow[at] = 0.8 * slow[at - 1] + white[at]
    assert correlation_of(white) == pytest.approx(1.0, abs=0.1)
    assert correlation_of(slow) == pytest.approx((1 + 0.8) / (1 - 0.8), rel=0.15)


def test_true_numbers_leave_the_noise_of_the_gauges() -> None:
    subject = finger(2)
    recording = recorded(subject, 2, 3.0, position_noise=0.0)
    rows = finger_fit._on_ticks(recording)
    u = np.zeros(len(FREE))
    for at, (name, free) in enumerate(FREE.items()):
        if name == "_zero":
            continue
        value = 0.5e-3 if name == "_decay" else getattr(subject, name)
        number = log(value) if free.logarithmic else value
        u[at] = (number - finger_fit._MEAN[at]) / finger_fit._SIGMA[at]
    left = finger_fit._Model(recording, rows).residuals(u)[0][rows.judged]
    assert np.std(left) == pytest.approx(PLATE.sensors.gauge_noise, rel=0.1)


def slow_rows(count: int = 1000, period: float = 2e-3) -> FingerRecording:
    """A finger that is drawn at 50 mm/s."""
    time = np.arange(count) * period
    return FingerRecording(time, np.full(count, 0.2), np.full(count, 0.5), 50e-3 * time)


@pytest.mark.parametrize(
    ("recording", "said"),
    [
        (slow_rows(400), "400 rows are fewer than the 500 of a fit"),
        (slow_rows(1000, 8e-3), "a row each 8 ms is less than one each 5 ms"),
        (slow_rows(1000, 1e-3), "949 ms of a sliding finger are fewer than 1000"),
        (slow_rows()._replace(time=np.zeros(1000)), "time does not rise at row 2"),
        (slow_rows()._replace(normal=np.zeros(3)), "normal has 3 values, and time has 1000"),
        (slow_rows()._replace(lateral=np.full(1000, np.nan)), "lateral has values that are not"),
        (slow_rows()._replace(path_frequency=0.5), "path_frequency 0.5 is outside 1..100000"),
        (slow_rows(130_000, 5e-3), "649.995 s are more than 600 s"),
    ],
)
def test_recording_that_cannot_be_fitted_is_refused(recording: FingerRecording, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        fit_finger(recording)


def test_rows_far_apart_are_a_lifted_finger() -> None:
    recording = slow_rows(2000)
    kept = np.abs(recording.time - 2.0) > 0.1
    cut = FingerRecording(*(column[kept] for column in recording[:4]))
    rows = finger_fit._on_ticks(cut)
    assert rows.given[2000, 1] == 0.0
    assert not rows.judged[1910:2140].any()
    assert rows.judged[2160:].all()


def test_lateral_force_against_the_motion_is_turned() -> None:
    recording = slow_rows()
    turned = recording._replace(lateral=-recording.lateral)
    for one in (recording, turned):
        assert finger_fit._on_ticks(one).seen[0][-1] == pytest.approx(0.2)


def test_noise_of_the_lateral_force_is_found_by_its_scatter() -> None:
    rows = finger_fit._on_ticks(recorded(finger(2), 2, 3.0))
    assert rows.lateral_noise == pytest.approx(PLATE.sensors.gauge_noise, rel=0.3)


def test_fit_that_leaves_twice_the_noise_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def stuck(_model: object, u: np.ndarray, *_: object) -> finger_fit._Optimum:
        squares = 3000 * (2.0 * PLATE.sensors.gauge_noise) ** 2
        return finger_fit._Optimum(u, squares, np.eye(len(u)), np.zeros((len(u), 3000)), 1.0)

    monkeypatch.setattr(finger_fit, "_optimum", stuck)
    with pytest.raises(ValueError, match=r"the fit leaves .* mN .* its noise of .* mN allows"):
        fit_finger(recorded(finger(2), 2, 3.0))
