"""A soak repeats by its seed, and its checks see each violation."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from smarttac_can.assurance.trials import soak
from smarttac_can.assurance.trials.fault_cases import CASES, FaultCase, limit_amplitude
from smarttac_can.assurance.trials.invariants import (
    AFTERGLOW_CYCLES,
    UNDRIVEN_CYCLES,
    Invariants,
    TripCause,
)
from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.assurance.trials.soak import (
    WHAT,
    DrivenTime,
    Margins,
    Part,
    ProcessSize,
    Soak,
    SoakReport,
    largest,
    margin_rows,
    merged,
    parts,
)
from smarttac_can.canopen.od import cia
from smarttac_can.vocabulary.faults import PICKUP_D, FaultKind
from smarttac_can.vocabulary.states import Mode, State
from smarttac_can.vocabulary.watchdogs import AMPLITUDE_CYCLES, Watchdog


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


def test_eight_seconds_hold() -> None:
    """That a soak repeats is shown by two processes, which give the same report as one."""
    shares: list[float] = []
    report = Soak(8000, 3, shares.append).run()
    assert report.violations == []
    assert report.passed
    assert report.faults and report.simulated_s >= 8.0
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_another_seed_is_another_soak() -> None:
    assert Soak(1000, 3).run().fingerprint != Soak(1000, 4).run().fingerprint


def only(name: str, mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every soak break this one thing, in this mode."""
    cases = tuple(case for case in soak._USED if case.name == name)
    assert cases
    monkeypatch.setattr(soak, "_USED", cases)
    monkeypatch.setattr(soak, "DRIVING", (mode,))


def test_a_fault_that_could_not_show_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    only("pick-up at 0.3", Mode.FRICTION, monkeypatch)
    report = Soak(4000, 24).run()
    # Another one waited in vain: where friction wants no voltage, nothing is lacking.
    assert report.faults == {"pick-up at 0.3": 1}
    assert report.violations == []


def test_a_weak_axis_is_looked_for_at_the_resonance(monkeypatch: pytest.MonkeyPatch) -> None:
    only("pick-up d at 0.05", Mode.OPEN_LOOP, monkeypatch)
    report = Soak(15_000, 0).run()
    assert report.faults["pick-up d at 0.05"]
    assert report.violations == []


def test_soak_takes_lateral_gauge_error_for_friction_at_high_fn(
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


def test_soak_takes_a_stage_stuck_at_its_command_as_obeying(rig: Rig) -> None:
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
def test_soak_counts_cycles_in_a_row_only_in_a_row(
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
def test_soak_mishap_ends_a_run_only_above_the_true_amplitude(
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


def test_soak_bounds_the_time_a_broken_pickup_hides_an_amplitude(
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
    rig.stimulator_port.send(*rig.stimulator.device.take())
    invariants.check_history()
    assert not invariants.violated
    rig.od.entry(cia.ERROR_FIELD, 1).value = 0x5211
    invariants.check_history()
    assert "[5210], its history is [5211]" in invariants.violations[0]


def test_history_that_is_cut_short_is_seen(rig: Rig, invariants: Invariants) -> None:
    invariants.clear_history()
    count = rig.od.entry(cia.ERROR_FIELD, 0)
    for code in range(0xFF00, 0xFF00 + len(rig.od.objects[cia.ERROR_FIELD].entries)):
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


# A long soak is the same whatever the number of processes, and ends when it is told to.


HOUR = 3_600_000


def test_an_hour_is_one_part() -> None:
    assert parts(1, 7) == [Part(1, 7)]
    assert parts(HOUR, 7) == [Part(HOUR, 7)]


@pytest.mark.parametrize(("hours", "count"), [(1.5, 2), (4.0, 4), (24.0, 24), (24.01, 25)])
def test_parts_are_equal_and_have_seeds_of_their_own(hours: float, count: int) -> None:
    cycles = round(hours * HOUR)
    found = parts(cycles, 2**32 - 1)
    assert len(found) == count
    assert sum(part.cycles for part in found) == cycles
    assert max(part.cycles for part in found) - min(part.cycles for part in found) <= 1
    assert found[0].seed == 2**32 - 1
    assert len({part.seed for part in found}) == count
    assert all(0 <= part.seed < 2**32 for part in found)


def report(seed: int, **more: object) -> SoakReport:
    margins = {name: {"off": 0.1 * seed} for name, what in WHAT.items() if what != "event"}
    values = {
        "simulated_s": 1.5,
        "violated": 0,
        "runs": 2,
        "driving_s": {"open_loop": 0.25, "friction": 0.5},
        "friction_law_s": {"measured": 0.125, "predictive": 0.375},
        "vibration_law_s": {"pi": 0.5, "predictive": 0.0},
        "faults": {"S1 dead": 1},
        "latched": 1,
        "tripped": {},
        "margins": margins,
        "tolerated": {"drives twice": 1},
        "emergencies": 3,
        "master_restarts": 1,
        "transfers": 4,
        "rss_mib": [50.0 + seed],
        "fingerprint": f"0000000{seed}",
        "wall_s": 0.5,
    }
    return SoakReport(seed, **{**values, **more})  # type: ignore[arg-type]


def test_report_of_one_part_is_its_own() -> None:
    one = report(1)
    assert merged([one]) is one


def test_reports_are_added_up() -> None:
    first = report(1, violated=1, violations=["cycle 5: it"], tripped={"a": 1})
    second = report(2, faults={"S1 dead": 2, "bus-off": 1}, tripped={"a": 1, "b": 2})
    both = merged([first, second])
    assert both.seed == 1
    assert (both.simulated_s, both.wall_s, both.speed) == (3.0, 1.0, 3.0)
    assert (both.runs, both.latched, both.emergencies) == (4, 2, 6)
    assert (both.master_restarts, both.transfers) == (2, 8)
    assert both.driving_s == {"open_loop": 0.5, "friction": 1.0}
    assert both.friction_law_s == {"measured": 0.25, "predictive": 0.75}
    assert both.vibration_law_s == {"pi": 1.0, "predictive": 0.0}
    assert list(both.faults.items()) == [("S1 dead", 3), ("bus-off", 1)]
    assert both.tripped == {"a": 2, "b": 2}
    assert both.tolerated == {"drives twice": 2}
    assert both.margins["gauges"] == {"off": 0.2}
    assert both.rss_mib == [51.0, 52.0]
    assert both.violated == 1 and not both.passed
    assert both.violations == ["part 1 of seed 1, cycle 5: it"]


def test_fingerprint_depends_on_every_part_and_on_their_order() -> None:
    first, second, third = report(1), report(2), report(3)
    fingerprints = {
        merged(reports).fingerprint
        for reports in ([first, second], [second, first], [first, third], [first, second, third])
    }
    assert len(fingerprints) == 4


def test_only_the_first_violations_of_all_parts_are_kept() -> None:
    lines = [f"cycle {n}: it" for n in range(15)]
    both = merged([report(n, violated=15, violations=lines) for n in (1, 2)])
    assert both.violated == 30
    assert len(both.violations) == 20


TWO_JOBS = """
import json, sys
from smarttac_can.assurance.trials.soak import Part, soak_in_parts
shares = []
report = soak_in_parts(
    [Part(4000, 5), Part(3000, 6), Part(2000, 7)], jobs=int(sys.argv[1]), progress=shares.append
)
print(json.dumps({**report.as_json(), "shares": shares}))
"""


def test_two_processes_give_the_same_report() -> None:
    found = []
    for jobs in ("1", "2"):
        # A process of its own: that of multiprocessing which tracks resources outlives the pool.
        done = subprocess.run(
            [sys.executable, "-c", TWO_JOBS, jobs], check=True, capture_output=True, text=True
        )
        made = json.loads(done.stdout)
        shares = made.pop("shares")
        assert shares == sorted(shares) and shares[-1] == 1.0
        for key in ("wall_s", "speed", "rss_mib"):
            del made[key]
        found.append(made)
    assert found[0] == found[1]
    assert found[0]["simulated_s"] >= 9.0


# Margins are those of sound cycles, and a trip has a cause that the plate itself shows.


AMPLITUDE, SATURATED = 1 << Watchdog.AMPLITUDE, 1 << Watchdog.SATURATED


def driving(mode: Mode = Mode.OPEN_LOOP, *, nm: int = 0) -> Rig:
    rig = Rig()
    rig.start()
    rig.write("Setpoint.Voltage", 4000)
    rig.start_run(motion=0)
    if nm:
        limit_amplitude(nm)(rig)
        rig.cycle(2)
    rig.drive(mode)
    rig.cycle(20)
    return rig


@pytest.fixture
def driven() -> Rig:
    return driving()


def test_four_bad_cycles_of_five_are_seen(driven: Rig) -> None:
    margins = Margins(driven)
    margins.look()
    margins.keep()
    assert margins.table()["gauges"] == {"open_loop": 0.0}
    driven.inject(FaultKind.OFFSET, 3, 600)
    for _ in range(4):
        driven.cycle()
        margins.look()
    driven.mend()
    driven.cycle(5)
    margins.look()
    assert driven.state is State.RUNNING
    margins.keep()
    assert margins.table()["gauges"] == {"open_loop": 0.8}
    driven.cycle()
    margins.look()
    margins.keep()
    assert margins.table()["gauges"] == {"open_loop": 0.8}, "the largest of all runs"


def test_soak_forgets_dropped_frames(driven: Rig) -> None:
    margins = Margins(driven)
    margins.look()
    margins.keep()
    before = margins.table()
    driven.inject(FaultKind.OFFSET, 3, 600)
    driven.cycle(3)
    margins.look()
    margins.drop()
    margins.keep()
    assert margins.table() == before


def test_quantities_behind_a_count(driven: Rig) -> None:
    margins = Margins(driven)
    driven.write("Limit.Amplitude by drive", 5000)
    margins.look()
    margins.keep()
    table = margins.table()
    # 40 V make 2.01 um of the bare plate.
    assert table["true_amplitude"]["open_loop"] == pytest.approx(2.01 / 3.2, rel=0.02)
    assert table["bound_by_the_drive"]["open_loop"] == pytest.approx(2.01 / 5.0, rel=0.1)


def test_every_watchdog_has_a_row_and_events_have_no_number(driven: Rig) -> None:
    margins = Margins(driven)
    margins.look()
    margins.keep()
    head, *rows = margin_rows(margins.table())
    assert head == ("Watch", "Level", "open loop")
    assert [row[0] for row in rows[:27]] == [w.name.lower().replace("_", " ") for w in Watchdog]
    events = {row[0] for row in rows if row[2] == ""}
    assert events == {row[0] for row in rows if row[1] == "event"}
    assert events == {
        "nmt", "sync counter", "bus off", "transmit queue", "controller", "calibration", "plate",
        "stage", "not enabled",
    }  # fmt: skip
    assert set(margins.table()) == {name for name, what in WHAT.items() if what != "event"}


def test_largest_of_several() -> None:
    def table(**levels: float) -> dict[str, dict[str, float]]:
        return {name: dict(levels) for name, what in WHAT.items() if what != "event"}

    found = largest([table(friction=0.5, off=0.1), table(open_loop=0.3, off=0.2)])
    assert list(found["voltage"].items()) == [("off", 0.2), ("open_loop", 0.3), ("friction", 0.5)]
    assert set(found) == set(table())


def until_fault(rig: Rig, cause: TripCause) -> int:
    for _ in range(100):
        rig.cycle()
        cause.look()
        if rig.state is State.FAULT:
            return int(rig.od["Diagnosis.Latched"].value)
    raise AssertionError("no fault")


def test_vibration_of_the_plate_is_a_cause(driven: Rig) -> None:
    cause = TripCause(driven)
    driven.cycle(50)
    limit_amplitude(100)(driven)
    latched = until_fault(driven, cause)
    assert latched == AMPLITUDE
    assert cause.of(latched) == "vibration above its limit"
    assert cause.of(SATURATED) is None
    assert cause.of(AMPLITUDE | SATURATED) is None, "each needs its own"
    driven.cycle(200)
    assert cause.of(latched) is None, "long ago"


def test_reading_alone_is_no_cause() -> None:
    rig = driving(Mode.IDENTIFY, nm=1000)
    rig.cycle(420)
    cause = TripCause(rig)
    rig.inject(FaultKind.OFFSET, PICKUP_D, 500)
    latched = until_fault(rig, cause)
    assert latched == AMPLITUDE
    assert cause.of(latched) is None


def test_no_watchdog_but_those_of_too_much_vibration_has_a_cause(driven: Rig) -> None:
    cause = TripCause(driven)
    limit_amplitude(100)(driven)
    latched = until_fault(driven, cause)
    assert cause.of(latched | 1 << Watchdog.STUCK) is None
    assert cause.of(0) is None


def test_vibration_beyond_the_range_of_the_pickup_is_a_cause(driven: Rig) -> None:
    cause = TripCause(driven)
    plate = driven.plate_block.plate
    plate._state = plate._state._replace(motion=plate._state.motion._replace(W=3.3e-6 + 0j))
    for _ in range(5):
        cause.look()
    assert cause.of(SATURATED) is None, "a lift lasts as long"
    cause.look()
    assert cause.of(SATURATED) == "vibration beyond the range of its pick-up"


def test_trip_without_a_cause_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    def trips(soak: Soak) -> None:
        limit_amplitude(100)(soak._rig)
        soak._cycle(400)
        assert soak._tripped("set-points")
        limit_amplitude(3200)(soak._rig)
        soak._cycle(300)

    monkeypatch.setattr(Soak, "_touch", trips)
    for scene in ("_fault", "_mishap", "_restart_master"):
        monkeypatch.setattr(Soak, scene, trips)
    sound = Soak(3000, 1).run()
    assert sound.passed
    assert sound.tripped.keys() == {"vibration above its limit"}
    monkeypatch.setattr(TripCause, "look", lambda _: None)
    report = Soak(3000, 1).run()
    assert report.violated and not report.tripped
    assert "set-points in mode" in report.violations[0]


# Cycles with a voltage by mode and by law, where the law acts.


def test_seconds_go_to_the_laws_that_act() -> None:
    rig = Rig()
    driven = DrivenTime(rig)
    for mode, law, vibration_law, cycles in (
        (Mode.OPEN_LOOP, 3, 2, 100),
        (Mode.AMPLITUDE, 3, 1, 20),
        (Mode.FRICTION, 3, 2, 3),
        (Mode.TEXTURE, 3, 2, 4),
    ):
        rig.write("Friction law", law)
        rig.write("Controller.Vibration law", vibration_law)
        for _ in range(cycles):
            driven.count(mode)
    assert driven.by_mode() == {
        "open_loop": 0.1,
        "amplitude": 0.02,
        "amplitude_resonance": 0.0,
        "friction": 0.003,
        "identify": 0.0,
        "texture": 0.004,
    }
    assert driven.by_friction_law() == {
        "measured": 0.0,
        "accumulate": 0.0,
        "nominal": 0.0,
        "predictive": 0.003,
    }
    assert driven.by_vibration_law() == {"pi": 0.0, "scheduled": 0.02, "predictive": 0.007}


# A process that grows is complained of, but not for its first two minutes.


STATM = Path("/proc/self/statm")


def complaint(*mib: float) -> str | None:
    size = ProcessSize()
    size.mib = list(mib)
    return size.complaint()


def test_growth_after_two_minutes_is_seen() -> None:
    assert complaint() is None
    assert complaint(10.0, 40.0) is None
    assert complaint(10.0, 40.0, 50.0, 58.0) is None
    assert complaint(10.0, 40.0, 50.0, 58.1, 50.0) == "the process grew from 50.0 to 58.1 MiB"


def test_sample_is_the_size_of_this_process() -> None:
    size = ProcessSize()
    size.sample()
    assert len(size.mib) == STATM.exists(), "none where the system does not say"
    assert all(10.0 < mib < 4000.0 for mib in size.mib)
