"""Every tool has a help text with an example of its call."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SHELL = {"demo", "environment", "test", "with-vcan-init"}
"""They hand their arguments on, or have one alone."""
PROGRAMS = [
    str(path.relative_to(ROOT))
    for path in sorted((ROOT / "tools").rglob("*"))
    if path.is_file() and path.name not in SHELL and path.read_bytes().startswith(b"#!")
]
NAMES = [
    f"{tool} {name}"
    for tool in ("tools/bench/measure", "tools/pages/make")
    for name in runpy.run_path(str(ROOT / tool))["NAMES"]
]


@pytest.mark.parametrize("call", [*PROGRAMS, *NAMES, "tools/pages/check_docs.py"])
def test_help_of_a_tool_gives_an_example(
    call: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    if call.endswith("conformance"):
        pytest.importorskip("durand", reason="one of the devices that it judges")
    tool, *name = call.split()
    path = ROOT / tool
    if path.read_bytes().startswith(b"#!/usr/bin/env bash"):
        subprocess.run([path, "--help"], check=True)
    else:
        monkeypatch.setattr(sys, "argv", [str(path), *name, "--help"])
        monkeypatch.syspath_prepend(str(path.parent))
        with pytest.raises(SystemExit, match=r"^0$"):
            runpy.run_path(str(path), run_name="__main__")
    assert call in capfd.readouterr().out.partition("Example: ")[2].split("\n")[0]
