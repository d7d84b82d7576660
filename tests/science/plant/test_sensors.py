import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.science.plant.parameters import SensorParameters
from smarttac_can.science.plant.sensors import (
    Noise,
    Weight,
    loaded,
    noise_block,
    readings,
    sensing,
)
from smarttac_can.vocabulary.signals import Measurement

REAL = SensorParameters()
IDEAL = SensorParameters(
    null=0.0, drift=0.0, linearity=0.0, gauge_noise=0.0, pickup_noise=0.0, temperature_noise=0.0
)


class Sensors:
    """The sensors of one plate in one run."""

    def __init__(self, parameters, seed):
        self.sensing, self.noise = sensing(parameters), Noise(parameters, seed)
        self.nulls = tuple(gauge.null for gauge in self.sensing.gauges)

    def measure(self, tick, W, temperature, forces):
        noise = self.noise.at(tick)
        return Measurement(*readings(self.sensing, noise, W, temperature, forces))


def read(parameters=IDEAL, seed=1, tick=0, W=0j, temperature=20.0, Fx=0.0, Fn=0.0, x=0.0):
    return Sensors(parameters, seed).measure(tick, W, temperature, (Fx, Fn, Fn * x))


@pytest.mark.parametrize("x", [-20e-3, 0.0, 3e-3, 28e-3])
def test_normal_gauges_give_force_and_centre_of_pressure(x):
    left, right, left2, right2 = read(Fn=0.8, x=x).gauges[2:]
    assert (left, right) == (left2, right2)
    total = 2 * (left + right)
    assert total == pytest.approx(0.8, abs=2e-4)
    assert REAL.node_x * 2 * (right - left) / total == pytest.approx(x, abs=2e-5)


@pytest.mark.parametrize(
    ("state", "mask", "value"),
    [
        ({"Fx": 4.0}, 1 << 0, ("gauges", 0, 3.2767)),
        ({"Fx": -4.0}, 1 << 0, ("gauges", 0, -3.2767)),
        ({"Fx": 120.0}, 1 << 0 | 1 << 1, ("gauges", 1, -3.2767)),
        ({"Fn": 8.0, "x": 28e-3}, (1 << 3) | (1 << 5), ("gauges", 3, 3.2767)),
        ({"Fn": 8.0, "x": -28e-3}, (1 << 2) | (1 << 4), ("gauges", 2, 3.2767)),
        ({"W": 3.3e-6 + 0j}, 1 << 6, ("W", None, 3.2767e-6 + 0j)),
        ({"W": 1e-6 - 4e-6j}, 1 << 6, ("W", None, 1e-6 - 3.2767e-6j)),
        ({"Fx": 3.2766, "W": 3.2766e-6 + 0j}, 0, ("gauges", 0, 3.2766)),
    ],
)
def test_saturation_is_reported(state, mask, value):
    report = read(**state)
    assert report.saturated == mask
    name, index, expected = value
    shown = getattr(report, name)
    assert (shown if index is None else shown[index]) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "step", "sensor", "sides"),
    [
        ("Fx", IDEAL.gauge_resolution, 1 << 0, (1.0, -1.0)),
        ("W", IDEAL.pickup_resolution, 1 << 6, (1.0, -1.0, 1j, -1j)),
    ],
)
def test_a_converter_is_saturated_from_its_last_step_on(name, step, sensor, sides):
    for side in sides:
        for count, saturated in ((-1, 0), (0, sensor), (1, sensor)):
            state = {name: side * step * (IDEAL.full_scale + count)}
            assert read(**state).saturated == saturated


@pytest.mark.parametrize("number", range(6))
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_each_gauge_has_a_bit_of_its_own(number, side):
    sensors = Sensors(IDEAL, 1)
    gauges = list(sensors.sensing.gauges)
    gauges[number] = gauges[number]._replace(null=side * 4.0)
    sensors.sensing = sensors.sensing._replace(gauges=tuple(gauges))
    assert sensors.measure(0, 0j, 20.0, (0.0, 0.0, 0.0)).saturated == 1 << number


@given(
    W=st.builds(complex, st.floats(-3e-6, 3e-6), st.floats(-3e-6, 3e-6)),
    temperature=st.floats(-20.0, 80.0),
    Fx=st.floats(-3.0, 3.0),
    Fn=st.floats(0.0, 6.0),
)
@settings(max_examples=50)
def test_every_converter_shows_its_nearest_step(W, temperature, Fx, Fn):
    report = read(W=W, temperature=temperature, Fx=Fx, Fn=Fn)
    half = 0.5 * (1.0 + 1e-6)
    (xx, _), (yx, _) = IDEAL.crosstalk
    assert abs(report.W.real - W.real) <= half * IDEAL.pickup_resolution
    assert abs(report.W.imag - W.imag) <= half * IDEAL.pickup_resolution
    assert abs(report.temperature - temperature) <= half * IDEAL.temperature_resolution
    for shown, true in zip(report.gauges, (xx * Fx, yx * Fx, *[0.25 * Fn] * 4), strict=True):
        assert abs(shown - true) <= half * IDEAL.gauge_resolution


def test_hardware_tolerances_fill_both_sides_of_the_data_sheet():
    """The bow is over a span: so far is the middle of the arc from the chord."""
    gauges = [
        gauge
        for serial in range(100)
        for gauge in sensing(dataclasses.replace(REAL, serial=serial)).gauges
    ]
    middle = (0.5 * REAL.span) ** 2
    for values, bound in (
        ([gauge.null for gauge in gauges], REAL.null),
        ([gauge.drift for gauge in gauges], REAL.drift),
        ([gauge.bow * middle for gauge in gauges], REAL.linearity),
    ):
        assert -bound <= min(values) < -0.95 * bound
        assert 0.95 * bound < max(values) <= bound


def test_a_gauge_without_a_span_has_no_bow():
    assert {gauge.bow for gauge in sensing(dataclasses.replace(REAL, span=0.0)).gauges} == {0.0}


def test_null_belongs_to_the_hardware_and_noise_to_the_run():
    assert Sensors(REAL, 1).nulls == Sensors(REAL, 2).nulls
    other = dataclasses.replace(REAL, serial=2)
    assert Sensors(REAL, 1).nulls != Sensors(other, 1).nulls
    assert max(abs(null) for null in Sensors(REAL, 1).nulls) <= 1.2
    assert np.std(Sensors(REAL, 1).nulls) > 0.3
    assert read(REAL, seed=1) != read(REAL, seed=2)
    assert read(REAL, seed=1) == read(REAL, seed=1)


def test_noise_is_a_function_of_the_tick():
    forward = Sensors(REAL, 5)
    reports = [forward.measure(k, 0j, 20.0, (0.0, 0.0, 0.0)) for k in range(600)]
    assert len({r.gauges for r in reports}) == 600
    leaping = Sensors(REAL, 5)
    for tick in (599, 0, 255, 256, 300, 299, 270, 271, 511, 256, 0, 16, 15):
        for sensors in (leaping, Sensors(REAL, 5)):
            assert sensors.measure(tick, 0j, 20.0, (0.0, 0.0, 0.0)) == reports[tick]


def test_noise_is_that_of_the_blocks_of_256_ticks():
    noisy = dataclasses.replace(IDEAL, temperature_noise=1.0, temperature_resolution=1e-9)
    sensors = Sensors(noisy, 5)
    read = [sensors.measure(k, 0j, 0.0, (0.0, 0.0, 0.0)).temperature for k in range(700)]
    drawn = np.concatenate([noise_block(noisy, 5, block) for block in range(3)])[:700, 8]
    assert read == pytest.approx(drawn, abs=1e-9)
    assert read[256:512] == pytest.approx(noise_block(noisy, 5, 1)[:256, 8], abs=1e-9)


def test_each_channel_has_noise_of_its_own():
    noisy = dataclasses.replace(IDEAL, gauge_noise=0.1, pickup_noise=1e-7, temperature_noise=5.0)
    sensors = Sensors(noisy, 3)
    reports = [sensors.measure(k, 0j, 20.0, (0.0, 0.0, 0.0)) for k in range(2048)]
    channels = np.array([(*r.gauges, r.W.real, r.W.imag, r.temperature) for r in reports])
    assert np.all(np.abs(np.corrcoef(channels.T) - np.eye(9)) < 0.1)


def test_noise_has_its_standard_deviation_and_is_white():
    sensors = Sensors(REAL, 3)
    reports = [sensors.measure(k, 1e-6 + 0j, 20.0, (0.2, 0.5, 0.0)) for k in range(4096)]
    gauges = np.array([r.gauges for r in reports])
    assert gauges.std(axis=0) == pytest.approx([4.3e-3] * 6, rel=0.05)
    assert np.std([r.W.real for r in reports]) == pytest.approx(1e-9, rel=0.05)
    deviation = gauges - gauges.mean(axis=0)
    correlation = np.mean(deviation[1:] * deviation[:-1], axis=0) / 4.3e-3**2
    assert np.all(np.abs(correlation) < 0.06)


def test_null_drifts_with_temperature_within_the_data_sheet():
    quiet = dataclasses.replace(REAL, gauge_noise=0.0)
    cold = np.array(read(quiet, temperature=20.0).gauges)
    warm = np.array(read(quiet, temperature=35.0).gauges)
    shift = np.abs(warm - cold)
    assert np.all(shift <= 0.041 + 1e-4)
    assert shift.max() > 0.01


def test_bow_leaves_the_slope_at_no_load():
    bent = dataclasses.replace(IDEAL, linearity=0.22)
    assert read(bent, Fx=0.01).gauges[0] == pytest.approx(0.01, abs=1e-4)
    assert read(bent, Fx=3.0).gauges[0] != pytest.approx(3.0, abs=1e-3)
    assert read(bent, Fx=3.0).gauges[0] == pytest.approx(3.0, abs=0.22)


def test_data_sheet_gauges_differ_in_sensitivity_and_its_shift():
    """A gauge of 17 % shifts by up to 5.5 % of its load over 25 K."""
    still = {"null": 0.0, "drift": 0.0, "linearity": 0.0, "gauge_noise": 0.0, "repeatability": 0.0}
    slopes, shifts = [], []
    for serial in range(100):
        sheet = dataclasses.replace(SensorParameters.data_sheet(serial), **still)
        cold = np.array(read(sheet, temperature=20.0, Fn=4.0).gauges[2:])
        warm = np.array(read(sheet, temperature=45.0, Fn=4.0).gauges[2:])
        slopes.extend(cold - 1.0)
        shifts.extend(warm - cold)
    for values, bound in ((slopes, 0.17), (shifts, 0.055)):
        assert -bound - 2e-4 <= min(values) < -0.95 * bound
        assert 0.95 * bound < max(values) <= bound + 2e-4


def test_repeatability_is_a_slow_error_in_proportion_to_the_load():
    sheet = SensorParameters.data_sheet()
    rows = np.concatenate([noise_block(sheet, 3, block)[:, 9:] for block in range(400)])
    assert np.std(rows, axis=0) == pytest.approx([1.0] * 6, rel=0.25)
    assert np.abs(np.diff(rows, axis=0)).max() < 0.01
    knot = 1024  # the mean of sin cos is left after one knot, and nothing after two
    assert np.mean(rows[:-knot] * rows[knot:]) == pytest.approx(1.0 / np.pi, abs=0.1)
    assert abs(np.mean(rows[: -2 * knot] * rows[2 * knot :])) < 0.1
    bare = dataclasses.replace(IDEAL, repeatability=sheet.repeatability)
    noise = [0.0] * 9 + [1.0, -1.0, 0.0, 0.0, 0.0, 2.0]
    for Fn in (1.0, 2.0):
        still = (0.0, 0.0, 0.0)
        S6 = readings(loaded(bare, Weight(Fn=Fn)), noise, 0j, 20.0, still)[1][5]
        assert pytest.approx(0.25 * Fn * (1.0 + 2.0 * 0.01923), abs=1e-4) == S6
    assert not noise_block(REAL, 3, 0)[:, 9:].any()


def test_a_weight_is_on_each_gauge_by_cross_talk_lever_and_bow() -> None:
    still = dataclasses.replace(REAL, gauge_noise=0.0)
    sensors = Sensors(still, 1)
    bare = sensors.measure(0, 0j, 20.0, (0.0, 0.0, 0.0)).gauges
    sensors.sensing = loaded(still, Weight(Fx=0.5, Fy=-0.25, Fn=2.0, x=7e-3))
    under = sensors.measure(0, 0j, 20.0, (0.0, 0.0, 0.0)).gauges
    loads = [0.5 - 0.04 * 0.25, -0.03 * 0.5 - 1.02 * 0.25, 0.375, 0.625, 0.375, 0.625]
    bows = [gauge.bow for gauge in sensing(still).gauges]
    expected = [load + bow * load * load for load, bow in zip(loads, bows, strict=True)]
    assert np.subtract(under, bare) == pytest.approx(expected, abs=1.01e-4)
    assert loaded(still, Weight(Fn=2.0)) == loaded(still, Weight(Fn=2.0, x=0.0))
    sensors.sensing = loaded(still, Weight())
    assert sensors.measure(0, 0j, 20.0, (0.0, 0.0, 0.0)).gauges == bare
