"""``tools/bench/measure cycle`` times a loop that drives, alone or in two trees."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from smarttac_can.bench import Mode, State, Stimulator

ROOT = Path(__file__).parents[2]


@pytest.fixture
def tool(load: Callable[[str], ModuleType]) -> ModuleType:
    return load("bench/cycle.py")


def test_a_cycle_costs_time_over_every_link(
    tool: ModuleType, capsys: pytest.CaptureFixture[str], call: Callable[..., int]
) -> None:
    call(tool, "--ticks", "20", "--pairs", "2", "--json")
    rows = json.loads(capsys.readouterr().out).values()
    assert len(rows) == 3
    for row in rows:
        assert row["here"] > 0
        assert row["real_time"] == pytest.approx(1e3 / row["here"], abs=0.1)


def test_a_loop_that_is_off_is_an_error(tool: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    off = property(None, lambda bench, _: bench.disarm())
    monkeypatch.setattr(Stimulator, "mode", off)
    monkeypatch.chdir(ROOT)
    with pytest.raises(SystemExit, match=r"^state READY, mode OFF, a finger"):
        tool.recorded("local", 20)


@dataclass
class Said:
    """Figures of a bench about its loop."""

    state: State = State.RUNNING
    mode: Mode = Mode.FRICTION
    touching: int = 1

    def get(self, name: str) -> float:
        return {"Mode display": self.mode, "Contact.Touching": self.touching}[name]


@pytest.mark.parametrize("cof", [0.335, 0.365])
def test_regulated_friction(tool: ModuleType, cof: float) -> None:
    tool.require_friction(Said(), cof)


@pytest.mark.parametrize(
    ("said", "cof", "error"),
    [
        (Said(state=State.READY), 0.35, "state READY, mode FRICTION, a finger, COF 0.350:"),
        (Said(mode=Mode.AMPLITUDE), 0.35, "state RUNNING, mode AMPLITUDE, a finger, COF 0.350:"),
        (Said(touching=0), 0.35, "state RUNNING, mode FRICTION, no finger, COF 0.350:"),
        (Said(), 0.33, "state RUNNING, mode FRICTION, a finger, COF 0.330:"),
        (Said(), 0.37, "state RUNNING, mode FRICTION, a finger, COF 0.370:"),
    ],
)
def test_friction_that_is_not_regulated(
    tool: ModuleType, said: Said, cof: float, error: str
) -> None:
    with pytest.raises(
        SystemExit, match=rf"^{error} friction is not regulated to 0\.35 within 5%$"
    ):
        tool.require_friction(said, cof)


def test_a_tree_against_itself(
    tool: ModuleType, capsys: pytest.CaptureFixture[str], call: Callable[..., int]
) -> None:
    call(tool, "--against", str(ROOT), "--ticks", "20", "--pairs", "1", "--json")
    results = json.loads(capsys.readouterr().out)
    assert len(results) == 3
    assert len({row["trace_sha256"] for row in results.values()}) == 1, "one trace on all links"
    for row in results.values():
        assert row["other"] > 0
        assert row["ratio"] == pytest.approx(row["here"] / row["other"], abs=0.01)


def give(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch, **runs: list[tuple[float, str]]
) -> None:
    """Let the runs of the other tree and of this give us of a cycle and a hash, in their order."""
    left = {"/other": iter(runs["other"]), str(ROOT): iter(runs["here"])}

    def results_in(tree: Path, *_: str) -> dict[str, Any]:
        return dict(zip(("us", "sha256"), next(left[str(tree)]), strict=True))

    monkeypatch.setattr(tool, "results_in", results_in)


def test_the_ratio_is_that_of_the_pairs(tool: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    other, here = ([(us, "a") for us in many] for many in ((30.0, 90.0, 60.0), (15.0, 45.0, 30.0)))
    give(tool, monkeypatch, other=other, here=here)
    assert tool.measured("local", [ROOT, Path("/other")], 10, 3) == {
        "other": 60.0, "here": 30.0, "ratio": 0.5, "range": [0.5, 0.5], "real_time": 33.3,
        "trace_sha256": "a",
    }  # fmt: skip


def test_trees_that_record_something_else(
    tool: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    give(tool, monkeypatch, other=[(1.0, "a")], here=[(1.0, "b")])
    with pytest.raises(SystemExit, match=r"^local: the trees record different traces: a, b$"):
        tool.measured("local", [ROOT, Path("/other")], 10, 1)


def test_a_tree_that_fails_is_named(tool: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=rf"^Error: {tmp_path}: .*--one local .*: ."):
        tool.measured("local", [tmp_path], 10, 1)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--against", "{empty}"], "has no smarttac_can"),
        (["--against", str(ROOT), "--pairs", "0"], "--ticks and --pairs have to be 1 or more"),
        (["--ticks", "0"], "--ticks and --pairs have to be 1 or more"),
    ],
)
def test_wrong_arguments(
    arguments: list[str],
    error: str,
    tool: ModuleType,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    call: Callable[..., int],
) -> None:
    with pytest.raises(SystemExit, match=r"^2$"):
        call(tool, *(each.format(empty=tmp_path) for each in arguments))
    assert error in capsys.readouterr().err
