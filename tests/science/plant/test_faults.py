"""Faults, the readings of a broken plate, and that mending leaves no trace."""

from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.science.plant.faults import Fault, PowerStage, broken
from smarttac_can.science.plant.finger import Lifted, Stroke
from smarttac_can.science.plant.parameters import PlateParameters
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.vocabulary.faults import (
    GAUGES,
    PICKUP,
    PICKUP_D,
    PICKUP_Q,
    THERMOMETER,
    FaultKind,
)
from smarttac_can.vocabulary.signals import PICKUP_SATURATED, Drive, Measurement

DRIVE = Drive(20.0, 43390.0)
SOUND = Fault(FaultKind.NONE, 1, 0)
SENSORS = PlateParameters().sensors
UNITS_AND_STEPS = [
    *[(1e-3, SENSORS.gauge_resolution)] * 6,
    *[(1e-9, SENSORS.pickup_resolution)] * 2,
    (1e-2, SENSORS.temperature_resolution),
]
"""Of the value of a fault, and of the converter, of the sensors 1 to 9 in SI units."""


def plate(finger: bool = True) -> Plate:
    motion = Stroke(rest=0.0, press=0.01) if finger else Lifted()
    return Plate(PlateParameters(), SUBJECTS[1], motion, seed=3)


def run(it: Plate, ticks: int) -> list[Measurement]:
    said = []
    for _ in range(ticks):
        it.step(DRIVE, DRIVE)
        said.append(it.sample())
    return said


def both(fault: Fault, ticks: int = 20) -> tuple[list[Measurement], list[Measurement]]:
    """Measurements of a sound plate, and of one that breaks after 30 ticks."""
    sound, broken = plate(), plate()
    run(sound, 30)
    run(broken, 30)
    broken.inject(fault)
    return run(sound, ticks), run(broken, ticks)


def readings(said: Measurement) -> list[float]:
    """The readings of the sensors 1 to 9."""
    return [*said.gauges, said.W.real, said.W.imag, said.temperature]


@pytest.mark.parametrize("sensor", range(1, 10))
@pytest.mark.parametrize(
    ("kind", "value", "expected"),
    [
        (FaultKind.DEAD, 0, lambda sound, size, end: [0.0 for _ in sound]),
        (FaultKind.STUCK, 0, lambda sound, size, end: [sound[0] for _ in sound]),
        (FaultKind.OFFSET, 300, lambda sound, size, end: [x + size for x in sound]),
        (FaultKind.SPIKE, 800, lambda sound, size, end: [sound[0] + size, *sound[1:]]),
        (FaultKind.SATURATED, 0, lambda sound, size, end: [end for _ in sound]),
        (FaultKind.SATURATED, -1, lambda sound, size, end: [-end for _ in sound]),
        (FaultKind.OFFSET, 1_000_000, lambda sound, size, end: [end for _ in sound]),
    ],
)
def test_broken_sensor_reads_by_its_kind_others_are_unchanged(
    kind: FaultKind, value: int, expected: Callable[..., list[float]], sensor: int
) -> None:
    sound, broken = both(Fault(kind, sensor, value))
    before, after = ([readings(said) for said in run] for run in (sound, broken))
    mine = [reading.pop(sensor - 1) for reading in after]
    its = [reading.pop(sensor - 1) for reading in before]
    assert after == before
    assert len(set(its)) > 1, "a sound sensor is not stuck"
    unit, step = UNITS_AND_STEPS[sensor - 1]
    end = 32767 * step
    wanted = expected(its, value * unit, end)
    assert mine == pytest.approx(wanted, rel=1e-9, abs=1e-6 * unit)
    bit = 1 << (sensor - 1) if sensor <= GAUGES else PICKUP_SATURATED
    told = bit if wanted[0] in (end, -end) and sensor != THERMOMETER else 0
    assert {said.saturated for said in broken} == {told}


@pytest.mark.parametrize("sensor", [1, 5, THERMOMETER])
def test_gain_fault_scales_the_reading_to_the_nearest_count(sensor: int) -> None:
    sound, broken = both(Fault(FaultKind.GAIN, sensor, 777))
    _, step = UNITS_AND_STEPS[sensor - 1]
    for one, other in zip(sound, broken, strict=True):
        before, after = readings(one)[sensor - 1], readings(other)[sensor - 1]
        assert after == pytest.approx(0.777 * before, abs=0.501 * step)


def test_noise_is_as_large_as_asked_for_and_the_same_twice() -> None:
    sound, broken = both(Fault(FaultKind.NOISE, 6, 200), ticks=400)
    _, again = both(Fault(FaultKind.NOISE, 6, 200), ticks=400)
    assert broken == again
    extra = [b.gauges[5] - a.gauges[5] for a, b in zip(sound, broken, strict=True)]
    assert (sum(x * x for x in extra) / len(extra)) ** 0.5 == pytest.approx(0.2, rel=0.15)


def test_one_tick_reads_the_same_however_often() -> None:
    it = plate()
    it.inject(Fault(FaultKind.NOISE, PICKUP_D, 300))
    run(it, 5)
    assert it.sample() == it.sample()


def test_crack_shifts_the_resonance_and_so_does_heat() -> None:
    it = plate()
    before = it.resonance
    it.inject(Fault(FaultKind.RESONANCE_SHIFT, 1, -900))
    assert it.resonance == pytest.approx(before - 900.0)
    it.inject(Fault(FaultKind.TEMPERATURE, 1, 8000))
    assert it.temperature == 80.0
    assert it.resonance == pytest.approx(before - 60 * 14.0)


def test_slam_fault_does_not_heat_the_plate() -> None:
    it = plate(finger=False)
    run(it, 50)
    warm = it.temperature
    assert warm != plate().temperature
    it.inject(Fault(FaultKind.SLAM, 1, 100))
    assert it.temperature == warm


def test_half_the_quality_halves_the_vibration() -> None:
    sound, lossy = plate(finger=False), plate(finger=False)
    lossy.inject(Fault(FaultKind.QUALITY, 1, 500))
    W_sound, W_broken = abs(run(sound, 30)[-1].W), abs(run(lossy, 30)[-1].W)
    assert W_broken == pytest.approx(0.5 * W_sound, rel=0.01)


def test_slam_presses_through_the_force_path() -> None:
    it = plate()
    run(it, 50)
    force = it.Fn
    it.inject(Fault(FaultKind.SLAM, 1, 8000))
    run(it, 1)
    assert it.Fn == pytest.approx(force + 8.0, abs=0.01)


@pytest.mark.parametrize("kind", [k for k in FaultKind if k is not FaultKind.STAGE_STUCK])
def test_mended_before_its_first_step_leaves_no_trace(kind: FaultKind) -> None:
    sound, mended = plate(), plate()
    mended.inject(Fault(kind, 3, 900))
    mended.inject(SOUND)
    assert run(sound, 20) == run(mended, 20)


def test_only_one_fault_at_a_time() -> None:
    it = plate()
    it.inject(Fault(FaultKind.SLAM, 1, 8000))
    it.inject(Fault(FaultKind.RESONANCE_SHIFT, 1, 100))
    run(it, 20)
    assert it.Fn < 1.0


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        (Fault(FaultKind.DEAD, 10, 0), "sensor 10 is outside 1..9"),
        (Fault(FaultKind.QUALITY, 1, 0), "quality 0 is outside 20..1000"),
        (Fault(FaultKind.SLAM, 1, -1), "slam -1 is outside 0..100000"),
        (Fault(FaultKind.OFFSET, 1, 2_000_000), "offset 2000000 is outside"),
    ],
)
def test_fault_without_sense_is_refused_and_nothing_changes(fault: Fault, complaint: str) -> None:
    it, sound = plate(), plate()
    with pytest.raises(ValueError, match=complaint):
        it.inject(fault)
    assert run(it, 5) == run(sound, 5)


def test_conversion_does_not_break() -> None:
    whole = PlateParameters()
    cracked = broken(whole, Fault(FaultKind.QUALITY, 1, 300))
    assert cracked.resonator.conversion == pytest.approx(whole.resonator.conversion)
    assert replace(cracked, resonator=whole.resonator) == whole


@pytest.mark.parametrize(
    ("sensor", "d", "q"), [(PICKUP, 0.1, 0.1), (PICKUP_D, 0.1, 1.0), (PICKUP_Q, 1.0, 0.1)]
)
def test_a_pickup_loses_gain_before_its_converter(sensor: int, d: float, q: float) -> None:
    it = plate(finger=False)
    it.inject(Fault(FaultKind.GAIN, sensor, 100))
    for _ in range(30):
        it.step(Drive(150.0, 43450.0), Drive(150.0, 43450.0))
    assert abs(it.W) > 4e-6, "beyond the range of the converter"
    reading = it.sample()
    assert reading.W.real == pytest.approx(min(d * it.W.real, 3.2767e-6), abs=5e-9)
    assert reading.W.imag == pytest.approx(max(q * it.W.imag, -3.2767e-6), abs=5e-9)
    assert bool(reading.saturated) == (sensor == PICKUP_Q)


@pytest.mark.parametrize("gain", [500, 1000, 2000])
@pytest.mark.parametrize(("sensor", "axes"), [(PICKUP, "dq"), (PICKUP_D, "d"), (PICKUP_Q, "q")])
def test_any_gain_is_that_of_its_axes_alone(sensor: int, axes: str, gain: int) -> None:
    it = plate(finger=False)
    it.inject(Fault(FaultKind.GAIN, sensor, gain))
    it.step(Drive(20.0, 43450.0), Drive(20.0, 43450.0))
    shown, true = it.sample().W, it.W
    for axis, one, other in (("d", shown.real, true.real), ("q", shown.imag, true.imag)):
        assert one == pytest.approx((gain * 1e-3 if axis in axes else 1.0) * other, abs=5e-9)


def test_only_the_gain_is_lost_on_both_axes_at_once() -> None:
    with pytest.raises(ValueError, match=r"sensor 10 is outside 1\.\.9"):
        plate().inject(Fault(FaultKind.STUCK, PICKUP, 0))


voltages = st.floats(0.0, 500.0) | st.just(0.0)


@given(stuck=voltages, commanded=voltages)
@settings(max_examples=50)
def test_stage_follows_its_command_unless_stuck(stuck, commanded):
    stage = PowerStage()
    assert stage.put_out(commanded) == commanded
    stage.stick(stuck)
    assert stage.put_out(commanded) == (0.0 if commanded == 0.0 else stuck or commanded)
    stage.stick(0.0)
    assert stage.put_out(commanded) == commanded
