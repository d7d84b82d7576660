"""``tools/with-browser``: which browser a command finds, and its message where there is none."""

import subprocess
import sys
from pathlib import Path

TOOL = Path(__file__).parents[2] / "tools" / "with-browser"


def run(folder: Path, *command: str) -> "subprocess.CompletedProcess[str]":
    variables = {"PATH": str(folder), "XDG_CACHE_HOME": str(folder / "cache")}
    return subprocess.run(
        [sys.executable, TOOL, *command], env=variables, capture_output=True, text=True, check=False
    )


def executable(folder: Path, name: str, script: str) -> str:
    path = folder / name
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o700)
    return str(path)


def test_the_host_s_own_browser_serves(tmp_path: Path) -> None:
    own = [executable(tmp_path, name, "") for name in ("chromium", "chromedriver")]
    executable(tmp_path, "show", 'echo "$CHROMIUM" "$CHROMEDRIVER" "$1"; exit 7')
    done = run(tmp_path, "show", "a word")
    assert (done.returncode, done.stderr) == (7, "")
    assert done.stdout == f"{own[0]} {own[1]} a word\n"


def test_fetched_browser_is_found(tmp_path: Path) -> None:
    usr = tmp_path / "cache" / "smarttac-can" / "chromium" / "usr"
    usr.mkdir(parents=True)
    executable(tmp_path, "show", 'echo "$CHROMIUM" "$BROWSER_LIBRARIES"')
    done = run(tmp_path, "show")
    assert done.stdout == f"{usr}/lib/chromium/chromium \n", "the host has all libraries"
    libraries = usr / "lib" / "some-linux-gnu"
    libraries.mkdir(parents=True)
    done = run(tmp_path, "show")
    assert done.stdout == f"{usr}/lib/chromium/chromium {libraries}:{libraries}/pulseaudio\n"


def test_where_it_cannot_be_had_it_fails_by_name(tmp_path: Path) -> None:
    done = run(tmp_path, "true")
    begin = "with-browser: the browser cannot be had: "
    assert (done.returncode, done.stdout) == (125, "")
    assert done.stderr.startswith(begin)
    assert "apt-get" in done.stderr
    executable(tmp_path, "apt-get", "echo W: old >&2; echo E: no network >&2; exit 100")
    done = run(tmp_path, "true")
    assert (done.returncode, done.stderr) == (125, f"{begin}E: no network\n")
    assert not list((tmp_path / "cache" / "smarttac-can").iterdir())


def test_with_browser_refuses_another_axe_than_the_pinned_one(tmp_path: Path) -> None:
    for name in ("chromium", "chromedriver"):
        executable(tmp_path, name, "")
    executable(tmp_path, "npm", 'echo another > "$3/axe-core-4.14.1.tgz"')
    done = run(tmp_path, "true")
    assert done.returncode == 125
    assert "axe-core of npm has the SHA-256 " in done.stderr
    assert not (tmp_path / "cache").exists()


def test_help_is_its_own(tmp_path: Path) -> None:
    assert "Example: tools/with-browser" in run(tmp_path, "--help").stdout
