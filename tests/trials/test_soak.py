"""A soak repeats by its seed, and its checks see what does not hold."""

from dataclasses import replace

import pytest

from smarttac_can.od.cia import ERROR_FIELD
from smarttac_can.trials import soak
from smarttac_can.trials.fault_case import FaultCase
from smarttac_can.trials.fault_cases import CASES
from smarttac_can.trials.invariants import AFTERGLOW_CYCLES, UNDRIVEN_CYCLES, Invariants
from smarttac_can.trials.rig import Rig
from smarttac_can.trials.soak import Soak
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.watchdogs import AMPLITUDE_CYCLES


@pytest.fixture
def rig() -> Rig:
    rig = Rig()
    rig.start()
    rig.write("Setpoint.Voltage", 2000)
    rig.start_run()
    rig.drive(Mode.OPEN_LOOP)
    rig.cycle(20)
    return rig


@pytest.fixture
def invariants(rig: Rig) -> Invariants:
    return Invariants(rig)


def test_twenty_seconds_hold_and_repeat() -> None:
    shares: list[float] = []
    first = Soak(20_000, 3, shares.append).run()
    assert first.violations == []
    assert first.passed
    assert first.faults and first.simulated_s >= 20.0
    assert shares == sorted(shares) and shares[-1] == 1.0
    again = Soak(20_000, 3).run()
    assert replace(again, wall_s=0.0, rss_mib=[]) == replace(first, wall_s=0.0, rss_mib=[])
    assert Soak(20_000, 4).run().fingerprint != first.fingerprint


def only(name: str, mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every soak break this one thing, in this mode."""
    cases = tuple(case for case in soak._USED if case.name == name)
    assert cases
    monkeypatch.setattr(soak, "_USED", cases)
    monkeypatch.setattr(soak, "DRIVING", (mode,))


def test_a_fault_that_could_not_show_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    only("pick-up at 0.3", Mode.FRICTION, monkeypatch)
    report = Soak(4000, 16).run()
    # Another one waited in vain: where friction wants no voltage, nothing is lacking.
    assert report.faults == {"pick-up at 0.3": 1}
    assert report.violations == []


def test_a_weak_axis_is_looked_for_at_the_resonance(monkeypatch: pytest.MonkeyPatch) -> None:
    only("pick-up d at 0.05", Mode.OPEN_LOOP, monkeypatch)
    for seed in range(4):
        report = Soak(30_000, seed).run()
        assert report.faults["pick-up d at 0.05"]
        assert report.violations == []


def test_a_lateral_gauge_that_is_off_may_be_friction_under_a_heavy_finger(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    only("S1 off in 4 of 5 cycles", Mode.OPEN_LOOP, monkeypatch)
    report = Soak(30_000, 5).run()
    assert report.faults["S1 off in 4 of 5 cycles"]
    assert report.violations == []


def case_of(name: str) -> FaultCase:
    (case,) = (case for case in CASES if case.name == name)
    assert case.shows is not None
    return case


def test_a_stage_that_is_stuck_at_what_it_is_told_obeys(rig: Rig) -> None:
    case = case_of("power stage stuck")
    assert not case.shows(rig)
    rig.plate_block.commanded = rig.stage.si_value + 1.01
    assert case.shows(rig)


def test_a_corrupt_measurement_that_passes_its_check_is_answered(rig: Rig) -> None:
    case = case_of("measurements corrupt")
    assert not case.shows(rig)
    case.inject(rig)
    rig.cycle()
    assert case.shows(rig)


@pytest.mark.parametrize(
    ("name", "cycles"),
    [
        # The deadline of 3 ms begins anew with each measurement that passes.
        ("measurements corrupt", 4),
        # Between two pulses of a law there is nothing to miss, and the count begins anew.
        ("plate cracked", 14),
    ],
)
def test_what_is_counted_in_a_row_has_to_show_in_a_row(
    name: str, cycles: int, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    shows = [True] * (cycles - 1) + [False] + [True] * cycles
    case = case_of(name)._replace(shows=lambda _: shows.pop(0))
    soak = Soak(100, 1)
    monkeypatch.setattr(soak, "_rig", rig)
    monkeypatch.setattr(soak, "_cycle", lambda count: None)
    assert soak._wait(case)
    assert shows == []


@pytest.mark.parametrize(
    ("name", "tripped", "complaint"),
    [
        ("vibration above its limit", "vibration above its limit", None),
        ("S3 dead", None, "S3 dead in mode amplitude: the gauges contradict each other"),
    ],
)
def test_a_mishap_ends_a_run_only_where_the_plate_itself_vibrates_too_much(
    name: str, tripped: str | None, complaint: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(soak, "TOLERATED", [case for case in CASES if case.name == name])
    monkeypatch.setattr(soak, "DRIVING", (Mode.AMPLITUDE,))
    for scene in ("_touch", "_fault", "_restart_master"):
        monkeypatch.setattr(Soak, scene, Soak._mishap)
    report = Soak(10_000, 1).run()
    assert sum(report.tolerated.values()) > 3
    assert set(report.tripped) == ({tripped} if tripped else set())
    assert bool(report.violations) == (complaint is not None)
    assert all(complaint in line for line in report.violations)


def test_length_below_one_cycle_is_refused() -> None:
    with pytest.raises(ValueError, match="cycles 0 is below 1"):
        Soak(0, 1)


def test_a_sound_run_violates_nothing(rig: Rig, invariants: Invariants) -> None:
    for _ in range(200):
        rig.cycle()
        invariants.check()
    assert not invariants.violated


def test_voltage_above_the_limit_is_seen(rig: Rig, invariants: Invariants) -> None:
    rig.od["Limit.Voltage"].value = 100
    invariants.check()
    assert any("V at the power stage" in line for line in invariants.violations)
    assert any("a drive of" in line for line in invariants.violations)


def test_lasting_amplitude_above_the_limit_is_seen(rig: Rig, invariants: Invariants) -> None:
    rig.od["Limit.Amplitude trip"].value = 0
    for _ in range(AMPLITUDE_CYCLES + AFTERGLOW_CYCLES):
        rig.cycle()
        invariants.check()
        invariants.check()
    assert not invariants.violated, "twice in one tick counts once"
    rig.cycle()
    invariants.check()
    assert "um for" in invariants.violations[0]


def test_a_broken_pickup_hides_an_amplitude_for_no_longer_than_its_bound(
    rig: Rig, invariants: Invariants
) -> None:
    rig.od["Limit.Amplitude trip"].value = 0
    invariants.hidden_cycles = 43
    for _ in range(AMPLITUDE_CYCLES + AFTERGLOW_CYCLES + 43):
        rig.cycle()
        invariants.check()
    assert not invariants.violated
    rig.cycle()
    invariants.check()
    assert "um for" in invariants.violations[0]


def test_plate_that_is_not_finite_is_seen(rig: Rig, invariants: Invariants) -> None:
    plate = rig.plate_block.plate
    plate._state = plate._state._replace(temperature=float("nan"))
    invariants.check()
    assert "not finite" in invariants.violations[0]


def test_object_outside_its_limits_is_seen(rig: Rig, invariants: Invariants) -> None:
    rig.od["Setpoint.Amplitude"].value = -1
    for _ in range(1000):
        invariants.check()
    assert any("Setpoint.Amplitude is -1" in line for line in invariants.violations)


def test_voltage_outside_of_running_is_seen(rig: Rig, invariants: Invariants) -> None:
    stage = rig.stage
    rig.write("Controlword", 0)
    rig.cycle(5)
    stage.source = lambda: 100
    for _ in range(UNDRIVEN_CYCLES + 1):
        invariants.check()
    assert "1 V in state ready" in invariants.violations[0]


def test_history_that_differs_from_the_messages_is_seen(rig: Rig, invariants: Invariants) -> None:
    invariants.clear_history()
    rig.stimulator.device.emergency(0x5210, 0)
    rig.bus.answer(rig.stimulator_port, rig.stimulator.device.take())
    invariants.check_history()
    assert not invariants.violated
    rig.od.entry(ERROR_FIELD, 1).value = 0x5211
    invariants.check_history()
    assert "[5210], its history is [5211]" in invariants.violations[0]


def test_history_that_is_cut_short_is_seen(rig: Rig, invariants: Invariants) -> None:
    invariants.clear_history()
    count = rig.od.entry(ERROR_FIELD, 0)
    for code in range(0xFF00, 0xFF00 + len(rig.od.objects[ERROR_FIELD].entries)):
        rig.stimulator.device.emergency(code, 0)
        rig.cycle()  # the inhibit time of EMCY is 1 ms
    rig.cycle()
    assert len(rig.emergencies) == count.value + 1, "one more than there are places"
    invariants.check_history()
    assert not invariants.violated
    count.value -= 1
    invariants.check_history()
    assert invariants.violated == 1


def test_only_the_first_violations_are_kept(invariants: Invariants) -> None:
    for _ in range(50):
        invariants.violate("it")
    assert invariants.violated == 50
    assert len(invariants.violations) == 20
