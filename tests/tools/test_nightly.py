"""``tools/nightly`` runs what is asked for, and writes a row of each."""

import runpy
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
TOOL = ROOT / "tools" / "nightly"


@pytest.fixture
def tool(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Names of the tool, whose runs are two short scripts, and whose page is elsewhere."""
    names: dict[str, Any] = runpy.run_path(str(TOOL))["main"].__globals__
    scripts = {"good": "print('first'); print('all | well')", "bad": "raise SystemExit('no way')"}
    runs = []
    for name, script in scripts.items():
        (tmp_path / name).write_text(script)
        runs.append(names["Run"](name, "a script", name))
    monkeypatch.setitem(names, "RUNS", runs)
    monkeypatch.setitem(names, "ROOT", tmp_path)
    monkeypatch.setitem(names, "PAGE", tmp_path / "nightly.md")
    names["PAGE"].write_text(f"By hand.\n{names['RULE']}", "utf-8")
    return names


def call(tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["nightly", *arguments])
    code: int = tool["main"]()
    return code


def test_a_failure_is_on_the_page_and_in_the_exit_code(
    tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(tool, monkeypatch) == 1
    page = capsys.readouterr().out
    assert "| good | a script | `good` | passed | all / well | 0 min |  |" in page
    assert "| bad | a script | `bad` | **failed** with 1 | no way | 0 min |  |" in page


def test_a_row_that_is_not_asked_for_stays(
    tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert call(tool, monkeypatch, "--only", "good", "--write") == 0
    written = tool["PAGE"].read_text()
    assert written.startswith("By hand.\n")
    assert "| bad | a script | `bad` | not run |  |  |  |" in written
    assert call(tool, monkeypatch, "--only", "bad", "--write") == 1
    assert "| good | a script | `good` | passed | all / well |" in tool["PAGE"].read_text()
    assert "| bad | a script | `bad` | **failed** with 1 |" in tool["PAGE"].read_text()


def test_a_dry_run_runs_nothing(
    tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(tool, monkeypatch, "--dry-run", "--only", "bad") == 0
    assert capsys.readouterr().out == f"{'bad':<12}bad\n"


RUNS = {run.name: run for run in runpy.run_path(str(TOOL))["RUNS"]}


@pytest.mark.parametrize("name", RUNS)
def test_every_command_takes_its_options(
    name: str, tool: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(tool, "ROOT", ROOT)
    monkeypatch.syspath_prepend(str(TOOL.parent))
    _, *command = tool["command_of"](RUNS[name])
    if command[0] == "-m":
        command[:2] = [str(ROOT / "smarttac_can")]
    # An option that is not known ends a command before --help is looked at.
    monkeypatch.setattr(sys, "argv", [*command, "--help"])
    with pytest.raises(SystemExit, match=r"^0$"):
        runpy.run_path(command[0], run_name="__main__")


def test_the_page_has_a_row_of_every_run() -> None:
    names = runpy.run_path(str(TOOL))
    text = names["PAGE"].read_text("utf-8")
    assert text == names["page"]({}, text)
