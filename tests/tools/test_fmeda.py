"""The page of failing sensors is made of its summary, and the summary is that of the code."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from click.testing import CliRunner

from smarttac_can.assurance.trials.sensor_sweep import PROMISES, failures, parse_cell

ROOT = Path(__file__).resolve().parents[2]
ROW = {
    "cells": 7, "ended": {"STUCK": 2, "nothing": 5}, "peak_um": 3.456, "in_a_row": 3, "above": 4,
    "energy_J": 0.0126, "after": 123, "cof_error": 0.1, "violations": 0,
}  # fmt: skip
MADE: dict[str, Any] = {
    "command": "tools/pages/make fmeda --fine --healthy 500 --seed 9",
    "promise": PROMISES._asdict(),
    "sweeps": [
        {"name": "coarse", "seed": 1, "cells": 7, "violations": 0,
         "fingerprint": "0123abcd"},
    ],
    "failures": {"pick-up d: stuck with noise": ROW, "normal gauge: noise": ROW | {
        "ended": {"A": 1, "STUCK": 2, "B": 1, "nothing": 1, "C": 1, "D": 1},
    }},
    "factors": {"motion": {"finger lifts": ROW | {"violations": 2}, "no finger": ROW}},
    "lifts": [{"setpoint": 2.5, "law": "pi", "ended": 0, "peaks_um": [3.4567, 2.9, 2.6],
               "above": [5, 1, 0]}],
    "healthy": {"seed": 9, "runs": 500, "cycles": 4000, "limited": 500, "ended": 12, "false": 1},
}  # fmt: skip
CELLS = [
    parse_cell(f"failure=d:gain:{gain},mode=AMPLITUDE,identified=sound,cycles=20")
    for gain in (0.5, 1.0)
]


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "tools" / "pages"))
    import fmeda  # noqa: PLC0415 - found only now

    return fmeda


@pytest.fixture
def tool(page: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """The tool with two cells for a sweep, one process, and a summary of its own."""
    monkeypatch.setattr(page, "SUMMARY", tmp_path / "fmeda.json")
    monkeypatch.setattr(page, "JOBS", 1)
    monkeypatch.setattr(page, "grid_cells", lambda _seed, *, fine=False: CELLS)
    monkeypatch.setattr(page, "random_cells", lambda count, _seed: CELLS[:count])
    monkeypatch.setattr(page, "_TAPS", replace(page._TAPS, cycles=20))
    return page


def run(tool: ModuleType, *arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(tool.main, arguments)
    return result.exit_code, result.output


def test_the_page_agrees_with_the_summary(page: ModuleType) -> None:
    ((path, text),) = page.fmeda_page().items()
    assert text == path.read_text("utf-8")


def test_fmeda_summary_has_the_failures_and_promise_of_the_code(page: ModuleType) -> None:
    made = page.summed_up()
    assert made["promise"] == PROMISES._asdict()
    assert set(made["failures"]) >= {failure.name for failure in failures()}
    assert sum(sweep["violations"] for sweep in made["sweeps"]) == 0
    assert made["healthy"]["false"] == 0
    assert sum(row["ended"] for row in made["lifts"]) == 0


def test_fmeda_page_shows_promise_runs_and_findings(page: ModuleType) -> None:
    (text,) = page.fmeda_page(MADE).values()
    lines = re.sub("<!--.*?-->", "", text).splitlines()
    for line in (
        "`tools/pages/make fmeda --fine --healthy 500 --seed 9` wrote.",
        "- In any 10 s the true vibration is above its bound for at most 20 cycles (ms),",
        "- The true vibration is at most 9 um.",
        "| 2.5 | pi | 3.46 um, 5 | 2.90 um, 1 | 2.60 um, 0 |",
        "- with a share of 0.99 it is 3.30 um, after an identification with sound sensors;",
        "- with a share of 0.9 it is 3.63 um, otherwise.",
        "| coarse | 1 | 7 | 0 | 0123abcd |",
        "- A fault without a cause in the plate ended 1 of them.",
        "- A true vibration beyond a limit ended 11.",
        "- The drive was limited in 12.5 % of the cycles.",
        "| pick-up d: stuck with noise | 7 | 5 nothing, 2 STUCK | 123 | 3.46 | 4 |",
        "| normal gauge: noise | 7 | 2 STUCK, 1 A, 1 B, 1 nothing, 2 others | 123 | 3.46 | 4 |",
        "| finger lifts | 7 | 5 nothing, 2 STUCK | 123 | 3.46 | 4 |",
    ):
        assert line in lines


def test_rows_are_summed_up_by_patterns(page: ModuleType) -> None:
    assert page.found(["*: *noise"], MADE) == (14, 0, 4, 3.456, 0.0126)
    assert str(page.found(["*noise", "pick-up *"], MADE)) == "none in 14 cells"
    assert str(page.found(["finger lifts"], MADE)) == "2 of 7 cells beyond the promise"
    with pytest.raises(ValueError, match=r"^fmeda\.json has no row gyroscope: \*$"):
        page.found(["gyroscope: *", "finger lifts"], MADE)


def test_fmeda_check_accepts_the_file_of_the_tool(tool: ModuleType) -> None:
    expected = "9 cells, 0 violations; 0 false trips\n"
    told = ("--fine", "--random", "1", "--healthy", "2", "--seed", "5")
    assert run(tool, *told) == (0, expected)
    made = json.loads(tool.SUMMARY.read_text())
    assert made["command"] == f"tools/pages/make fmeda {' '.join(told)}"
    assert [(s["name"], s["seed"], s["cells"]) for s in made["sweeps"]] == [
        ("coarse", 1, 2),
        ("fine", 5, 2),
        ("random", 5, 1),
        ("coarse, 60 Hz/um", 1, 2),
        ("coarse, 150 Hz/um", 1, 2),
    ]
    assert {name: row["cells"] for name, row in made["failures"].items()} == {
        "pick-up d: gain below 1": 3,
        "pick-up d: gain above 1": 2,
    }
    assert made["factors"]["identified"]["identified with all sensors sound"]["cells"] == 5
    assert made["factors"]["mode"]["amplitude"]["cells"] == 5
    assert made["healthy"]["runs"] == 2
    assert run(tool, "--check") == (0, "2 cells, 0 violations\n")


def test_fmeda_check_refuses_changed_figures(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(tool, "--healthy", "1")
    monkeypatch.setattr(tool, "grid_cells", lambda _seed: CELLS[:1])
    code, said = run(tool, "--check")
    assert code == 1
    assert "fmeda.json is stale" in said


def test_a_broken_promise_fails_and_is_written(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = PROMISES._replace(bare_um=1.0, cycles=2)
    monkeypatch.setattr("smarttac_can.assurance.trials.sensor_sweep.PROMISES", broken)
    code, said = run(tool, "--healthy", "1")
    assert code == 1
    assert "cycles above 1.01 um without contact, 5.00 um with it; 2 are promised" in said
    assert f"{tool.SENSORS} --cell {CELLS[0]}" in said
    assert json.loads(tool.SUMMARY.read_text())["sweeps"][0]["violations"] == 2
    assert run(tool, "--check")[0] == 1
