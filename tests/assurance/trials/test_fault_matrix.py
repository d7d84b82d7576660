"""The fault matrix: a share of its rows, its log, and the look of a row that fails."""

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from fault_log import verify_rows

from smarttac_can.assurance.trials.fault_cases import (
    ALL_NOT_SEEN,
    ALL_TOLERATED,
    CASES,
    DRIVING,
    NOT_SEEN,
    PREDICTED,
    WAYS,
    FaultCase,
    cases,
)
from smarttac_can.assurance.trials.fault_matrix import (
    FaultRow,
    driving_rig,
    fault_matrix,
    reached_unseen,
    rows_as_json,
    tolerated,
)
from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.states import Mode, State

HOLD = 200
PAGE = Path(__file__).parents[3] / "docs" / "reference" / "faults.md"
SAMPLE = [
    *((case, case.modes[number % len(case.modes)]) for number, case in enumerate(CASES[::18])),
    *((case, Mode.FRICTION) for case in PREDICTED[::28]),
]


def one(name: str, way: str) -> FaultRow:
    (row,) = fault_matrix(cases([name], [way]), hold=HOLD)
    return row


@pytest.mark.parametrize(
    ("case", "mode"), SAMPLE, ids=[f"{case.name}, {case.way(mode)}" for case, mode in SAMPLE]
)
def test_fault_ends_in_0_v_in_time_and_recovers(case: FaultCase, mode: Mode) -> None:
    frames: list[tuple[int, Frame]] = []
    (row,) = fault_matrix([(case, mode)], hold=HOLD, log=lambda *frame: frames.append(frame))
    assert row.voltage_before_v > 0.0
    assert row.cycles_to_zero is not None
    assert row.cycles_to_zero <= row.detection_bound_cycles + 1
    assert row.held
    assert row.recovered
    assert row.passed
    rows = json.loads(json.dumps(rows_as_json([row])))
    assert verify_rows(frames, rows, stimulator_od(), plate_od()).rows == 1


@pytest.mark.parametrize(
    ("name", "hold"),
    [
        pytest.param("a node babbles", 2000, marks=pytest.mark.long),
        ("bus-off", 2250),
        *(pytest.param("bus-off", hold, marks=pytest.mark.long) for hold in (2000, 2125, 2375)),
    ],
)
def test_fault_beyond_plate_heartbeat_ends_with_the_next_one(name: str, hold: int) -> None:
    # Heartbeats of the plate come each 500 cycles, so wherever between two of them it ends.
    (row,) = fault_matrix(cases([name], ["identify"]), hold=hold)
    assert row.held
    assert row.recovered


@pytest.mark.parametrize("mode", DRIVING)
def test_resumed_plate_is_at_0_v_before_it_uses_queued_frames(
    mode: Mode, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = next(case for case in CASES if case.name == "plate paused for 2 s")
    rig = driving_rig(case, mode)
    port = rig.plate_port
    assert port is not None
    rig.bus.pause(port)
    rig.cycle(2000)
    assert rig.stage.read() > 0, "nothing puts the stage at 0 V while it stands"
    seen: list[tuple[int, bool]] = []
    station = rig.bus._stations[port]

    def noting(hear: Callable[[Frame], list[Frame]]) -> Callable[[Frame], list[Frame]]:
        def note(frame: Frame) -> list[Frame]:
            seen.append((rig.stage.read(), rig.plate_block.inhibited))
            return hear(frame)

        return note

    station._receive = noting(station._receive)
    monkeypatch.setattr(station.node, "overtaken", noting(station.node.overtaken))
    rig.bus.resume(port)
    assert len(seen) > 200
    assert set(seen) == {(0, True)}


def test_fault_row_time_is_before_the_first_frame_of_the_fault() -> None:
    frames: list[tuple[int, Frame]] = []
    (row,) = fault_matrix(
        cases(["NMT stop"], ["amplitude"]),
        hold=HOLD,
        log=lambda time, frame: frames.append((time, frame)),
    )
    stop = next(t for t, f in frames if f == Frame(0x000, b"\x02\x20"))
    assert row.injected_at_s * 1e6 < stop


def test_uncovered_fault_row_says_so_and_has_no_late_bound() -> None:
    row = one("plate paused for 2 s", "amplitude")
    assert not row.covered
    assert replace(row, cycles_to_zero=9).passed
    assert not replace(row, held=False).passed
    assert [case.name for case in CASES if case.uncovered] == ["plate paused for 2 s"]


def test_full_transmit_queue_is_a_fault_when_its_cycle_is_over() -> None:
    case = next(case for case in CASES if case.name == "transmit queue full")
    rig = driving_rig(case, Mode.AMPLITUDE)
    case.inject(rig)
    states = []
    for _ in range(3):
        rig.cycle()
        states.append(rig.state)
    assert states == [State.RUNNING, State.FAULT, State.FAULT]
    assert rig.stimulator.block.supervisor.latched & 1 << 8
    heard = len(rig.emergencies)
    rig.cycle(16)
    assert 0x8111 not in [emcy.code for emcy in rig.emergencies], "it has no room either"
    rig.cycle(2)
    assert 0x8111 in [emcy.code for emcy in rig.emergencies[heard:]]


def test_where_another_watchdog_is_first_it_says_why() -> None:
    assert all(case.why for case in CASES if case.instead)


@pytest.mark.parametrize(
    "way", ["friction_predictive", pytest.param("friction", marks=pytest.mark.long)]
)
def test_mishap_does_not_end_a_run(way: str) -> None:
    given = [(case, mode) for case, mode in ALL_TOLERATED if case.way(mode) == way]
    assert len(given) == 6
    for case, mode in given:
        assert tolerated(case, mode), case.name


def test_every_fault_is_on_the_page_in_each_of_its_modes() -> None:
    page = PAGE.read_text(encoding="utf-8")
    modes = Counter(case.name for case, _ in cases())
    for name, count in modes.items():
        assert f"\n| {name} | {count} |" in page
    passed = f"<!-- passed -->{modes.total()} of {modes.total()}<!-- / -->"
    assert passed in page


def test_every_driving_mode_is_there_for_most_faults() -> None:
    assert len(cases()) >= 200
    assert {mode for _, mode in cases()} == set(DRIVING)
    assert {case.way(mode) for case, mode in cases()} == set(WAYS)
    assert len({case.name for case in CASES}) == len(CASES)


def test_faults_within_the_loop_have_rows_with_predictive_laws() -> None:
    rows = cases([], ["friction_predictive"])
    names = {case.name for case, _ in rows}
    assert len(names) == len(rows) == 57
    assert {"S1 dead", "pick-up d at 0.1, tracked", "thermometer jumps", "drives lost"} <= names
    assert not names & {"NMT stop", "bus-off", "another plate", "S3 saturated, plate inside"}
    for case, mode in rows[:2]:
        rig = driving_rig(case, mode)
        chosen = [rig.od[name].value for name in ("Friction law", "Controller.Vibration law")]
        assert chosen == [3, 2]


UNSEEN = [way for way in WAYS if way != "identify"]


@pytest.mark.parametrize(
    "way",
    [
        "friction",
        *(pytest.param(way, marks=pytest.mark.long) for way in UNSEEN if way != "friction"),
    ],
)
def test_unseen_fault_reaches_at_most_setpoint_over_gain(
    way: str,
) -> None:
    given = [(case, mode) for case, mode in ALL_NOT_SEEN if case.way(mode) == way]
    # Of each axis the lowest gain, which hides most; docs/reference/faults.md has all of them.
    given = [next(each for each in given if each[0].name.startswith(f"{axis} at"))
             for axis in ("pick-up", "pick-up d", "pick-up q")]  # fmt: skip
    assert {(case.prepare, case.plate_inside) for case, _ in given} == {(None, False)}
    sound = reached_unseen(replace_inject(given[0][0]), given[0][1])
    assert sound is not None
    for case, mode in given:
        reached = reached_unseen(case, mode)
        assert reached is not None
        gain = 1.0 if "q" in case.name else float(case.name.rpartition(" ")[2])
        # The voltage, and the friction that is measured, do not pass through the pick-up.
        asked = sound if way in {"open_loop", "friction"} else sound / gain
        assert 0.9 < reached < 1.02 * asked


def test_the_gains_that_are_not_seen_are_these() -> None:
    both = [f"pick-up at {gain}" for gain in (0.5, 0.6, 0.7, 0.8, 0.9)]
    along = [f"pick-up d at {gain}" for gain in (0.5, 0.6, 0.7, 0.8, 0.9)]
    across = [f"pick-up q at {gain}" for gain in (0.05, 0.3, 0.6, 0.9)]
    assert [case.name for case in NOT_SEEN] == both + along + across
    for case in NOT_SEEN:
        seen_elsewhere = case.name in {"pick-up at 0.5", "pick-up d at 0.5"}
        assert [int(mode) for mode in case.modes] == ([4] if seen_elsewhere else [1, 2, 3, 4, 6])


@pytest.mark.parametrize(
    ("name", "sensor", "per_mille"),
    [("pick-up", 10, 600), ("pick-up d", 7, 600), ("pick-up q", 8, 600)],
)
def test_pickup_fault_case_loses_the_gain_of_its_name(
    name: str, sensor: int, per_mille: int
) -> None:
    (case,) = (case for case in NOT_SEEN if case.name == f"{name} at 0.6")
    injected = []

    class Rig:
        def inject(self, *fault: int, **more: int) -> None:
            injected.append((*fault, *more.values()))

    case.inject(Rig())  # type: ignore[arg-type]
    assert injected == [(FaultKind.GAIN, sensor, per_mille)]


def test_rows_repeat() -> None:
    for way in ("friction", "friction_predictive"):
        assert one("S3 stuck", way) == one("S3 stuck", way)


def test_fault_that_goes_unnoticed_fails_its_row() -> None:
    harmless = replace_inject(CASES[0])
    (row,) = fault_matrix([(harmless, Mode.OPEN_LOOP)], hold=HOLD)
    assert row.cycles_to_zero is None
    assert not row.held
    assert row.recovered
    assert not row.passed


def replace_inject(case: FaultCase) -> FaultCase:
    return case._replace(name="nothing", inject=lambda rig: None)


@pytest.mark.parametrize(
    "change",
    [
        {"voltage_before_v": 0.0},
        {"cycles_to_zero": None},
        {"cycles_to_zero": 9},
        {"held": False},
        {"recovered": False},
    ],
)
def test_fault_row_fails_for_each_kind_of_violation(change: dict[str, float]) -> None:
    good = FaultRow("it", "friction", 10.0, 5, 6, ("5210h",), "fault", HOLD, True, True, 0.0, 1.0)
    assert good.passed
    assert not replace(good, **change).passed  # type: ignore[arg-type]


def test_unknown_fault_and_empty_choice_are_refused() -> None:
    with pytest.raises(ValueError, match="fault 'rust' is none of"):
        cases(["rust"])
    with pytest.raises(
        ValueError,
        match="fault 'resonance out of reach' is not injected in mode open_loop or identify",
    ):
        cases(["resonance out of reach", "NMT stop"], ["open_loop", "identify"])
    with pytest.raises(ValueError, match="no fault is injected in mode off"):
        cases([], ["off"])


def test_a_row_without_an_emergency_says_so() -> None:
    bad = FaultRow("it", "open_loop", 10.0, 5, None, (), "not_ready", 0, True, True, 0.0, 1.5)
    assert rows_as_json([bad])[0]["emcy_code"] is None
