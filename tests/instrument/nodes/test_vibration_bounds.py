"""The two bounds of the vibration in numbers, of a plate with 50 nm/V: 5 um at 100 V."""

import cmath
import math

import pytest
from one_watch import RESONANCE_HZ, Watch

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.instrument.nodes.bounds import UNDRIVEN, bound_plan, follow, still
from smarttac_can.vocabulary.model import contact_load
from smarttac_can.vocabulary.signals import Contact, Drive, Measurement

OPEN_LOOP, AMPLITUDE_MODE, TRACKED, IDENTIFY = 1, 2, 3, 5
DONE = 2
AMPLITUDE, PICKUP, RESONANCE, UNSEEN = 1 << 10, 1 << 17, 1 << 18, 1 << 23


def pressing(Fn: float) -> Contact:
    return Contact(0.0, 0.0, Fn, 0.0, 0.0, 0.0, 0.0, touching=Fn > 0.0)


def bound_um(watch: Watch) -> float:
    return abs(watch.state.vibration.most) * 1e6


def watch_of(deadlines: tuple[int, ...] = (), limit: int = 10_000, **model: int) -> Watch:
    od = stimulator_od()
    for name, raw in model.items():
        od[f"Model.{name.replace('_', ' ')}"].value = raw
    od["Limit.Amplitude by drive"].value = limit
    return Watch(od, min(deadlines, default=3))


def seen(
    watch: Watch,
    cycles: int,
    um: complex = 0j,
    Fn: float = 0.0,
    *,
    volts: float = 100.0,
    hertz: float = RESONANCE_HZ,
    temperature: float = 20.0,
    mode: int = AMPLITUDE_MODE,
    late: bool = False,
) -> list[int]:
    """The faults of cycles with one drive and one reading."""
    faults = []
    for _ in range(cycles):
        watch.drive(volts, hertz, late=late)
        faults.append(watch.look(um * 1e-6, pressing(Fn), temperature, mode))
    return faults


def first(fault: int, faults: list[int]) -> int:
    """In which cycle a fault comes first; 0 if it does not."""
    return next((at for at, found in enumerate(faults, 1) if found & fault), 0)


def settled(watch: Watch, um: complex, Fn: float = 0.0, *, volts: float = 100.0) -> Watch:
    """A watch after 40 cycles under a voltage, with a reading that follows from it."""
    seen(watch, 40, um, Fn, volts=volts)
    return watch


def cycles_to(
    fault: int, watch: Watch, um: complex, Fn: float = 0.0, mode: int = AMPLITUDE_MODE
) -> int:
    """How many cycles of a reading make a fault; 0 if 200 do not."""
    return first(fault, seen(watch, 200, um, Fn, mode=mode))


def turned(um: float, degrees: float) -> complex:
    return cmath.rect(um, math.radians(degrees))


@pytest.mark.parametrize("reads", [0j, 0.3j, 5.0 + 0j, turned(2.5, 60)])
@pytest.mark.parametrize(
    ("Fn", "bound"),
    [
        (0.0, 5.0),
        (-1.0, 5.0),
        # A Hertz contact under 0.9 x 1 N - 0.05 N: 1 + 0.4 (0.85/0.5)^(2/3) = 1.5697.
        (1.0, 3.1853),
        # ... and under 0.9 x 0.5 N - 0.05 N: 1 + 0.4 (0.4/0.5)^(2/3) = 1.3447.
        (0.5, 3.7183),
    ],
)
def test_bound_from_above_whatever_the_pickup_reads(
    reads: complex, Fn: float, bound: float
) -> None:
    assert bound_um(settled(watch_of(), reads, Fn)) == pytest.approx(bound, abs=2e-4)


def identified(**model: int) -> Watch:
    return watch_of(State=DONE, **model)


def share_at(hertz: float, damping: float = 1.0) -> float:
    """The resonance curve, by hand: tau is 0.944 ms."""
    return damping / math.hypot(damping, 2.0 * math.pi * 0.944e-3 * hertz)


@pytest.mark.parametrize(
    ("hertz", "temperature", "Fn", "off"),
    [
        (43_390.0, 20.0, 0.0, 0.0),
        # 2 Hz of the identification and 14 Hz of a kelvin, and no more.
        (43_374.0, 20.0, 0.0, 0.0),
        (43_364.0, 20.0, 0.0, 10.0),
        (43_300.0, 20.0, 0.0, 74.0),
        (42_700.0, 20.0, 0.0, 674.0),
        # In the air 0.05 N may press, which stiffens by 12 (0.05/0.5)^(2/3) = 2.59 Hz.
        (43_500.0, 20.0, 0.0, 91.41),
        (44_000.0, 20.0, -1.0, 591.41),
        # Ten kelvins are 140 Hz.
        (43_300.0, 30.0, 0.0, 31.41),
        (43_300.0, 10.0, 0.0, 214.0),
        # Under 1.1 x 1 N + 0.05 N: 12 (1.15/0.5)^(2/3) = 20.91 Hz.
        (43_500.0, 20.0, 1.0, 73.09),
        (43_300.0, 20.0, 1.0, 74.0),
    ],
)
def test_bound_from_above_is_lower_off_the_identified_resonance(
    hertz: float, temperature: float, Fn: float, off: float
) -> None:
    watch = identified()
    seen(watch, 60, Fn=Fn, hertz=hertz, temperature=temperature)
    damping = 1.5697 if Fn > 0.0 else 1.0
    # An identified gain may be 1 % too low.
    expected = 1.01 * 5.0 / damping * share_at(off, damping)
    assert bound_um(watch) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("state", [0, 1, 3])
def test_without_an_identification_the_resonance_may_be_anywhere(state: int) -> None:
    watch = watch_of(State=state)
    seen(watch, 60, hertz=43_000.0)
    assert bound_um(watch) == pytest.approx(5.0, abs=1e-4)


@pytest.mark.parametrize(
    ("gain", "bound"), [(60_000, 6.0), (50_000, 5.0), (45_100, 4.51), (44_900, 4.5), (5_000, 4.5)]
)
def test_a_low_gain_is_not_believed(gain: int, bound: float) -> None:
    watch = watch_of(Gain_per_volt=gain)
    assert bound_um(settled(watch, gain * 1e-4)) == pytest.approx(bound, abs=1e-4)


def test_least_gain_of_the_bound_is_that_of_the_data_sheet() -> None:
    watch = watch_of(Gain_per_volt=5_000, Data_sheet_gain_per_volt=30_000)
    assert bound_um(settled(watch, 0.5)) == pytest.approx(2.7, abs=1e-4)
    watch = watch_of(Gain_per_volt=5_000, Data_sheet_tolerance=30)
    assert bound_um(settled(watch, 0.5)) == pytest.approx(3.5, abs=1e-4)


@pytest.mark.parametrize(("tau", "believed"), [(9_440, 0.944), (50_000, 1.0384), (2_000, 0.8496)])
def test_a_tau_far_from_the_data_sheet_is_not_believed(tau: int, believed: float) -> None:
    watch = watch_of(Tau=tau)
    seen(watch, 1)
    assert bound_um(watch) == pytest.approx(5.0 * (1 - math.exp(-1 / believed)), abs=1e-4)


def test_bound_from_above_rises_with_the_time_constant() -> None:
    watch = watch_of()
    seen(watch, 1)
    assert bound_um(watch) == pytest.approx(5.0 * (1 - math.exp(-1 / 0.944)), abs=1e-4)
    # Under a finger faster: its damping is the plate's as well.
    watch = watch_of()
    watch.look(0j, pressing(1.0), 20.0, AMPLITUDE_MODE)
    seen(watch, 1, Fn=1.0)
    assert bound_um(watch) == pytest.approx(3.1853 * (1 - math.exp(-1.5697 / 0.944)), abs=2e-4)


def driven_on(watch: Watch, asked: Drive, Fn: float, cycles: int) -> list[float]:
    """The voltages that a constant one is cut to; the bound may not pass its limit meanwhile."""
    volts = []
    for _ in range(cycles):
        allowed = watch.allowed(asked)
        assert allowed.frequency == asked.frequency
        assert 0.0 <= allowed.voltage <= asked.voltage
        volts.append(allowed.voltage)
        watch.drive(*allowed)
        assert not watch.look(0j, pressing(Fn), 20.0, TRACKED) & UNSEEN
        assert bound_um(watch) < (5.0 if Fn > 0.0 else 3.27) + 1e-6
    return volts


@pytest.mark.parametrize(
    ("Fn", "most"),
    [
        (0.0, 65.4),  # 3.27 um at 50 nm/V
        (1.0, 150.0),  # 5 um need 157 V
        (0.5, 134.47),
    ],
)
def test_voltage_is_cut_to_keep_the_bound_within_its_limit(Fn: float, most: float) -> None:
    watch = watch_of(limit=5_000)
    watch.look(0j, pressing(Fn), 20.0, AMPLITUDE_MODE)
    volts = driven_on(watch, Drive(150.0, RESONANCE_HZ), Fn, 30)
    assert volts[-1] == pytest.approx(most, abs=0.01)
    assert volts == sorted(volts, reverse=True), "at first it may rise quickly"
    assert watch.allowed(Drive(60.0, RESONANCE_HZ)) == Drive(60.0, RESONANCE_HZ)


def test_the_paper_is_not_cut() -> None:
    """1 um at 140 Hz off the resonance: 26 V, and the kick of its step."""
    watch = watch_of(limit=5_000)
    for volts in (*[60.0] * 2, *[26.0] * 20):
        assert watch.allowed(Drive(volts, RESONANCE_HZ)).voltage == volts
        watch.drive(volts)
        watch.look(1e-6 + 0j, pressing(0.0), 20.0, AMPLITUDE_MODE)


def test_voltage_is_cut_in_the_drive_that_hops_to_the_resonance() -> None:
    watch = watch_of(limit=5_000, State=DONE)
    far, near = Drive(150.0, 42_900.0), Drive(150.0, RESONANCE_HZ)
    assert driven_on(watch, far, 0.0, 30)[-1] == 150.0
    hop = driven_on(watch, near, 0.0, 30)
    assert hop[0] < 100.0
    assert hop[-1] == pytest.approx(65.4 / 1.01, abs=0.01)


def test_a_finger_that_lifts_takes_the_limit_with_it() -> None:
    watch = watch_of(limit=5_000)
    watch.look(0j, pressing(0.5), 20.0, AMPLITUDE_MODE)
    driven_on(watch, Drive(150.0, RESONANCE_HZ), 0.5, 30)
    seen(watch, 1, volts=134.0)
    assert bound_um(watch) == pytest.approx(4.98, abs=0.02)
    for cycle in range(3):
        allowed = watch.allowed(Drive(150.0, RESONANCE_HZ))
        watch.drive(*allowed)
        watch.look(0j, pressing(0.0), 20.0, AMPLITUDE_MODE)
        assert bound_um(watch) <= 3.27 + 1e-6, cycle


def test_limit_below_the_bound_is_0_v_until_the_bound_decayed() -> None:
    watch = settled(watch_of(limit=5_000), 3.0, volts=60.0)
    watch.limit_bound(0.3)
    assert watch.allowed(Drive(60.0, RESONANCE_HZ)).voltage == 0.0
    bounds = []
    for _ in range(3):
        seen(watch, 1, volts=0.0)
        bounds.append(bound_um(watch))
    assert bounds[1] > 0.3 > bounds[2], "3 um exp(-3/0.944) are 125 nm"
    assert 0.0 < watch.allowed(Drive(60.0, RESONANCE_HZ)).voltage < 10.0


@pytest.mark.parametrize(("limit", "cycles"), [(5010, 0), (4990, 5)])
def test_a_bound_above_its_limit_for_5_cycles_is_a_fault(limit: int, cycles: int) -> None:
    """No drive in time makes one; a late one may be in force all the same."""
    watch = settled(watch_of(), 5.0)
    watch.limit_bound(limit * 1e-3)
    assert cycles_to(UNSEEN, watch, 5.0) == cycles


@pytest.mark.parametrize(
    ("um", "Fn", "cycles"),
    [
        # 0.8 of what is left under 1.1 x 1 N + 0.05 N: 1 + 1.6 (1.15/0.5)^(2/3) = 3.7878.
        (1.058, 1.0, 0),
        (1.054, 1.0, 20),
        # In the air 0.05 N may press: 1 + 1.6 (0.05/0.5)^(2/3) = 1.3447.
        (2.98, 0.0, 0),
        (2.97, 0.0, 20),
        (2.98, -1.0, 0),
        (2.97, -1.0, 20),
        (turned(1.49, 60), 0.0, 0),
        (turned(1.484, 60), 0.0, 20),
    ],
)
def test_bound_from_below(um: complex, Fn: float, cycles: int) -> None:
    watch = settled(watch_of(), turned(3.5, math.degrees(cmath.phase(um))), Fn)
    assert cycles_to(PICKUP, watch, um, Fn) == cycles


def least_um(watch: Watch) -> float:
    return watch.state.vibration.least * 1e6


@pytest.mark.parametrize(
    ("um", "share"),
    [
        (turned(1.5, 60), 0.5),
        # Beyond 87.1 degrees, and below 20 nm, a phase tells nothing.
        (turned(0.3, 87.0), 0.0523),
        (turned(0.3, 87.3), 1.0),
        (turned(0.0201, 60), 0.5),
        (turned(0.0199, 60), 1.0),
    ],
)
def test_bound_from_below_takes_measured_phase_without_model(um: complex, share: float) -> None:
    assert least_um(settled(watch_of(), um)) == pytest.approx(3.7183 * share, abs=2e-4)


def test_the_bound_from_below_holds_for_less_than_a_volt() -> None:
    assert least_um(settled(watch_of(), 0.04, volts=0.8)) == pytest.approx(0.02975, abs=1e-5)


def test_before_the_first_drive_the_bound_from_below_is_0() -> None:
    watch = identified()
    for _ in range(3):
        watch.look(0j, pressing(0.0), 20.0, AMPLITUDE_MODE)
        assert least_um(watch) == 0.0


@pytest.mark.parametrize("reads", [0j, 2.0 + 0j, turned(2.0, 60)])
@pytest.mark.parametrize(
    ("hertz", "temperature", "Fn", "off"),
    [
        # The farthest of all resonances: 16 Hz below, and 16 Hz and the finger's 2.59 Hz above.
        (43_390.0, 20.0, 0.0, 18.59),
        (43_400.0, 20.0, 0.0, 26.0),
        (43_300.0, 20.0, 0.0, 108.59),
        (43_300.0, 30.0, 0.0, 66.0),
        # 12 (1.15/0.5)^(2/3) = 20.91 Hz under 1 N.
        (43_300.0, 20.0, 1.0, 126.91),
    ],
)
def test_the_bound_from_below_of_an_identified_plate_does_not(
    hertz: float, temperature: float, Fn: float, off: float, reads: complex
) -> None:
    watch = identified()
    seen(watch, 60, reads, Fn, hertz=hertz, temperature=temperature)
    damping = 3.7878 if Fn > 0.0 else 1.3447
    assert least_um(watch) == pytest.approx(5.0 / damping * share_at(off, damping), rel=1e-3)


@pytest.mark.parametrize(
    ("hertz", "mode", "cycles"),
    [
        (10.0, OPEN_LOOP, 20),
        (10.1, OPEN_LOOP, 28),
        (-10.1, OPEN_LOOP, 28),
        (-9.9, OPEN_LOOP, 20),
        # A loop hops by itself only where it hunts.
        (100.0, AMPLITUDE_MODE, 20),
        (100.0, TRACKED, 20),
    ],
)
def test_frequency_hop_in_open_loop_suspends_5213h_for_8_cycles(
    hertz: float, mode: int, cycles: int
) -> None:
    watch = settled(watch_of(), 5.0)
    found = seen(watch, 40, 1.0, hertz=RESONANCE_HZ + hertz, mode=mode)
    assert first(PICKUP, found) == cycles


def test_nothing_is_missed_below_200_nm_or_while_identifying() -> None:
    # 5 V make 250 nm, of which at least 186 nm are left; 6 V make 300 nm and 223 nm.
    for volts, cycles in ((5.0, 0), (6.0, 20)):
        watch = settled(watch_of(), volts * 0.05, volts=volts)
        assert first(PICKUP, seen(watch, 100, 0.1, volts=volts)) == cycles
    assert cycles_to(PICKUP, settled(watch_of(), 5.0), 1.0, mode=IDENTIFY) == 0
    assert cycles_to(PICKUP, settled(watch_of(), 5.0), 1.0) == 20


def test_bound_from_below_follows_the_lesser_of_two_voltages() -> None:
    # In the air under 100 V: 3.7183 um in the end, of which a cycle makes 1 - exp(-1.3447/0.944).
    step = 1.0 - math.exp(-1.3447 / 0.944)
    for cycles, share in ((1, 0.0), (2, step), (3, 1.0 - (1.0 - step) ** 2)):
        watch = watch_of()
        seen(watch, cycles, 1.0)
        assert least_um(watch) == pytest.approx(3.7183 * share, abs=2e-4)


@pytest.mark.parametrize(
    ("fault", "settled_um", "um", "mode", "cycles"),
    [
        # Silence is a twentieth of the model.
        (PICKUP, 5.0, 0.251, AMPLITUDE_MODE, 20),
        (PICKUP, 5.0, 0.249, AMPLITUDE_MODE, 10),
        # Too much is half more than the model, and 100 nm; twice that when identifying.
        (PICKUP, 5.0, 7.59, AMPLITUDE_MODE, 0),
        (PICKUP, 5.0, 7.61, AMPLITUDE_MODE, 3),
        (PICKUP, 5.0, 15.0, IDENTIFY, 0),
        (PICKUP, 5.0, 15.2, IDENTIFY, 3),
        (AMPLITUDE, 3.0, 3.199, AMPLITUDE_MODE, 0),
        (AMPLITUDE, 3.0, 3.201, AMPLITUDE_MODE, 5),
        # A phase beyond 45 degrees is a lost resonance where it is tracked.
        (RESONANCE, turned(2.0, 44), turned(2.0, 44), TRACKED, 0),
        (RESONANCE, 2.0, 1.5 + 1.5j, TRACKED, 0),
        (RESONANCE, turned(2.0, 46), turned(2.0, 46), TRACKED, 100),
        (RESONANCE, turned(2.0, -46), turned(2.0, -46), TRACKED, 100),
        (RESONANCE, turned(2.0, 46), turned(2.0, 46), AMPLITUDE_MODE, 0),
    ],
)
def test_each_bound_of_a_reading_from_both_sides(
    fault: int, settled_um: complex, um: complex, mode: int, cycles: int
) -> None:
    assert cycles_to(fault, settled(watch_of(), settled_um), um, mode=mode) == cycles


@pytest.mark.parametrize(("volts", "cycles"), [(3.9, 0), (4.1, 10)])
def test_silence_is_none_while_the_model_has_less_than_200_nm(volts: float, cycles: int) -> None:
    watch = settled(watch_of(), volts * 0.05, volts=volts)
    assert first(PICKUP, seen(watch, 50, volts=volts)) == cycles


def test_the_trip_itself_is_allowed() -> None:
    watch = settled(watch_of(), 3.0)
    trip = complex(watch.plan.bound.trip)
    assert not any(watch.look(trip, mode=AMPLITUDE_MODE) & AMPLITUDE for _ in range(20))


@pytest.mark.parametrize(
    ("deadlines", "late"), [((3, 3, 3), 0), ((20, 20, 20), 17), ((20, 4, 20), 1), ((2, 3, 3), 0)]
)
def test_late_drives_make_every_comparison_wait(deadlines: tuple[int, ...], late: int) -> None:
    def settled_watch() -> Watch:
        return settled(watch_of(deadlines), 5.0)

    assert cycles_to(PICKUP, settled_watch(), 1.0) == 20 + late
    assert cycles_to(PICKUP, settled_watch(), 0.1) == 10 + late
    assert cycles_to(PICKUP, settled_watch(), 7.7) == 3 + late
    watch = settled_watch()
    watch.limit_bound(4.99)
    assert cycles_to(UNSEEN, watch, 5.0) == 5 + late


def reads(watch: Watch, *um: float) -> list[bool]:
    """Whether the watch trips at each of these readings under 100 V."""
    return [bool(seen(watch, 1, reading)[0] & PICKUP) for reading in um]


def test_a_cycle_that_is_sound_begins_the_count_of_nothing_anew() -> None:
    watch = settled(watch_of(), 5.0)
    assert not any(reads(watch, *[0.1] * 9, 5.0, *[0.1] * 9))
    watch = settled(watch_of(), 5.0)
    assert reads(watch, *[0.1] * 10) == [False] * 9 + [True]


def test_intermittent_lack_counts_and_is_forgotten_in_20_cycles() -> None:
    watch = settled(watch_of(), 5.0)
    # 19 and a sound one leave 18.95 of 20: the second cycle after it is the fault.
    assert reads(watch, *[1.0] * 19, 5.0, 1.0, 1.0) == [False] * 21 + [True]
    watch = settled(watch_of(), 5.0)
    assert not any(reads(watch, *([1.0] + [5.0] * 20) * 30))


def test_cycles_at_no_vibration_count_for_no_lost_resonance() -> None:
    watch = watch_of()
    watch.drive(20.0)
    found = [watch.look(1e-6 * um, mode=TRACKED) for um in (0j, turned(2.0, 60)) * 100]
    assert first(RESONANCE, found) == 200


@pytest.mark.parametrize(("um", "cycles"), [(0.1, 0), (0.1001, 100)])
def test_100_nm_are_no_vibration_yet(um: float, cycles: int) -> None:
    watch = watch_of()
    watch.drive(20.0)
    found = [watch.look(1e-6j * um, mode=TRACKED) for _ in range(150)]
    assert first(RESONANCE, found) == cycles


def after(watch: Watch, *drives: tuple[float, bool], um: float = 5.0) -> Watch:
    """A watch after drives, of which some were late, and readings in the air that may be any."""
    for volts, late in drives:
        seen(watch, 1, um, volts=volts, late=late)
    return watch


def most_and_least(watch: Watch) -> tuple[float, float]:
    """Where the bounds go, in V: those of the voltages that may be in force."""
    return watch.in_force.most, watch.in_force.least


@pytest.mark.parametrize(
    ("drives", "most", "least"),
    [
        ([(20.0, False)], 20.0, 20.0),
        # Until a late one comes the plate has the one before, and then it has that.
        ([(20.0, True)], 100.0, 20.0),
        ([(150.0, True)], 150.0, 100.0),
        ([(20.0, True), (30.0, False)], 100.0, 20.0),
        ([(20.0, True), (30.0, False), (40.0, False)], 40.0, 40.0),
        ([(20.0, True), (150.0, True), (60.0, True)], 150.0, 20.0),
        # A drive in time is in force when the next is late, and nothing that was before.
        ([(20.0, True), (150.0, True), (60.0, False), (50.0, True)], 60.0, 50.0),
        ([(20.0, True), (150.0, False), (60.0, True), (70.0, False)], 150.0, 60.0),
        ([(20.0, True), (150.0, False), (60.0, True), (70.0, False), (65.0, True)], 70.0, 65.0),
        ([(20.0, True), (60.0, False), (50.0, False), (40.0, True)], 50.0, 40.0),
    ],
)
def test_a_late_drive_leaves_the_ones_before_in_force_perhaps(
    drives: list[tuple[float, bool]], most: float, least: float
) -> None:
    assert most_and_least(after(settled(watch_of(), 5.0), *drives)) == (most, least)


@pytest.mark.parametrize(
    ("um", "before", "after", "cycles"),
    [(5.0, 100.0, 10.0, 18), (0.0, 1.0, 100.0, 25), (0.05, 1.0, 100.0, 25)],
    ids=["goes on", "stays away", "stays small"],
)
def test_vibration_that_lags_a_late_drive_is_no_fault(
    um: float, before: float, after: float, cycles: int
) -> None:
    for late in (False, True):
        watch = settled(watch_of(), um, volts=before)
        found = seen(watch, cycles, um, volts=after, late=late)
        assert any(fault & PICKUP for fault in found) != late


@pytest.mark.parametrize("um", [0.0, 1.0, 12.0])
@pytest.mark.parametrize("before", [0.0, 150.0])
def test_wrong_pickup_is_found_with_each_second_drive_late(before: float, um: float) -> None:
    watch = settled(watch_of((20, 20, 20)), before * 0.05, volts=before)
    found = []
    for at in range(80):
        found += seen(watch, 1, um, volts=100.0 + at % 3, late=at % 2 == 0)
    assert 0 < first(PICKUP, found) <= 45


def test_bound_from_above_takes_largest_voltage_of_late_drives() -> None:
    watch = settled(watch_of(limit=4900), 5.0)
    after(watch, *[(10.0, True)] * 3)
    assert bound_um(watch) == pytest.approx(5.0, abs=1e-4)
    after(watch, *[(10.0, False)] * 20)
    assert bound_um(watch) == pytest.approx(0.5, abs=1e-4)


def hop(watch: Watch, *drives: tuple[float, bool]) -> float:
    """The bound in um after drives of 60 V at some frequencies, of which some were late."""
    for hertz, late in drives:
        seen(watch, 1, volts=60.0, hertz=hertz, late=late)
    return bound_um(watch)


def test_the_bound_has_the_frequency_that_may_still_be_in_force() -> None:
    at, off = RESONANCE_HZ, 42_900.0

    def settled_at(hertz: float) -> Watch:
        watch = identified()
        hop(watch, *[(hertz, False)] * 40)
        return watch

    resonant = bound_um(settled_at(at))
    assert resonant == pytest.approx(3.03, abs=1e-3)
    # Far off next to nothing is left, but not while the drive at the resonance may last.
    assert hop(settled_at(at), (off, False)) < 2.5
    assert hop(settled_at(at), (off, True)) == pytest.approx(3.03, abs=1e-3)
    assert hop(settled_at(at), *[(off, False)] * 20) < 1.2
    assert hop(settled_at(at), *[(off, True)] * 20) == pytest.approx(resonant, abs=1e-3)
    assert hop(settled_at(at), *[(off, True)] * 20, (off, False)) == pytest.approx(3.03, abs=1e-3)
    assert hop(settled_at(at), *[(off, True)] * 20, *[(off, False)] * 20) < 1.2
    # A long drive off the resonance does not lower the bound at it.
    assert hop(settled_at(off), *[(at, True)] * 20) == pytest.approx(3.03, abs=1e-3)


def test_before_the_first_drive_the_plate_is_at_rest() -> None:
    assert most_and_least(watch_of()) == (0.0, 0.0)
    assert most_and_least(after(watch_of(), (30.0, False))) == (30.0, 30.0)
    assert most_and_least(after(watch_of(), (0.5, True))) == (0.5, 0.0)
    watch = watch_of()
    assert bound_um(watch) == 0.0
    for _ in range(3):
        assert watch.look(0j, pressing(0.0), 20.0, TRACKED) == 0
        assert watch.state.vibration[:4] == (0j, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("ticks", [2, 3, 14])
def test_ticks_without_a_measurement_are_time_for_the_vibration(ticks: int) -> None:
    gap, steps = settled(watch_of(), 5.0), settled(watch_of(), 5.0)
    # The cycle before has 20 V as well, or the lesser of two would be another within the gap.
    for watch in (gap, steps):
        after(watch, (20.0, False))
    gap.look(2e-6, pressing(0.3), 20.0, AMPLITUDE_MODE, ticks)
    for _ in range(ticks):
        steps.look(2e-6, pressing(0.3), 20.0, AMPLITUDE_MODE)
    for name in ("E", "E_least", "least"):
        one, other = (getattr(watch.state.vibration, name) for watch in (gap, steps))
        assert one == pytest.approx(other, rel=1e-9), name
    assert bound_um(gap) == pytest.approx(bound_um(steps), rel=1e-9)


@pytest.mark.parametrize(
    ("softening", "lower", "higher"), [(0, 0.0, 0.0), (60_000, 300.0, 0.0), (-60_000, 0.0, 300.0)]
)
def test_bound_of_a_softening_plate_uses_resonance_at_the_limit(
    softening: int, lower: float, higher: float
) -> None:
    """5 um of 60 Hz/um; the rest is 2 Hz, a kelvin, and 0.05 N of a finger."""
    od = stimulator_od()
    od["Model.Softening"].value = softening
    od["Limit.Amplitude by drive"].value = 5000
    plan = bound_plan(lambda name: od[name].si_value, identified=True)
    contact = pressing(0.0)
    measurement = Measurement(0j, (0.0,) * 6, 20.0, 0)
    found = follow(plan, still(plan), UNDRIVEN, measurement, contact, 1)
    assert found.low == pytest.approx(RESONANCE_HZ - 16.0 - lower)
    stiffer = 12.0 * contact_load(0.05)
    assert found.high == pytest.approx(RESONANCE_HZ + 16.0 + stiffer + higher)
