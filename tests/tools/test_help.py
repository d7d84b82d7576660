"""Every tool has a summary and an example."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "tools"
PROGRAMS = [
    path
    for path in sorted(FOLDER.rglob("*"))
    if path.suffix in ("", ".py")
    and path.is_file()
    and ('__name__ == "__main__"' in (text := path.read_text("utf-8")) or text.startswith("#!"))
]
SHELL = {"demo", "environment", "test", "with-vcan-init"}
"""They hand their arguments on, or have one alone."""


@pytest.mark.parametrize(
    "tool",
    [path for path in PROGRAMS if path.name not in SHELL],
    ids=lambda tool: str(tool.relative_to(FOLDER)),
)
def test_help_gives_an_example(
    tool: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    if tool.name == "conformance.py":
        pytest.importorskip("durand", reason="one of the devices that it judges")
    if tool.read_text("utf-8").startswith("#!/usr/bin/env bash"):
        subprocess.run([tool, "--help"], check=True)
    else:
        monkeypatch.setattr(sys, "argv", [str(tool), "--help"])
        monkeypatch.syspath_prepend(str(tool.parent))
        with pytest.raises(SystemExit, match=r"^0$"):
            runpy.run_path(str(tool), run_name="__main__")
    example = capfd.readouterr().out.partition("Example: ")[2].split("\n")[0]
    assert f"tools/{tool.relative_to(FOLDER)}" in example
