"""``tools/nightly`` runs the rows of the page, and writes how they ended."""

import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
TOOL = ROOT / "tools" / "nightly"


@pytest.fixture
def tool(
    load: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> ModuleType:
    """The tool, whose page lists two short scripts."""
    tool = load("nightly")
    scripts = {"good": "print('first'); print('all | well')", "bad": "raise SystemExit('no way')"}
    for name, script in scripts.items():
        (tmp_path / name).write_text(script)
    monkeypatch.setattr(tool, "ROOT", tmp_path)
    monkeypatch.setattr(tool, "PAGE", tmp_path / "nightly.md")
    rows = "".join(f"| {name} | a script | `{name}` | not run |  |  |  |\n" for name in scripts)
    tool.PAGE.write_text(f"By hand.\n{tool.RULE}{rows}", "utf-8")
    return tool


GOOD = "| good | a script | `good` | passed | all / well | 0 min |  |"
BAD = "| bad | a script | `bad` | **failed** with 1 | no way | 0 min |  |"


def test_a_failure_is_on_the_page_and_in_the_exit_code(
    tool: ModuleType, call: Callable[..., int]
) -> None:
    assert call(tool) == 1
    assert tool.PAGE.read_text().splitlines()[2:] == [GOOD, BAD]


def test_row_may_be_a_shell_script(tool: ModuleType, call: Callable[..., int]) -> None:
    script = tool.ROOT / "good"
    script.write_text("#!/usr/bin/env bash\necho 'all | well'\n")
    script.chmod(0o755)
    assert call(tool, "good") == 0
    assert tool.PAGE.read_text().splitlines()[2] == GOOD


def test_output_of_a_run_is_printed(
    tool: ModuleType, capsys: pytest.CaptureFixture[str], call: Callable[..., int]
) -> None:
    assert call(tool, "good") == 0
    assert capsys.readouterr().out == "first\nall | well\n"


def test_a_row_that_is_not_asked_for_stays(tool: ModuleType, call: Callable[..., int]) -> None:
    assert call(tool, "good") == 0
    written = tool.PAGE.read_text()
    assert written.startswith("By hand.\n")
    assert written.splitlines()[2:] == [GOOD, "| bad | a script | `bad` | not run |  |  |  |"]
    assert call(tool, "bad") == 1
    assert tool.PAGE.read_text().splitlines()[2:] == [GOOD, BAD]


def test_a_run_that_the_page_does_not_list(
    tool: ModuleType, capsys: pytest.CaptureFixture[str], call: Callable[..., int]
) -> None:
    with pytest.raises(SystemExit, match=r"^2$"):
        call(tool, "good", "worse")
    assert "nightly.md has no run worse" in capsys.readouterr().err


ROWS = runpy.run_path(str(TOOL))["rows"]()


@pytest.mark.parametrize("name", ROWS)
def test_every_command_takes_its_options(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = runpy.run_path(str(TOOL))["command_of"](ROWS[name])
    if whole[0] != sys.executable:
        subprocess.run([*whole, "--help"], check=True, capture_output=True)
        return
    command = whole[1:]
    if command[:2] == ["-m", "pytest"]:
        assert pytest.main([*command[2:], "--version"]) == 0
        return
    if command[0] == "-m":
        command[:2] = [str(ROOT / command[1].replace(".", "/"))]
    monkeypatch.syspath_prepend(str(Path(command[0]).parent))
    # An option that is not known ends a command before --help is looked at.
    monkeypatch.setattr(sys, "argv", [*command, "--help"])
    with pytest.raises(SystemExit, match=r"^0$"):
        runpy.run_path(command[0], run_name="__main__")
