"""What is looked at in each cycle but the vibration: each bound from both sides."""

import math
from types import SimpleNamespace
from typing import Any

import pytest

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.nodes.cycle_input import Measured
from smarttac_can.nodes.loop_watchdogs import LoopWatchdogs
from smarttac_can.vocabulary.signals import Contact, Drive, Measurement

VOLTAGE, TEMPERATURE, NORMAL, LATERAL = 1 << 9, 1 << 11, 1 << 12, 1 << 13
SATURATED, GAUGES, CONTROLLER, CALIBRATION = 1 << 14, 1 << 16, 1 << 19, 1 << 20
NOTHING = Contact(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, touching=False)
HALF = 0.028
"""Where the gauges are along x in m; those of one side are S3 and S5."""
ZERO = (0.1, -0.2, 0.3, -0.1, 0.05, 0.0)


def faults_after(cycles: int, **finger: float) -> int:
    """What the last of some cycles shows of gauges that tell of one finger."""
    watchdogs = LoopWatchdogs(stimulator_od())
    return [look(watchdogs, at, **finger) for at in range(cycles)][-1] & (NORMAL | LATERAL | GAUGES)


def look(
    watchdogs: LoopWatchdogs,
    at: int,
    *,
    Fn: float = 1.0,
    Fx: float = 0.0,
    Fy: float = 0.0,
    x: float = 0.0,
    twist: float = 0.0,
    zero: tuple[float, ...] = ZERO,
) -> int:
    lean = x / HALF
    left, right = 0.25 * Fn * (1 - lean), 0.25 * Fn * (1 + lean)
    loads = (0.0, 0.0, left + twist / 4, right - twist / 4, left - twist / 4, right + twist / 4)
    gauges = tuple(load + offset for load, offset in zip(loads, zero, strict=True))
    cascade: Any = SimpleNamespace(
        contact=Contact(Fx, Fy, Fn, 0.0, 0.0, x, 0.0, touching=False),
        tared=True,
        zero=zero,
        parameters=SimpleNamespace(gauge_positions=(-HALF, HALF, -HALF, HALF)),
    )
    measurement = Measurement(0j, gauges, 20.0, 0)  # type: ignore[arg-type]
    # Counts that differ from cycle to cycle: no sensor is stuck.
    return watchdogs.look(Measured(measurement, (at,) * 9, 0, 1), 0, cascade)


def test_four_cycles_are_none_and_five_are_a_fault() -> None:
    assert faults_after(4, twist=0.3) == 0
    assert faults_after(5, twist=0.3) == GAUGES


@pytest.mark.parametrize(
    "odd", [{"twist": 0.3}, {"Fx": 2.4}, {"x": 0.05}, {"Fn": -0.3}], ids=lambda odd: next(iter(odd))
)
@pytest.mark.parametrize(
    ("off", "sound", "at"), [(4, 1, 7), (1, 1, 11), (1, 2, 16), (1, 19, 1601), (1, 20, None)]
)
def test_gauges_that_contradict_now_and_then_are_a_fault(
    odd: dict[str, float], off: int, sound: int, at: int | None
) -> None:
    watchdogs = LoopWatchdogs(stimulator_od())
    for cycle in range(1, 3001):
        bad = (cycle - 1) % (off + sound) < off
        if look(watchdogs, cycle, **(odd if bad else {})) & GAUGES:
            assert cycle == at
            return
    assert at is None


def test_a_new_zero_begins_the_count_anew() -> None:
    watchdogs = LoopWatchdogs(stimulator_od())
    new_zero = (*ZERO[:5], 0.01)
    zeros = [ZERO] * 4 + [new_zero] * 5
    faults = [look(watchdogs, at, twist=0.3, zero=zero) & GAUGES for at, zero in enumerate(zeros)]
    assert faults == [0] * 8 + [GAUGES]


def test_a_finger_may_contradict_for_4_cycles_when_it_lands_and_when_it_leaves() -> None:
    watchdogs = LoopWatchdogs(stimulator_od())
    for cycle in range(2000):
        # 6 landings a second; 61 sound cycles from each until the finger leaves.
        odd = cycle % 168 < 4 or 65 <= cycle % 168 < 69
        assert not look(watchdogs, cycle, twist=0.3 if odd else 0.0)


@pytest.mark.parametrize(
    ("finger", "fault"),
    [
        ({"twist": 0.198}, 0),
        ({"twist": 0.202}, GAUGES),
        ({"twist": -0.202}, GAUGES),
        # 38 mm are the end of the plate: 1 N, and 0.2 N of mismatch, there make 45.6 N mm.
        ({"x": 0.0454}, 0),
        ({"x": 0.0458}, GAUGES),
        ({"x": -0.0458}, GAUGES),
        ({"Fn": -0.2}, 0),
        ({"Fn": -0.202}, GAUGES),
        # Twice the normal force, and the mismatch.
        ({"Fx": 2.198}, 0),
        ({"Fx": 2.202}, GAUGES),
        ({"Fy": -2.202}, GAUGES),
        ({"Fn": 0.1, "Fx": 0.398}, 0),
        ({"Fn": 0.1, "Fx": 0.402}, GAUGES),
        # Pulled, it has no friction: the mismatch alone is left.
        ({"Fn": -0.1, "Fx": 0.198}, 0),
        ({"Fn": -0.1, "Fx": 0.202}, GAUGES),
        ({"Fn": 4.0}, 0),
        ({"Fn": 4.001}, NORMAL),
        ({"Fn": 2.0, "Fx": 3.0}, 0),
        ({"Fn": 2.0, "Fx": 1.8, "Fy": 2.401}, LATERAL),
    ],
)
def test_each_bound_from_both_sides(finger: dict[str, float], fault: int) -> None:
    assert faults_after(5, **finger) == fault


@pytest.mark.parametrize(
    ("voltage", "frequency", "fault"),
    [
        (150.0, 43_390.0, 0),
        (150.01, 43_390.0, VOLTAGE),
        (0.0, 42_700.0, 0),
        (0.0, 44_000.0, 0),
        (0.0, 42_699.99, CONTROLLER),
        (0.0, 44_000.01, CONTROLLER),
        (-0.01, 43_390.0, CONTROLLER),
        (math.inf, 43_390.0, CONTROLLER),
        (math.nan, 43_390.0, CONTROLLER),
        (0.0, math.nan, CONTROLLER),
    ],
)
def test_a_drive_before_it_goes_out(voltage: float, frequency: float, fault: int) -> None:
    parameters = CascadeParameters(V_max=150.0, f_min=42_700.0, f_max=44_000.0)
    watchdogs = LoopWatchdogs(stimulator_od())
    assert watchdogs.judge(Drive(voltage, frequency), parameters) == fault


def seen(
    temperature: float = 20.0,
    saturation: tuple[int, ...] = (0,),
    serial: int = 1,
    calibrated: int = 1,
    **calibration: int,
) -> int:
    """What cycles without a zero of the gauges show."""
    od = stimulator_od()
    for name, raw in {"Plate serial number": calibrated, **calibration}.items():
        od[f"Calibration.{name.replace('_', ' ')}"].value = raw
    watchdogs = LoopWatchdogs(od)
    cascade: Any = SimpleNamespace(contact=NOTHING, tared=False)
    faults = 0
    for at, saturated in enumerate(saturation):
        measurement = Measurement(0j, (0.0,) * 6, temperature, saturated)
        faults = watchdogs.look(Measured(measurement, (at,) * 9, 0, serial), 0, cascade)
    return faults


def test_a_plate_above_60_degrees_is_too_hot() -> None:
    assert seen(60.0) == 0
    assert seen(60.01) == TEMPERATURE


def test_a_sensor_at_its_end_for_2_cycles_is_saturated() -> None:
    assert seen(saturation=(64,)) == 0
    assert seen(saturation=(64, 1)) == SATURATED
    assert seen(saturation=(64, *[0] * 20, 64)) == 0
    assert seen(saturation=(64, *[0] * 19, 64)) == 0
    assert seen(saturation=(64, *[0] * 19, 64, 64)) == SATURATED


def test_only_the_plate_of_the_calibration_will_do() -> None:
    assert seen(serial=1, calibrated=1) == 0
    assert seen(serial=2, calibrated=1) == CALIBRATION
    assert seen(serial=0, calibrated=0) == CALIBRATION
    singular = {f"{axis} from {sensor}": 5000 for axis in ("Fx", "Fy") for sensor in ("S1", "S2")}
    assert seen(**singular) == CALIBRATION, "it cannot tell the axes apart"


def test_a_stuck_sensor_is_told_from_a_quiet_one() -> None:
    watchdogs = LoopWatchdogs(stimulator_od())
    cascade: Any = SimpleNamespace(contact=NOTHING, tared=False)
    measurement = Measurement(0j, (0.0,) * 6, 20.0, 0)

    def stuck(sensor: int, rest: int = 7) -> int:
        """Cycles until a sensor whose count stays is stuck."""
        watchdogs.reset()
        for cycles in range(1, 200):
            counts = [3 * cycles] * 9
            # A count or two of noise is no movement; the thermometer has none.
            counts[sensor] = rest if sensor == 8 else rest + cycles % 3
            if watchdogs.look(Measured(measurement, tuple(counts), 0, 1), 0, cascade) & 1 << 15:
                return cycles
        return 0

    assert [stuck(sensor) for sensor in range(9)] == [24] * 8 + [100]
    assert stuck(2, rest=0) == 24, "from the first sample on"


@pytest.mark.parametrize(
    ("ticks", "told"),
    [
        ([0, 1, 2, 3], [1, 1, 1, 1]),
        ([254, 255, 0, 1], [1, 1, 1, 1]),
        ([0, 3, 17, 17], [1, 3, 14, 0]),
        # More than half of the count is a step back: the plate began anew.
        ([100, 227, 98, 99, 10], [1, 127, 127, 1, 1]),
        ([100, 228], [1, 1]),
    ],
)
def test_the_vibration_is_told_how_many_ticks_have_passed(
    ticks: list[int], told: list[int]
) -> None:
    watchdogs = LoopWatchdogs(stimulator_od())
    passed: list[int] = []
    cascade: Any = SimpleNamespace(contact=NOTHING, tared=False, zero=ZERO)

    def seen(_W: complex, _contact: Contact, _temperature: float, _mode: int, ticks: int) -> int:
        passed.append(ticks)
        return 0

    vibration: Any = SimpleNamespace(look=seen)
    watchdogs.vibration = vibration
    for at, tick in enumerate(ticks):
        measurement = Measurement(0j, ZERO, 20.0, 0)
        watchdogs.look(Measured(measurement, (at,) * 9, tick, 1), 0, cascade)
    assert passed[1:] == told[1:]
    if ticks[0] == 0:
        assert passed[0] == 1, "the first tick of a run is 0"
