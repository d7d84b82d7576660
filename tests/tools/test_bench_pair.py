"""``tools/bench_pair`` compares two trees that regulate, and record the same; nothing else."""

import json
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
TOOL = ROOT / "tools" / "bench_pair"


@pytest.fixture
def tool() -> dict[str, Any]:
    """Names of the tool, which its functions see."""
    names: dict[str, Any] = runpy.run_path(str(TOOL))["main"].__globals__
    return names


def test_a_tree_against_itself(
    tool: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["bench_pair", str(ROOT), "--ticks", "20", "--pairs", "1", "--json"]
    monkeypatch.setattr(sys, "argv", arguments)
    tool["main"]()
    results = json.loads(capsys.readouterr().out)
    assert len(results) == 2
    assert len({row["trace_sha256"] for row in results.values()}) == 1, "one trace on both links"
    for row in results.values():
        assert row["other_us"] > 0
        assert row["ratio"] == pytest.approx(row["other_us"] / row["here_us"], abs=0.01)


def runs(tool: dict[str, Any], *of_runs: tuple[float, float, str]) -> Iterator[Any]:
    return iter([tool["Run"](*run) for run in of_runs])


def test_the_ratio_is_that_of_the_pairs(
    tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    given = [(us, 0.35, "a") for us in (30.0, 10.0, 90.0, 45.0, 60.0, 50.0)]
    made = runs(tool, *given)
    monkeypatch.setitem(tool, "run_in", lambda *_: next(made))
    row = tool["compare"](Path("/other"), "local", 10, 3)
    assert row == {"other_us": 60.0, "here_us": 45.0, "ratio": 2.0, "trace_sha256": "a"}


@pytest.mark.parametrize(
    ("second", "error"),
    [
        ((1.0, 0.35, "b"), "^local: the trees record different traces: a, b$"),
        ((1.0, 0.33, "a"), r"local: COF 0\.330 is not 0\.35 within 5%$"),
    ],
)
def test_what_cannot_be_compared(
    second: tuple[float, float, str],
    error: str,
    tool: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = runs(tool, (1.0, 0.35, "a"), second)
    monkeypatch.setitem(tool, "run_in", lambda *_: next(made))
    with pytest.raises(SystemExit, match=error):
        tool["compare"](Path("/other"), "local", 10, 1)


def test_a_tree_that_fails_is_named(tool: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=rf"^{tmp_path}, local: ."):
        tool["run_in"](tmp_path, "local", 10)


def test_no_tree(
    tool: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["bench_pair", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        tool["main"]()
    assert ended.value.code == 2
    assert "is no working tree with a package smarttac_can" in capsys.readouterr().err
