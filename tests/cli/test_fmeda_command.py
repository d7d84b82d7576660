"""The command ``fmeda``: results, files, exit codes, and cells that are run alone."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from nodes_on_a_bus import GUARD_S

from smarttac_can.cli import main
from smarttac_can.trials.sensor_sweep import Cell, parse_cell

SOUND = "failure=d:gain:1,mode=AMPLITUDE,identified=sound,cycles=50"


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, ("fmeda", *arguments))


def test_a_cell_of_the_results_runs_alone_to_the_same(tmp_path: Path) -> None:
    file = tmp_path / "results.json"
    run("--random", "12", "--seed", "3", "--json", str(file))
    whole = json.loads(file.read_text())
    assert (whole["cells"], len(whole["results"])) == (12, 12)
    for one in whole["results"][:4]:
        alone = json.loads(run("--cell", one["cell"], "--json", "-").stdout)
        assert alone["results"] == [one]


def test_processes_come_to_the_same_as_one(tmp_path: Path) -> None:
    file = tmp_path / "shared"
    command = (sys.executable, "-m", "smarttac_can", "fmeda", "--random", "16", "--seed", "4")
    # In a process of its own: the tracker of shared resources outlives the pool in this one.
    subprocess.run((*command, "--workers", "2", "--json", str(file)), check=False, timeout=GUARD_S)
    alone = run("--random", "16", "--seed", "4", "--json", "-").stdout
    assert json.loads(file.read_text()) == json.loads(alone)


@pytest.mark.parametrize(("more", "asked"), [((), (7, False)), (("--fine",), (7, True))])
def test_the_seed_draws_the_grid_as_well(
    more: tuple[str, ...], asked: tuple[int, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    grids: list[tuple[int, bool]] = []

    def grid(seed: int, *, fine: bool = False) -> list[Cell]:
        grids.append((seed, fine))
        return [parse_cell(SOUND)]

    monkeypatch.setattr("smarttac_can.cli.trials.grid_cells", grid)
    assert "1 cells, 0 violations" in run("--seed", "7", *more).stdout
    assert grids == [asked]


def test_a_cell_within_the_promise_is_shown() -> None:
    result = run("--cell", SOUND)
    assert result.exit_code == 0, result.output
    assert "1 cells, 0 violations" in result.stdout


def test_a_false_trip_before_the_failure_is_a_violation() -> None:
    # A limit of the force that the finger passes before the sensor fails.
    result = run("--cell", "failure=S3:offset:5000,mode=AMPLITUDE,motion=holding,force=9")
    assert result.exit_code == 1
    assert "a false trip" in result.stdout
    assert "1 cells break the promise" in result.output


def test_healthy_runs_are_counted() -> None:
    result = run("--healthy", "2", "--seed", "1", "--json", "-")
    whole = json.loads(result.stdout[: result.stdout.rindex("}") + 1])
    assert whole["runs"] == 2
    assert whole["cycles"] > 500


@pytest.mark.parametrize(
    "arguments",
    [
        ("--cell", "failure=d:gone:1"),
        ("--cell", "mode=SIDEWAYS"),
        ("--random", "3", "--healthy", "3"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments: tuple[str, ...]) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert "Error: " in result.output
