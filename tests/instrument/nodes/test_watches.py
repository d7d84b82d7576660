"""Watchdogs of each cycle but those of the vibration: each bound from both sides."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from one_watch import LIFTED, UNTARED, Watch

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.instrument.nodes.watches import full_bucket, leaked, levels
from smarttac_can.vocabulary.signals import Contact, Drive
from smarttac_can.vocabulary.watchdogs import Watchdog

VOLTAGE, TEMPERATURE, NORMAL, LATERAL = 1 << 9, 1 << 11, 1 << 12, 1 << 13
SATURATED, GAUGES, CONTROLLER, CALIBRATION = 1 << 14, 1 << 16, 1 << 19, 1 << 20
RESONANCE = 1 << 18
HALF = 0.028
"""Where the gauges are along x in m; those of one side are S3 and S5."""
ZERO = (0.1, -0.2, 0.3, -0.1, 0.05, 0.0)


def faults_after(cycles: int, **finger: float) -> int:
    """The last of some cycles with gauges that tell of one finger."""
    watch = Watch()
    return [look(watch, **finger) for _ in range(cycles)][-1] & (NORMAL | LATERAL | GAUGES)


def look(
    watch: Watch,
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
    contact = Contact(Fx, Fy, Fn, 0.0, 0.0, x, 0.0, touching=False)
    return watch.look(contact=contact, zero=zero, gauges=gauges)


@pytest.mark.parametrize(
    "odd", [{"twist": 0.3}, {"Fx": 2.4}, {"x": 0.05}, {"Fn": -0.3}], ids=lambda odd: next(iter(odd))
)
def test_gauges_that_contradict_in_4_of_5_cycles_are_a_fault(odd: dict[str, float]) -> None:
    watch = Watch()
    found = [look(watch, **(odd if cycle % 5 < 4 else {})) & GAUGES for cycle in range(7)]
    assert found == [0] * 6 + [GAUGES]


def test_a_new_zero_begins_the_count_anew() -> None:
    watch = Watch()
    new_zero = (*ZERO[:5], 0.01)
    zeros = [ZERO] * 4 + [new_zero] * 5
    faults = [look(watch, twist=0.3, zero=zero) & GAUGES for zero in zeros]
    assert faults == [0] * 8 + [GAUGES]


def test_finger_may_contradict_for_4_cycles_at_landing_and_lift() -> None:
    watch = Watch()
    for cycle in range(2000):
        # 6 landings a second; 61 sound cycles from each until the finger leaves.
        odd = cycle % 168 < 4 or 65 <= cycle % 168 < 69
        assert not look(watch, twist=0.3 if odd else 0.0)


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
    od = stimulator_od()
    od["Limit.Lowest frequency"].value = 4_270_000
    od["Limit.Highest frequency"].value = 4_400_000
    assert Watch(od).look(asked=Drive(voltage, frequency)) == fault


@pytest.mark.parametrize(("mode", "left_in", "fault"), [(4, 4, 0), (4, 0, CONTROLLER), (5, 0, 0)])
def test_controllers_that_leave_a_mode_are_in_doubt(mode: int, left_in: int, fault: int) -> None:
    """An identification ends by itself."""
    assert Watch().look(mode=mode, left_in=left_in) == fault


def seen(
    temperature: float = 20.0,
    saturation: tuple[int, ...] = (0,),
    serial: int = 1,
    calibrated: int = 1,
    **calibration: int,
) -> int:
    """Watches of cycles without a zero of the gauges."""
    od = stimulator_od()
    for name, raw in {"Plate serial number": calibrated, **calibration}.items():
        od[f"Calibration.{name.replace('_', ' ')}"].value = raw
    watch = Watch(od)
    return [
        watch.look(temperature=temperature, saturation=saturated, serial=serial)
        for saturated in saturation
    ][-1]


def test_a_plate_above_60_degrees_is_too_hot() -> None:
    assert seen(60.0) == 0
    assert seen(60.01) == TEMPERATURE


def test_a_sensor_at_its_end_for_2_cycles_is_saturated() -> None:
    assert seen(saturation=(32,)) == 0
    assert seen(saturation=(32, 1)) == SATURATED
    assert seen(saturation=(32, *[0] * 20, 32)) == 0
    assert seen(saturation=(32, *[0] * 19, 32)) == 0
    assert seen(saturation=(32, *[0] * 19, 32, 32)) == SATURATED


def test_pickup_at_its_end_for_6_cycles_is_saturated() -> None:
    assert seen(saturation=(64,) * 5) == 0
    assert seen(saturation=(64,) * 6) == SATURATED
    # Ten lifts a second with three such cycles each.
    assert seen(saturation=(64, 64, 64, *[0] * 97) * 20) == 0
    assert seen(saturation=(64, 64, 64, *[0] * 7) * 4) == SATURATED


def test_only_the_plate_of_the_calibration_will_do() -> None:
    assert seen(serial=1, calibrated=1) == 0
    assert seen(serial=2, calibrated=1) == CALIBRATION
    assert seen(serial=0, calibrated=0) == CALIBRATION
    singular = {f"{axis} from {sensor}": 5000 for axis in ("Fx", "Fy") for sensor in ("S1", "S2")}
    assert seen(**singular) == CALIBRATION, "it cannot tell the axes apart"


def test_a_stuck_sensor_is_told_from_a_quiet_one() -> None:
    def stuck(sensor: int, rest: int = 7) -> int:
        """Cycles until a sensor whose count stays is stuck."""
        watch = Watch()
        for cycles in range(1, 200):
            counts = [3 * cycles] * 9
            # A count or two of noise is no movement; the thermometer has none.
            counts[sensor] = rest if sensor == 8 else rest + cycles % 3
            if watch.look(counts=tuple(counts)) & 1 << 15:
                return cycles
        return 0

    assert [stuck(sensor) for sensor in range(9)] == [24] * 8 + [100]
    assert stuck(2, rest=0) == 24, "from the first sample on"


@pytest.mark.parametrize(("counts", "fault"), [(2, 1 << 15), (-2, 1 << 15), (3, 0), (-3, 0)])
def test_a_gauge_is_stuck_within_2_counts_of_its_first_sample(counts: int, fault: int) -> None:
    watch = Watch()
    for cycle in range(24):
        gauges = [3 * cycle] * 9
        gauges[3] = 700 + counts * (cycle % 2)
        found = watch.look(counts=tuple(gauges))
    assert found == fault


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
    # 1 um without a drive dies down by exp(-1/0.944) a tick.
    watch = Watch()
    vibration = watch.state.vibration._replace(E=1e-6)
    passed: list[int] = []
    for tick in ticks:
        watch.state = watch.state._replace(vibration=vibration)
        watch.look(zero=UNTARED, tick=tick)
        passed.append(round(-0.944 * math.log(watch.state.vibration.E * 1e6)))
    assert passed[1:] == told[1:]
    if ticks[0] == 0:
        assert passed[0] == 1, "the first tick of a run is 0"


@pytest.mark.parametrize("mode", range(7))
def test_a_count_is_of_its_modes_and_forgotten_in_the_others(mode: int) -> None:
    """The phase is lost for 60 cycles in mode friction, for one in another, and for 60 again."""
    watch = Watch()
    W = 1e-6 - 1.5e-6j
    watch.drive(75.0)
    found = 0
    for now in [4] * 60 + [mode] + [4] * 60:
        found |= watch.look(W, mode=now) & RESONANCE
    assert bool(found) == (mode in (3, 4, 6))


def test_gauges_never_tared_are_not_implausible() -> None:
    watch = Watch()
    for _ in range(10):
        look(watch, twist=0.3)
    assert watch.look(gauges=(0.0, 0.0, 9.0, 0.0, 0.0, 0.0)) & GAUGES == 0


def test_fault_levels_before_the_first_drive_are_0() -> None:
    watch = Watch()
    shares = levels(watch.plan, watch.state, watch.in_force, LIFTED, 30.0)
    assert shares.pop(Watchdog.TEMPERATURE) == 0.5
    assert set(shares.values()) == {0.0}
    watch.drive(75.0)
    assert levels(watch.plan, watch.state, watch.in_force, LIFTED, 0.0)[Watchdog.VOLTAGE] == 0.5


# Leaky buckets: faulty cycles in a row, and those that come again and again.


class Bucket:
    """A leaky bucket."""

    def __init__(self) -> None:
        self.level = 0

    def count(self, faulty: bool, most: int) -> bool:
        """Take a cycle, and tell whether there is a fault."""
        self.level = leaked(self.level, full_bucket(most), faulty)
        return self.level >= full_bucket(most)


def cycles_until_fault(pattern: list[bool], most: int, repeats: int = 1000) -> int | None:
    bucket = Bucket()
    for at, faulty in enumerate(pattern * repeats, 1):
        if bucket.count(faulty, most):
            return at
    return None


@pytest.mark.parametrize("most", [1, 2, 5, 10])
def test_so_many_in_a_row_are_a_fault_and_one_less_is_none(most: int) -> None:
    assert cycles_until_fault([True], most) == most
    assert cycles_until_fault([True] * (most - 1) + [False] * 20 * most, most) is None


@pytest.mark.parametrize(("sound", "at"), [(1, 11), (2, 16), (5, 37), (19, 1601)])
def test_a_fault_that_comes_again_and_again_is_one(sound: int, at: int) -> None:
    assert cycles_until_fault([True] + [False] * sound, 5) == at


def test_one_in_twenty_one_cycles_is_forgotten() -> None:
    assert cycles_until_fault([True] + [False] * 20, 2) is None


@given(st.lists(st.booleans(), max_size=400), st.integers(1, 10))
def test_counts_without_a_fault_are_rare_in_every_window(pattern: list[bool], most: int) -> None:
    bucket = Bucket()
    quiet: list[bool] = []
    for faulty in pattern:
        if bucket.count(faulty, most):
            quiet.clear()
            continue
        quiet.append(faulty)
        for begin in range(len(quiet)):
            window = quiet[begin:]
            assert sum(window) < (20 * most + len(window)) / 21


@given(st.lists(st.booleans(), max_size=60), st.integers(1, 10))
def test_past_fault_is_forgotten_within_21_sound_cycles(pattern: list[bool], most: int) -> None:
    bucket = Bucket()
    for faulty in pattern:
        bucket.count(faulty, most)
    assert not any([bucket.count(False, most) for _ in range(40)][20:])
