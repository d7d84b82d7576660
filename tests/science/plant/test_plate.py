import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.science.plant.finger import Lifted, Stroke, Trajectory
from smarttac_can.science.plant.friction import sliding_coefficient
from smarttac_can.science.plant.parameters import PlateParameters, SensorParameters
from smarttac_can.science.plant.plate import Plate
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.vocabulary.signals import Drive

PARAMETERS = PlateParameters()
OFF = Drive(0.0, 43390.0)
ON = Drive(40.0, 43390.0)
PRESSED = Trajectory([(0.0, 0.0, 0.5), (100.0, 0.0, 0.5)])


def make(finger=None, **options):
    return Plate(PARAMETERS, SUBJECTS[1], finger or Lifted(), **options)


def run(plate, drives):
    old = OFF
    reports = []
    for drive in drives:
        reports.append(plate.sample())
        plate.step(old, drive)
        old = drive
    return reports


def alternating(ticks):
    return [Drive(30.0 + 20.0 * (k // 20 % 2), 43390.0) for k in range(ticks)]


def test_starts_at_rest_at_ambient():
    plate = make(ambient=27.0)
    assert (plate.tick, plate.W, plate.temperature, plate.Ft) == (0, 0j, 27.0, 0.0)
    assert plate.mu_true == 0.0
    moving = Trajectory([(0.0, -0.01, 0.3), (2.0, 0.01, 0.5)])
    assert make(moving).finger_state == moving.at(0.0)
    assert plate.resonance == pytest.approx(43390.0 - 14 * 7)


def test_plate_at_rest_stays_at_rest_and_dry_without_a_finger():
    plate = make()
    assert not any(plate._state.motion[:-1])
    assert not any(plate._state.motion.pickup)
    run(plate, [OFF] * 5)
    motion = plate._state.motion
    assert not any(motion._replace(omega=0.0, pickup=motion.pickup[0]))
    assert plate.occlusion == 0.0


def test_a_steady_slide_has_the_friction_of_the_map():
    plate = make(Trajectory([(0.0, -0.03, 0.5), (1.0, 0.03, 0.5)]))
    run(plate, [ON] * 300)
    mu = sliding_coefficient(SUBJECTS[1], abs(plate.W), 0.06, 0.5, plate.occlusion, f0=43390.0)
    assert plate.mu_true == pytest.approx(mu, rel=1e-3)


def test_same_seed_same_bits_other_seed_other_noise():
    first, again, other = (
        run(make(Stroke(seed=3), seed=seed), alternating(700)) for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_sampling_twice_changes_nothing():
    once, twice = make(Stroke(), seed=1), make(Stroke(), seed=1)
    for drive in alternating(400):
        report = once.sample()
        assert twice.sample() == report
        assert twice.sample() == report
        once.step(drive, drive)
        twice.step(drive, drive)


def test_vibration_settles_at_gain_times_voltage():
    plate = make()
    run(plate, [ON] * 20)
    assert abs(plate.W) == pytest.approx(40 * PARAMETERS.resonator.gain, rel=1e-3)
    run(plate, [OFF] * 20)
    assert abs(plate.W) < 1e-14


@pytest.mark.parametrize("detuning", [-4000.0, 300.0, 4000.0])
def test_free_decay_is_independent_of_the_drive_frequency(detuning):
    """W is seen from the frame of the drive: to change the frame alone moves nothing."""
    kept, changed = make(), make()
    run(kept, [ON] * 30)
    run(changed, [ON] * 30)
    for _ in range(3):
        kept.step(OFF, OFF)
        changed.step(OFF._replace(frequency=43390.0 + detuning), Drive(0.0, 43390.0 + detuning))
        assert abs(changed.W) == pytest.approx(abs(kept.W), rel=1e-9)
    assert 0.0 < abs(kept.W) < 0.1 * 2e-6


def test_touch_takes_vibration_away():
    free, touched = make(), make(PRESSED)
    for plate in (free, touched):
        run(plate, [ON] * 30)
    assert abs(touched.W) < 0.8 * abs(free.W)
    assert touched.W.imag > 0.0


@pytest.mark.parametrize("dead_time", [0.0, 1e-4, 0.45e-3, 1e-3])
def test_dead_time_splits_the_tick_between_old_and_new(dead_time):
    plate = make(dead_time=dead_time)
    plate.step(ON, OFF)
    gain, tau = PARAMETERS.resonator.gain, PARAMETERS.resonator.tau
    expected = 40 * gain * (1 - math.exp(-dead_time / tau)) * math.exp((dead_time - 1e-3) / tau)
    # The terms of second order ripple at twice the drive frequency: V N/(m (2w)^2) and less.
    ripple = 40 * gain / (2 * math.pi * 43390.0 * tau)
    assert abs(plate.W) == pytest.approx(expected, abs=0.3 * ripple)


def test_dead_time_0_ignores_the_old_drive_and_1_ms_the_new():
    for dead_time, drives in ((0.0, (OFF, ON)), (1e-3, (ON, OFF))):
        plate = make(dead_time=dead_time)
        plate.step(*drives)
        reference = make()
        reference.step(ON, ON)
        assert plate.W == reference.W


@given(
    dead_time=st.floats(0.0, 1e-3),
    old=st.floats(0.0, 150.0),
    new=st.floats(0.0, 150.0),
    detuning=st.floats(-500.0, 500.0),
)
@settings(max_examples=40)
def test_any_dead_time_with_equal_drives_is_none(dead_time, old, new, detuning):
    drives = [Drive(old, 43390.0 + detuning), Drive(new, 43390.0)]
    plain, delayed = make(PRESSED), make(PRESSED, dead_time=dead_time)
    for drive in drives:
        plain.step(drive, drive)
        delayed.step(drive, drive)
    assert abs(delayed.W - plain.W) <= 1e-9 * abs(plain.W) + 1e-20


@pytest.mark.parametrize(
    "wrong",
    [
        *(Drive(voltage, 43390.0) for voltage in (-1.0, 1001.0, math.nan)),
        *(Drive(1.0, frequency) for frequency in (-1.0, 1e6 + 1.0, math.inf)),
    ],
)
def test_refuses_a_drive_and_stays_as_it_was(wrong):
    plate = make(Stroke())
    before = plate.sample()
    for drives in ((wrong, OFF), (OFF, wrong), (wrong, wrong)):
        with pytest.raises(ValueError, match=r"^drive .* is outside 0\.\.1000 V"):
            plate.step(*drives)
    assert plate.tick == 0
    assert plate.sample() == before


def test_takes_any_drive_up_to_its_limits():
    plate = make()
    for drive in (Drive(0.0, 0.0), Drive(1000.0, 1e6)):
        plate.step(drive, drive)
    assert plate.tick == 2


@pytest.mark.parametrize("ambient", [-20.0, 60.0])
def test_any_ambient_of_a_room_is_the_temperature_at_first(ambient):
    assert make(ambient=ambient).temperature == ambient
    with pytest.raises(ValueError, match=r"^ambient .* is outside"):
        make(ambient=ambient * 1.01)


@pytest.mark.parametrize(("name", "value"), [("dead_time", 2e-3), ("seed", -1)])
def test_refuses_arguments(name, value):
    with pytest.raises(ValueError, match=rf"^{name} {value} is outside"):
        make(**{name: value})


def test_vibration_heats_the_plate_and_lowers_its_resonance():
    plate = make(ambient=20.0)
    run(plate, [ON] * 2000)
    assert 20.0 < plate.temperature < 21.0
    assert plate.resonance < 43390.0
    loss = 0.5 * PARAMETERS.resonator.damping * (math.pi * 43390.0 * abs(plate.W)) ** 2
    final = PARAMETERS.thermal.resistance * loss
    share = -math.expm1(-2.0 / PARAMETERS.thermal.time_constant)
    assert plate.temperature - 20.0 == pytest.approx(final * share, rel=0.02)


def test_gauges_show_the_finger():
    quiet = SensorParameters(
        null=0.0, drift=0.0, linearity=0.0, gauge_noise=0.0, pickup_noise=0.0, temperature_noise=0.0
    )
    plate = Plate(PlateParameters(sensors=quiet), SUBJECTS[1], Stroke(seed=2))
    for _ in range(500):
        plate.step(OFF, OFF)
    gauges = plate.sample().gauges
    assert sum(gauges[2:]) == pytest.approx(plate.Fn, abs=3e-4)
    assert gauges[0] == pytest.approx(plate.Ft, rel=0.01)
    assert plate.mu_true == pytest.approx(SUBJECTS[1].mu0, rel=0.05)
    assert -15e-3 < plate.position < 15e-3


def test_friction_follows_the_direction_of_the_finger():
    plate = make(Stroke(seed=2))
    signs = set()
    for _ in range(2500):
        x = plate.position
        plate.step(OFF, OFF)
        if plate.Fn > 0.1 and abs(plate.position - x) > 4e-5:
            signs.add(math.copysign(1.0, plate.Ft) == math.copysign(1.0, plate.position - x))
    assert signs == {True}


def test_occlusion_raises_friction_over_seconds():
    plate = make(Trajectory([(0.0, -0.03, 0.5), (1.0, 0.03, 0.5)]))
    for _ in range(500):
        plate.step(OFF, OFF)
    assert plate.occlusion == pytest.approx(-math.expm1(-0.5 / 20.0), rel=1e-6)


def test_the_load_grows_as_a_hertz_contact_with_the_force():
    amplitudes = []
    for Fn in (0.25, 2.0):
        plate = make(Trajectory([(0.0, 0.0, Fn), (100.0, 0.0, Fn)]))
        # At its resonance the load damps and detunes: 1/A - 1/A_bare is a complex load.
        run(plate, [ON] * 40)
        amplitudes.append(1 / plate.W)
    bare = make()
    run(bare, [ON] * 40)
    light, heavy = (abs(amplitude - 1 / bare.W) for amplitude in amplitudes)
    assert heavy / light == pytest.approx(4.0, rel=0.02), "8 times the force, to the power of 2/3"


def test_moment_covers_the_whole_tick_as_the_normal_force():
    plate = make(Trajectory([(0.0, 0.012, 0.0), (0.1, 0.012, 1.0), (1.0, 0.012, 1.0)]))
    for _ in range(150):
        plate.step(OFF, OFF)
        assert plate._state.moment == pytest.approx(0.012 * plate._state.Fn, abs=1e-12)
    assert plate._state.Fn == pytest.approx(1.0, rel=0.01)
