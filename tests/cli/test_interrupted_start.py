"""Ctrl-C while the modules of a command are loaded ends it as Ctrl-C does later on."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
SCRIPT = tomllib.loads(PROJECT.read_text())["project"]["scripts"]["smarttac"]
MODULE, _, FUNCTION = SCRIPT.partition(":")


@pytest.mark.parametrize("loaded", ["click", "smarttac_can.cli.bench"])
@pytest.mark.parametrize(
    "start",
    [("-m", "smarttac_can"), ("-c", f"from {MODULE} import {FUNCTION}; {FUNCTION}()")],
    ids=["module", "script"],
)
def test_a_start_that_is_interrupted(start: tuple[str, str], loaded: str, tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(
        "import signal, sys\n"
        "class Finder:\n"
        "    def find_spec(name, *_):\n"
        f"        if name == {loaded!r}:\n"
        "            signal.raise_signal(signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder)\n"
    )
    done = subprocess.run(
        [sys.executable, *start, "status", "--help"],
        env={"PYTHONPATH": f"{tmp_path}:{PROJECT.parent}"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (1, "", "\nAborted!\n")
