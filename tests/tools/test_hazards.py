"""Every hazard names watchdogs and tests that exist, and every watchdog stands for a hazard."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from smarttac_can.assurance.trials.sensor_sweep import failures
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.host.files import read_eds
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

ROOT = Path(__file__).resolve().parents[2]
CAUSES = [
    cause
    for hazard in tomllib.loads((ROOT / "tools" / "pages" / "hazards.toml").read_text())["hazard"]
    for cause in hazard["cause"]
]


@pytest.mark.parametrize("cause", CAUSES, ids=[cause["name"] for cause in CAUSES])
def test_the_tests_of_a_cause_exist(cause: dict[str, list[str]]) -> None:
    assert cause["tests"]
    for test in cause["tests"]:
        file, _, name = test.partition("::")
        tree = ast.parse((ROOT / file).read_text())
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, test


def test_every_watchdog_stands_for_a_hazard() -> None:
    named = {name for cause in CAUSES for name in cause["watchdogs"]}
    assert named == {watchdog.name for watchdog in Watchdog}


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "tools" / "pages"))
    import hazards  # noqa: PLC0415 - found only now

    return hazards


def row(pages: dict[Path, str], what: str) -> str:
    (page,) = pages.values()
    (line,) = [line for line in page.splitlines() if line.startswith(f"| {what}")]
    return line


def test_hazards_page_is_up_to_date(tool: ModuleType) -> None:
    ((path, text),) = tool.hazards_page().items()
    assert text == path.read_text("utf-8")


def test_no_time_and_no_vibration_is_typed_in() -> None:
    for cause in CAUSES:
        typed = re.findall(r"\b\d+(?:\.\d+)? (?:cycles?|ms|um|s|%)(?!\w)", cause["bound"])
        assert not typed, cause["name"]
        until = cause["until"]
        assert isinstance(until, list) or until in ("at once", "for ever", "no drive")
        assert "reached" not in cause


def late_cut(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("hazards.AT_ONCE", 50)


def missed_time(patch: pytest.MonkeyPatch) -> None:
    patch.setitem(
        WATCHDOGS, Watchdog.MISSED_TIME, WATCHDOGS[Watchdog.MISSED_TIME]._replace(bound=9000)
    )


def lax_deadline(patch: pytest.MonkeyPatch) -> None:
    patch.setattr("hazards.NOT_OPERATIONAL_US", 5_000_000)


@pytest.mark.parametrize(
    ("change", "what", "bound", "reached"),
    [
        (late_cut, "the loop overshoots", "50 cycle to 0 V", "7.5 um for 50 ms, 0.28 J;"),
        (missed_time, "the loop misses", "9000 ms, if more", "3.2 um for 9000 ms, 9.1 J |"),
        (lax_deadline, "the master dies", "5000 ms when", "3.2 um for 5000 ms, 5 J;"),
    ],
)
def test_another_bound_in_the_code_is_another_row(
    tool: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    change: Callable[[pytest.MonkeyPatch], None],
    what: str,
    bound: str,
    reached: str,
) -> None:
    before = row(tool.hazards_page(), what)
    assert bound not in before
    change(monkeypatch)
    after = row(tool.hazards_page(), what)
    assert bound in after
    assert reached in after


@pytest.mark.parametrize(
    ("what", "reached"),
    [
        # K V = 7.5 um, tau = 0.944 ms, from 3.2 um: 7.5 - 4.3 exp(-5/0.944) = 7.48.
        ("the stage does not obey", "| 7.5 um for 5 ms, 28 mJ; 4.81 um in the matrix |"),
        ("the stimulator dies", "| 7.5 um for 20 ms, 0.11 J; 2.20 um in the matrix |"),
        ("open loop, without", "| 3.0 um |"),
        ("the plate process stops", "| 7.5 um for as long as it lasts, 5.5 W |"),
        ("an EDS with other limits", "| 0 V |"),
        # The drive is cut to 5 um: 0.5 * 10.6 * (pi 43390 5e-6)^2 * 0.037 = 0.091 J.
        ("the pick-up loses gain", "| 5.0 um for 37 ms, 91 mJ; "),
    ],
)
def test_hazard_row_states_the_expected_bound(tool: ModuleType, what: str, reached: str) -> None:
    assert reached in row(tool.hazards_page(), what)


def test_the_vibration_grows_with_the_time_constant(tool: ModuleType) -> None:
    od = load_eds(read_eds("stimulator.eds"), 1)
    # 7.5 - 4.3 exp(-1/0.944) = 6.01, 7.5 - 4.3 exp(-3/0.944) = 7.32.
    assert tool.grown(1e-3, od) == pytest.approx(6.01e-6, abs=5e-9)
    assert tool.grown(3e-3, od) == pytest.approx(7.32e-6, abs=5e-9)


def test_a_fault_that_is_not_in_the_matrix_is_named(tool: ModuleType) -> None:
    assert tool.simulated(["power stage stuck"]) == {("power stage stuck", 7): 4.81}
    with pytest.raises(ValueError, match=r"^faults\.md has no row power stage melts$"):
        tool.simulated(["power stage stuck", "power stage melts"])


def test_hazard_residual_is_the_finding_of_the_sweep(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = {"cells": 3, "violations": 0, "above": 4, "peak_um": 5.514, "energy_J": 0.01}
    made = tool.summed_up()
    # Without the failures that vary: which of them were drawn is another sweep's seed.
    rows = {
        name: made["failures"][name] | {**found, "violations": int(name == "thermometer: stuck")}
        for name in {failure.name for failure in failures()}
    }
    monkeypatch.setattr(tool, "summed_up", lambda: made | {"failures": rows})
    page = tool.hazards_page()
    gauges = row(page, "gauges are stuck")
    assert "; 5.51 um, 4 ms of it above the bound in the sweep |" in gauges
    assert "| vibration: none in 48 cells of the sweep; friction: " in gauges
    assert "vibration: 1 of 21 cells beyond the promise of the sweep" in row(
        page, "the thermometer"
    )
    assert row(page, "lateral force: S1").endswith(
        "| none in 24 cells of the sweep; 5.51 um, 4 ms of it above the bound in the sweep |"
    )


def test_hazard_without_residual_cites_a_sweep_or_attack() -> None:
    for cause in CAUSES:
        residual = cause["residual"]
        assert "none known" not in residual, cause["name"]
        if residual.startswith(("none", "nothing")):
            assert "{" in residual, cause["name"]
