"""``tools/docs`` says that it goes on, and where the site is."""

import os
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest

TOOL = Path(__file__).parents[2] / "tools" / "docs"


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a project whose Python shows its arguments, and makes no site."""
    for folder in ("tools", ".venv/bin"):
        (tmp_path / folder).mkdir(parents=True)
    shutil.copy(TOOL, tmp_path / "tools")
    for name, text in (("tools/environment", "exit 0"), (".venv/bin/python", 'echo "$@"')):
        (tmp_path / name).write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / name).chmod(0o755)
    return tmp_path


def test_site_is_named_and_sphinx_is_quiet_in_a_file(tree: Path) -> None:
    done = subprocess.run([tree / "tools/docs"], capture_output=True, text=True, check=True)
    assert done.stderr == "making the site, some minutes ...\n"
    sphinx, last = done.stdout.splitlines()
    assert " -q " in sphinx
    assert last == f"the site is in {tree}/build/site; open its index.html"


def test_sphinx_shows_its_progress_on_a_terminal(tree: Path) -> None:
    reader, terminal = os.openpty()
    with os.fdopen(reader, "rb", buffering=0) as screen:
        with os.fdopen(terminal, "wb") as stdout:
            subprocess.run([tree / "tools/docs"], stdout=stdout, stderr=stdout, check=True)
        shown = b""
        with suppress(OSError):  # which is how a terminal ends
            while words := screen.read(1 << 12):
                shown += words
    assert b"-m sphinx" in shown
    assert b" -q " not in shown
