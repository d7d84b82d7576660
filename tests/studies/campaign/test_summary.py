import json

import numpy as np
import pytest
from matplotlib.image import imread

from smarttac_can.science.population.trial import TOUCHES, Campaign
from smarttac_can.studies.campaign.runner import COLUMNS, Result
from smarttac_can.studies.campaign.summary import (
    FILES,
    FINGERS,
    LIMIT_CYCLE,
    RESULTS,
    TOLD_APART,
    column,
    lines,
    summary,
    write_folder,
)
from smarttac_can.vocabulary.states import Law, VibrationLaw

CAMPAIGN = Campaign(seed=3, dead_time=540e-6)
METRICS = ("rise_time_ms", "overshoot_percent", "static_error_percent", "chatter")


def result(rows):
    return Result(rows, ran_s=2000.0, wall_s=1.6, compile_s=9.5, compiled=True)


def hundred():
    """Row n holds n + 1 in every column, chatter a thousandth of it."""
    rows = np.repeat(np.arange(1.0, 101.0)[:, None], len(COLUMNS), axis=1)
    rows[:, COLUMNS.index("chatter")] *= 1e-3
    return rows


def test_percentiles_are_those_of_fingers():
    results = summary(CAMPAIGN, result(hundred()))
    measured, touches = (
        (f"measured_{name}" for name in METRICS),
        (f"touch_{n}" for n in METRICS[:2]),
    )
    assert list(results["metrics"]) == [*METRICS, *measured, *touches, "rise_spread_ms"]
    assert results["metrics"]["rise_time_ms"] == {"p5": 5.0, "p50": 50.0, "p95": 95.0}
    assert results["fingers"] == 100
    assert results["finger_seconds_per_second"] == 1250.0
    assert results["compile_s"] == 9.5
    assert results["dead_time_us"] == 540.0


def test_limit_cycle_share_counts_true_chatter_above_its_bound():
    rows = hundred()
    assert LIMIT_CYCLE == 0.03
    assert summary(CAMPAIGN, result(rows))["limit_cycle_share"] == 0.7
    rows[:, COLUMNS.index("measured_chatter")] = 0.0
    assert summary(CAMPAIGN, result(rows))["limit_cycle_share"] == 0.7


def test_summary_ranks_no_rise_slowest_and_omits_unknown_values():
    rows = hundred()
    rows[:10, 0] = np.inf
    rows[:50, COLUMNS.index("static_error_percent")] = np.nan
    results = summary(CAMPAIGN, result(rows))
    assert results["metrics"]["rise_time_ms"] == {"p5": 15.0, "p50": 60.0, "p95": None}
    assert results["metrics"]["static_error_percent"]["p50"] == 75.0
    assert results["without_rise"] == 10
    rows[:, 0], rows[:, 3] = np.inf, np.nan
    empty = summary(CAMPAIGN, result(rows))
    assert empty["metrics"]["rise_time_ms"] == dict.fromkeys(("p5", "p50", "p95"))
    assert empty["metrics"]["chatter"] == dict.fromkeys(("p5", "p50", "p95"))
    assert json.loads(json.dumps(empty, allow_nan=False)) == empty
    assert any(line.split()[:2] == ["rise_time_ms", "-"] for line in lines([empty]))


def test_the_hash_is_that_of_the_rows():
    rows = hundred()
    first = summary(CAMPAIGN, result(rows))["rows_sha256"]
    rows[3, 3] = np.nextafter(rows[3, 3], 1.0)
    assert summary(CAMPAIGN, result(rows))["rows_sha256"] != first


def test_single_touches_are_of_all_fingers_and_outside_the_hash():
    rows = hundred()
    before = summary(CAMPAIGN, result(rows))
    for n in range(1, TOUCHES + 1):
        rows[:, COLUMNS.index(f"touch_{n}_overshoot_percent")] = n
        rows[:, COLUMNS.index(f"touch_{n}_rise_time_ms")] = np.nan if n > 1 else np.inf
    results = summary(CAMPAIGN, result(rows))
    assert results["metrics"]["touch_overshoot_percent"] == {"p5": 1.0, "p50": 3.0, "p95": 6.0}
    assert results["metrics"]["touch_rise_time_ms"] == dict.fromkeys(("p5", "p50", "p95"))
    assert results["metrics"]["overshoot_percent"] == before["metrics"]["overshoot_percent"]
    assert results["rows_sha256"] == before["rows_sha256"]


def test_rise_spread_is_over_the_touches_of_a_finger():
    rows = hundred()
    rises = [COLUMNS.index(f"touch_{n}_rise_time_ms") for n in range(1, TOUCHES + 1)]
    rows[:, rises] = [2.0, 3.0, 2.5, 2.0, np.nan, 2.0]
    assert summary(CAMPAIGN, result(rows))["metrics"]["rise_spread_ms"]["p95"] == 1.0
    rows[:10, rises[4]] = np.inf
    rows[10:20, rises] = np.nan
    spread = column(rows, "rise_spread_ms")
    assert np.isposinf(spread[:10]).all()
    assert np.isnan(spread[10:20]).all()
    assert set(spread[20:]) == {1.0}
    metric = summary(CAMPAIGN, result(rows))["metrics"]["rise_spread_ms"]
    assert metric == {"p5": 1.0, "p50": 1.0, "p95": None}


def test_edges_are_even_if_touches_rise_within_2_3_ms():
    rows = hundred()
    rises = [COLUMNS.index(f"touch_{n}_rise_time_ms") for n in range(1, TOUCHES + 1)]
    rows[:, rises] = 2.0
    rows[:40, rises[5]] = 2.0 + TOLD_APART + 1e-9
    rows[40:70, rises[5]] = 2.0 + TOLD_APART - 1e-9
    rows[70, rises[0]] = np.inf
    rows[71, rises[1:]] = np.nan
    results = summary(CAMPAIGN, result(rows))
    assert TOLD_APART == 2.3
    assert results["even_edges_share"] == 0.58
    assert "edges within 2.3 ms: 58.0 %" in lines([results])[-2]


def test_several_laws_are_one_table_one_file_and_one_picture(tmp_path):
    other = Campaign(3, Law.PREDICTIVE, VibrationLaw.SCHEDULED, 540e-6, plates="varied")
    rows = [hundred(), 2.0 * hundred()]
    results = [
        summary(campaign, result(of_law))
        for campaign, of_law in zip((CAMPAIGN, other), rows, strict=True)
    ]
    text = lines(results)
    assert text[0] == "100 fingers, seed 3, dead time 540 us, case nominal"
    assert text[1].split("  ")[-2:][1].strip() == "predictive + scheduled"
    assert text[3].split() == ["rise_time_ms", "5", "50", "95", "10", "100", "190"]
    assert text[-2].startswith("predictive + scheduled: in a limit cycle: ")
    write_folder(tmp_path, results, rows)
    assert json.loads((tmp_path / RESULTS).read_text()) == {"campaigns": results}
    _, *table = (tmp_path / FINGERS).read_text().splitlines()
    assert [line.split(",")[0] for line in table] == [*map(str, range(100))] * 2
    assert table[100].split(",")[-2:] == ["predictive", "scheduled"]


def test_nothing_left_to_run_has_no_pace():
    results = summary(CAMPAIGN, result(hundred())._replace(ran_s=0.0))
    assert results["finger_seconds_per_second"] is None
    assert "nothing left to run" in lines([results])[-1]


def test_a_folder_holds_results_fingers_and_a_picture(tmp_path):
    rows = hundred()
    rows[0, 0], rows[1, 2] = np.inf, np.nan
    results = summary(CAMPAIGN, result(rows))
    picture = write_folder(tmp_path / "new" / "folder", [results], [rows])
    folder = picture.parent
    assert {path.name for path in folder.iterdir()} == {*FILES}
    assert json.loads((folder / RESULTS).read_text()) == results
    header, *table = (folder / FINGERS).read_text().splitlines()
    assert header.split(",") == ["finger", *COLUMNS, "law", "vibration_law"]
    read = np.array([[float(cell) for cell in line.split(",")[1:-2]] for line in table])
    assert read.tobytes() == rows.tobytes()
    assert {tuple(line.split(",")[-2:]) for line in table} == {("measured", "pi")}
    assert np.ptp(imread(picture)) == pytest.approx(1.0, abs=0.2)
