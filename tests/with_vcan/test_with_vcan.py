"""``tools/with-vcan`` passes on the input and output of a command, and leaves nothing behind."""

from __future__ import annotations

import errno
import os
import re
import runpy
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest

WITH_VCAN = Path(__file__).parents[2] / "tools" / "with-vcan"
pytestmark = pytest.mark.timeout(600)  # a net may be slow


def left_in(folder: Path) -> list[psutil.Process]:
    """Processes that were started in a folder, and live."""
    left = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):  # zombies have no folder any more
            if Path(process.cwd()).is_relative_to(folder):
                left.append(process)
    return left


def with_vcan(
    *arguments: str, folder: Path, env: dict[bytes, bytes] | None = None
) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, WITH_VCAN, *arguments]
    done = subprocess.run(command, capture_output=True, cwd=folder, env=env, check=False)
    assert left_in(folder) == []
    return done


def test_folder_environment_output_and_status(tmp_path: Path) -> None:
    folder = tmp_path / "it's a folder"
    folder.mkdir()
    odd = b" $HOME `ls` 'a' \"b\" \\ \n\t\xff "
    script = """
import os, pathlib, sys
pathlib.Path("made").write_bytes(os.environb[b"ODD"])
lines = "".join(f"{number}\\n" for number in range(10_000))
print(lines, end="")
print(sys.argv[1:], [os.isatty(number) for number in range(3)], sys.stdin.read(), file=sys.stderr)
for bus in ("vcan0", "vcan1"):
    assert int(pathlib.Path("/sys/class/net", bus, "flags").read_text(), 0) & 1
sys.exit(42)
"""
    arguments = ["two words", "", "line\nend"]
    done = with_vcan(
        *("--", sys.executable, "-c", script, *arguments),
        folder=folder,
        env={**os.environb, b"ODD": odd},
    )
    assert done.stderr.decode() == f"{arguments} [False, False, False] \n"
    assert done.stdout == "".join(f"{number}\n" for number in range(10_000)).encode()
    assert done.returncode == 42
    assert (folder / "made").read_bytes() == odd


@pytest.mark.parametrize("name", ["ping", "nc", "expr", "vi"])
def test_the_programs_of_the_host_are_run(name: str, tmp_path: Path) -> None:
    """Not those of busybox, which have the same names and fewer options."""
    program = tmp_path / "bin" / name
    program.parent.mkdir()
    program.write_text('#!/bin/sh\necho "of the host: $@"\n')
    program.chmod(0o755)
    path = os.fsencode(program.parent) + b":" + os.environb[b"PATH"]
    done = with_vcan("--", name, "-br", "link", folder=tmp_path, env={**os.environb, b"PATH": path})
    assert done.stdout == b"of the host: -br link\n"
    assert (done.returncode, done.stderr) == (0, b"")


APT_WITHOUT_NET = """#!/bin/sh
echo chatter
echo "E: no net" >&2
exit 100
"""
FETCHING = r"with-vcan: fetching Debian's [a-z-]+ \.\.\.\n"
NOT_FETCHED = r"with-vcan: cannot fetch [a-z-]+: E: no net\n"


@pytest.fixture
def fresh_machine(tmp_path: Path) -> dict[bytes, bytes]:
    """Environment with nothing in the cache, and apt-get, in vain, as the only command."""
    apt = tmp_path / "bin" / "apt-get"
    apt.parent.mkdir()
    apt.write_text(APT_WITHOUT_NET)
    apt.chmod(0o755)
    changed = {"PATH": apt.parent, "XDG_CACHE_HOME": tmp_path / "cache"}
    return {**os.environb, **{os.fsencode(n): os.fsencode(value) for n, value in changed.items()}}


def test_a_pipe_is_not_told_that_something_is_fetched(
    fresh_machine: dict[bytes, bytes], tmp_path: Path
) -> None:
    done = with_vcan("--", "true", folder=tmp_path, env=fresh_machine)
    assert (done.stdout, done.returncode) == (b"", 125)
    assert re.fullmatch(NOT_FETCHED, done.stderr.decode())


def on_terminal(*command: str, env: dict[bytes, bytes] | None = None) -> str:
    """Run a command with a terminal as stderr, and return what it shows."""
    reader, terminal = os.openpty()
    with os.fdopen(reader, "rb", buffering=0) as screen:
        with os.fdopen(terminal, "wb") as stderr:
            subprocess.run(
                [sys.executable, WITH_VCAN, "--", *command], stderr=stderr, env=env, check=False
            )
        told = b""
        with suppress(OSError):  # which is how a terminal ends
            while words := screen.read(1 << 12):
                told += words
    return told.decode().replace("\r\n", "\n")


def test_terminal_is_told_of_each_download(fresh_machine: dict[bytes, bytes]) -> None:
    assert re.fullmatch(FETCHING + NOT_FETCHED, on_terminal("true", env=fresh_machine))


@pytest.mark.skipif(Path("/sys/class/net/vcan0").exists(), reason="the host's own buses serve")
def test_terminal_is_told_that_a_kernel_starts() -> None:
    assert on_terminal("sleep", "0").endswith(
        "with-vcan: starting a kernel that has vcan0 and vcan1, some seconds; "
        "then for at most 600 s: sleep 0\n"
    )


def test_two_buses_and_candump(tmp_path: Path) -> None:
    frames = "while sleep 0.1; do cansend vcan1 111#; cansend vcan0 123#4567; done"
    done = with_vcan("--", "sh", "-c", f"{frames} & exec candump -L -n 1 vcan0", folder=tmp_path)
    assert done.stdout.endswith(b" vcan0 123#4567\n")
    assert done.stdout.count(b"\n") == 1


def test_process_left_by_the_command_is_ended(tmp_path: Path) -> None:
    done = with_vcan("--", "sh", "-c", "sleep 1000 & echo done", folder=tmp_path)
    assert (done.stdout, done.returncode) == (b"done\n", 0)


def test_time_out(tmp_path: Path) -> None:
    done = with_vcan("--timeout", "3", "--", "sleep", "1000", folder=tmp_path)
    assert done.returncode == 124
    assert done.stderr == b"with-vcan: stopped after 3 s: sleep 1000\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted(number: signal.Signals, tmp_path: Path) -> None:
    command = [sys.executable, WITH_VCAN, "--", "sh", "-c", "echo up; exec sleep 1000"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=tmp_path) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"up\n"
        assert len(left_in(tmp_path)) > 1
        process.send_signal(number)
        assert process.wait() == 128 + number
    assert left_in(tmp_path) == []


@pytest.mark.parametrize(
    ("command", "status"),
    [(("sh", "-c", "kill -KILL $$"), 128 + signal.SIGKILL), (("no-such-command",), 127)],
)
def test_killed_or_not_found(command: tuple[str, ...], status: int, tmp_path: Path) -> None:
    assert with_vcan("--", *command, folder=tmp_path).returncode == status


@pytest.mark.parametrize(
    ("free", "flags", "place"),
    [(1 << 30, 0, "/dev/shm"), (1 << 20, 0, "/tmp"), (1 << 30, os.ST_NOEXEC, "/tmp")],
    ids=["roomy", "small", "noexec"],
)
def test_place_of_the_machines_memory(
    free: int, flags: int, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(WITH_VCAN.parent)
    machine_environment = runpy.run_path(str(WITH_VCAN))["machine_environment"]
    shared = SimpleNamespace(f_bavail=free, f_frsize=1, f_flag=flags)
    monkeypatch.setattr(os, "statvfs", lambda _folder: shared)
    assert machine_environment("/folder", 512)["TMPDIR"] == place


@pytest.mark.parametrize(("hidden", "answer"), [(True, errno.EIO), (False, errno.ESRCH)])
def test_only_the_wide_registers_are_hidden(hidden: bool, answer: int) -> None:
    script = f"""
import ctypes, runpy
tool = runpy.run_path({str(WITH_VCAN)!r})
if {hidden}:
    tool["hide_wide_registers"]()
libc = ctypes.CDLL(None, use_errno=True)
for what in (0x202, 1):  # all registers, and the short set, of a process that is not traced
    libc.ptrace(0x4204, 0, what, 0)
    print(ctypes.get_errno())
"""
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=WITH_VCAN.parent, capture_output=True, check=True
    )
    assert done.stdout.split() == [b"%d" % answer, b"%d" % errno.ESRCH]
