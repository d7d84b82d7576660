"""A log confirms the rows that were made with it, and contradicts any other row or log."""

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from fault_log import NOT_SHOWN, DifferenceError, main, verify_rows

from smarttac_can.assurance.trials.fault_cases import CASES, cases
from smarttac_can.assurance.trials.fault_matrix import fault_matrix, rows_as_json
from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.log_file import CandumpWriter
from smarttac_can.vocabulary.states import Mode

Log = list[tuple[int, Frame]]
Rows = list[dict[str, Any]]
STUCK, STOPPED, INSIDE, SYNC_LOST, TWICE = range(5)
FAULTS = [
    *("S3 stuck", "NMT stop of the plate", "S3 saturated, plate inside", "SYNC lost"),
    "SYNC twice a cycle",
]
SYNC, STAGE, DRIVE, STATUS, EMCY = 0x080, 0x4A1, 0x221, 0x1A0, 0x0A0


@pytest.fixture(scope="module")
def made() -> tuple[Log, Rows]:
    log: Log = []
    chosen = [pair for name in FAULTS for pair in cases([name], ["amplitude"])]
    rows = list(fault_matrix(chosen, hold=200, log=lambda *frame: log.append(frame)))
    return log, [row | {"emcy_codes": list(row["emcy_codes"])} for row in rows_as_json(rows)]


@pytest.fixture
def log(made: tuple[Log, Rows]) -> Log:
    return list(made[0])


@pytest.fixture
def rows(made: tuple[Log, Rows]) -> Rows:
    return copy.deepcopy(made[1])


def verified(log: Log, rows: object) -> tuple[int, int, int]:
    return verify_rows(log, rows, stimulator_od(), plate_od())


def refusal(log: Log, rows: object) -> str:
    with pytest.raises(ValueError) as caught:
        verified(log, rows)
    return str(caught.value)


def at(rows: Rows, number: int) -> int:
    return round(rows[number]["injected_at_s"] * 1e6)


def first(log: Log, can_id: int, after: int) -> int:
    """Place of the first such frame after a time."""
    return next(
        place for place, (time, frame) in enumerate(log) if time > after and frame.can_id == can_id
    )


def test_fault_log_confirms_the_rows_made_with_it(log: Log, rows: Rows) -> None:
    assert verified(log, rows) == (5, 34, 1)


@pytest.mark.parametrize(
    ("number", "field", "said", "shown"),
    [
        (STUCK, "voltage_before_v", 35.12, "35.11"),
        (STUCK, "cycles_to_zero", 23, "24"),
        (STUCK, "cycles_to_zero", 25, "24"),
        (STUCK, "cycles_to_zero", None, "24"),
        (STUCK, "emcy_codes", [], '["5211h"'),
        (STUCK, "emcy_codes", ["5210h"], '["5211h"'),
        (STUCK, "emcy_code", None, '"5211h"'),
        (STUCK, "state_after", "ready", '"fault"'),
        (STUCK, "held", False, "true"),
        (STUCK, "held", 1, "true"),
        (STUCK, "recovered", False, "true"),
        (STOPPED, "cycles_to_zero", 1, "0"),
        (INSIDE, "voltage_before_v", 35.0, "35.11"),
        (INSIDE, "cycles_to_zero", 0, "1"),
        (SYNC_LOST, "cycles_to_zero", 2, "3"),
        (SYNC_LOST, "cycles_to_zero", 4, "3"),
    ],
)
def test_row_that_says_something_else_is_named(
    number: int, field: str, said: object, shown: str, log: Log, rows: Rows
) -> None:
    rows[number][field] = said
    message = refusal(log, rows)
    assert message.startswith(f"row {number + 1} ({FAULTS[number]}, amplitude): {field} is ")
    assert f"in the row, {shown}" in message


def test_bound_is_compared_with_the_log(log: Log, rows: Rows) -> None:
    rows[STUCK]["detection_bound_cycles"] = 23
    verified(log, rows)
    rows[STUCK]["detection_bound_cycles"] = 22
    assert refusal(log, rows) == (
        "row 1 (S3 stuck, amplitude): detection_bound_cycles is 22, "
        "and the cycles to 0 V in the log are 24"
    )
    rows[STUCK]["detection_bound_cycles"] = "24"
    assert "no number of cycles" in refusal(log, rows)
    # Of two SYNCs a cycle the log does not show which began one.
    rows[STUCK]["detection_bound_cycles"], rows[TWICE]["detection_bound_cycles"] = 23, 0
    verified(log, rows)


@pytest.mark.parametrize("field", ["voltage_before_v", "held", "recovered", "emcy_codes"])
def test_field_that_is_missing_is_a_difference(field: str, log: Log, rows: Rows) -> None:
    del rows[STUCK][field]
    assert f'{field} is "missing" in the row' in refusal(log, rows)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"injected_at_s": "soon"}, 'row 1: injected_at_s "soon" is not in 0..1e+09'),
        ({"injected_at_s": float("nan")}, "row 1: injected_at_s NaN is not in 0..1e+09"),
        ({"injected_at_s": 1e99}, "row 1: injected_at_s 1e+99 is not in 0..1e+09"),
        ({"injected_at_s": 0.5}, "the log has no frame at injected_at_s 0.500000"),
        ({"mode": "warp"}, 'row 1: mode "warp" is none of off, open_loop, amplitude'),
        ({"mode": ["off"]}, 'row 1: mode ["off"] is none of'),
        ({"mode": "friction"}, "recovered is true in the row, false in the log"),
        ({"fault": 7}, "row 1: fault 7 is no name"),
    ],
)
def test_audit_refuses_implausible_fields_of_a_row(
    change: dict[str, Any], complaint: str, log: Log, rows: Rows
) -> None:
    rows[STUCK] |= change
    assert complaint in refusal(log, rows)


@pytest.mark.parametrize("rows", [None, {}, [], "rows"])
def test_rows_that_are_none_are_refused(rows: object) -> None:
    assert refusal([], rows) == "there is no list of rows"


def test_row_that_is_none_is_refused() -> None:
    assert refusal([], [["S3 stuck"]]) == "row 1 is no object"


def test_rows_and_log_belong_together(log: Log, rows: Rows) -> None:
    assert refusal(log, rows[:3]) == "the log goes on after the 3 rows"
    assert refusal(log, rows[1:]).startswith(
        "row 1 (NMT stop of the plate, amplitude): the log has"
    )
    assert refusal(log, rows + rows[:1]).endswith("the log ends before its recovery")
    assert refusal([], rows).endswith("the log ends before its recovery")


def test_log_that_ends_early_is_refused(log: Log, rows: Rows) -> None:
    end = first(log, SYNC, at(rows, SYNC_LOST) + 840_000)
    assert refusal(log[:end], rows).startswith("row 4 (SYNC lost, amplitude): recovered is")
    assert refusal(log[: first(log, STAGE, at(rows, SYNC_LOST) - 3000)], rows).endswith(
        "the log ends before its recovery"
    )


@pytest.mark.parametrize("can_id", [STAGE, EMCY])
def test_frame_that_is_missing_is_noticed(can_id: int, log: Log, rows: Rows) -> None:
    log.pop(first(log, can_id, at(rows, STUCK)))
    assert refusal(log, rows).startswith("row 1 (S3 stuck, amplitude): ")


def test_drive_of_0_v_that_is_missing_is_noticed(log: Log, rows: Rows) -> None:
    end = at(rows, STUCK)
    place = first(log, DRIVE, end)
    while any(log[place][1].data[:2]):
        end = log[place][0]
        place = first(log, DRIVE, end)
    del log[place]
    assert "cycles_to_zero is 24 in the row, 25 in the log" in refusal(log, rows)


@pytest.mark.parametrize("can_id", [SYNC, STAGE, DRIVE, EMCY, STATUS, 0x4A0])
def test_log_without_an_identifier_is_noticed(can_id: int, log: Log, rows: Rows) -> None:
    assert refusal([item for item in log if item[1].can_id != can_id], rows).startswith("row ")


def test_stage_is_believed_rather_than_the_drives(log: Log, rows: Rows) -> None:
    """A stage that keeps its voltage in spite of drives of 0 V."""
    end = at(rows, STUCK) + 70_000
    kept = [
        (time, Frame(STAGE, b"\1" + frame.data[1:]))
        if frame.can_id == STAGE and at(rows, STUCK) < time < end
        else (time, frame)
        for time, frame in log
    ]
    assert "cycles_to_zero is 24 in the row, 70 in the log" in refusal(kept, rows)


@pytest.mark.parametrize(
    ("after_us", "shown", "complaint"),
    [
        (-20_000, b"\0\0", "the stage shows 0.00 V at"),
        (30_000, b"\1", "cycles_to_zero is 24 in the row"),
        (250_000, b"\1", "held is true in the row, false in the log"),
    ],
)
def test_one_other_voltage_of_the_stage_is_noticed(
    after_us: int, shown: bytes, complaint: str, log: Log, rows: Rows
) -> None:
    place = first(log, STAGE, at(rows, STUCK) + after_us)
    time, frame = log[place]
    log[place] = time, Frame(STAGE, shown + frame.data[len(shown) :])
    assert complaint in refusal(log, rows)


def test_time_that_runs_backwards_is_refused(log: Log, rows: Rows) -> None:
    log[10], log[11] = log[11], log[10]
    assert "time runs backwards at " in refusal(log, rows)


def test_fault_that_is_not_ended_is_not_confirmed() -> None:
    log: Log = []
    harmless = CASES[0]._replace(name="nothing", inject=lambda rig: None)
    chosen = [(harmless, Mode.OPEN_LOOP)]
    made = list(fault_matrix(chosen, hold=200, log=lambda *frame: log.append(frame)))
    with pytest.raises(DifferenceError, match="nothing, open_loop"):
        verified(log, rows_as_json(made))


def test_audit_exceptions_name_existing_faults_and_fields(rows: Rows) -> None:
    assert set(NOT_SHOWN) <= set(rows[0])
    named = {name for names in NOT_SHOWN.values() for name in names}
    assert named <= {case.name for case in CASES}


def test_the_files_of_the_tool_are_verified(log: Log, rows: Rows, tmp_path: Path) -> None:
    files = str(tmp_path / "faults.log"), str(tmp_path / "faults.json")
    with Path(files[0]).open("w", encoding="utf-8") as file:
        writer = CandumpWriter(file)
        for time, frame in log:
            writer.write(time, frame)
    Path(files[1]).write_text(json.dumps(rows), encoding="utf-8")
    fields = verified(log, rows)[1:]
    assert main(*files) == (
        f"rows: 5, fields as the log shows them: {fields[0]}, fields it does not show: {fields[1]}"
    )
    assert fields[0] > 5 * fields[1] > 0
