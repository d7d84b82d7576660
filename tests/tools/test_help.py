"""Every tool says what it does, and gives an example."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "tools"
PROGRAMS = [
    path
    for path in sorted(FOLDER.iterdir())
    if path.suffix in ("", ".py")
    and path.is_file()
    and ('__name__ == "__main__"' in (text := path.read_text("utf-8")) or text.startswith("#!"))
]
SHELL = {"demo", "environment", "test", "with-vcan-init"}
"""They hand their arguments on, or have one alone."""


@pytest.mark.parametrize(
    "tool",
    [path for path in PROGRAMS if path.name not in SHELL],
    ids=lambda tool: tool.name,
)
def test_help_gives_an_example(tool: Path) -> None:
    if tool.name == "conformance.py":
        pytest.importorskip("durand", reason="one of the devices that it judges")
    shell = tool.read_text("utf-8").startswith("#!/usr/bin/env bash")
    command = [str(tool)] if shell else [sys.executable, str(tool)]
    done = subprocess.run([*command, "--help"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Example: " in done.stdout
    example = done.stdout.partition("Example: ")[2].split("\n")[0]
    assert f"tools/{tool.name}" in example
