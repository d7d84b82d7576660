"""``tools/environment`` refuses unknown extras, and removes what was compiled of older sources."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).parents[2] / "tools" / "environment"
PYTHON = f"""\
#!/bin/sh
[ "$1 $2" != "-m pip" ] || exit 0
exec {sys.executable} "$@"
"""
"""A Python whose pip takes everything, as the true one only warns of an extra that is not there."""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a project of two extras with an environment."""
    for folder in ("tools", ".venv/bin"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copy(TOOL, tmp_path / "tools")
    for name in ("python", "pip"):
        (tmp_path / ".venv/bin" / name).write_text(PYTHON)
        (tmp_path / ".venv/bin" / name).chmod(0o755)
    (tmp_path / "pyproject.toml").write_text(
        "[project.optional-dependencies]\ntest = []\ncheck = []\n"
    )
    return tmp_path


def environment(tree: Path, extras: str) -> tuple[int, str]:
    done = subprocess.run(
        [tree / "tools/environment", extras], capture_output=True, text=True, check=False
    )
    return done.returncode, done.stderr


def stamps(tree: Path) -> list[str]:
    return [file.name for file in (tree / ".venv").glob("installed-*")]


@pytest.mark.parametrize("extras", ["nosuch", "test,nosuch", "test,nosuch,check"])
def test_an_extra_that_is_not_there(tree: Path, extras: str) -> None:
    refused = 2, "tools/environment: there is no extra nosuch, but test, check\n"
    assert [environment(tree, extras) for _ in range(2)] == [refused, refused]
    assert stamps(tree) == []


def test_extras_that_are_there(tree: Path) -> None:
    installing = "installing smarttac-can[test,check] into .venv ...\n"
    assert environment(tree, "test,check") == (0, installing)
    assert environment(tree, "test,check") == (0, "")
    assert stamps(tree) == ["installed-test,check"]


@pytest.mark.parametrize(("source_at", "stays"), [(1000, True), (1002, False)])
def test_compiled_goes_when_a_source_is_newer(tree: Path, source_at: int, stays: bool) -> None:
    environment(tree, "test")
    compiled, source = tree / ".venv/compiled", tree / "smarttac_can/x.py"
    for folder in (compiled, source.parent):
        folder.mkdir()
    for file in (compiled / "x.so", source):
        file.touch()
    os.utime(compiled, (1001, 1001))
    os.utime(source, (source_at, source_at))
    status, words = environment(tree, "test")
    assert (status, compiled.exists()) == (0, stays)
    assert ("the sources are newer than .venv/compiled" in words) is not stays
