"""A hindrance is reported when it is noticed, with its true reason and its cure."""

import ast
import errno
import os
import re
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import click
import pytest
from commands import refusal, run

import smarttac_can.bench
from smarttac_can import __main__
from smarttac_can.bench import BenchError, FaultError, RefusedError, Stimulator
from smarttac_can.bench.errors import in_shell_words
from smarttac_can.cli.shared import plain_errors
from smarttac_can.vocabulary.faults import FaultKind

NOWHERE = ("--interface", "nonsense")
GROUP = "239.74.163.2"


KEPT = "k" * 240
"""A name beside which there is no longer one, so that whoever runs this test could not store."""


@pytest.mark.parametrize("command", ["node", "plate"])
@pytest.mark.parametrize("old", [None, b""])
def test_storage_that_cannot_be_written_is_no_start(
    command: str, old: bytes | None, tmp_path: Path
) -> None:
    if old is not None:
        (tmp_path / KEPT).write_bytes(old)
    before = set(tmp_path.iterdir())
    result = run(command, *NOWHERE, "--storage", tmp_path / KEPT)
    assert (result.exit_code, result.stdout) == (2, ""), "it has not started"
    last = result.stderr.splitlines()[-1]
    assert last.startswith(
        f"Error: Invalid value for '--storage': {tmp_path / KEPT} cannot be written ("
    )
    assert last.endswith(
        "), so that neither parameters nor faults would be kept: name a file in a folder that can "
        "be written, or leave --storage out"
    )
    assert set(tmp_path.iterdir()) == before


def test_storage_in_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    line = refusal("plate", *NOWHERE, "--storage", tmp_path / "no" / "file", code=2)
    assert f"'{tmp_path / 'no'}' is no directory" in line


def test_a_file_system_that_is_read_only_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refuse(path: Path, mode: str) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    monkeypatch.setattr(Path, "open", refuse)
    line = refusal("node", *NOWHERE, "--storage", tmp_path / "kept", code=2)
    assert "kept cannot be written (Read-only file system), so that neither" in line


def test_writable_storage_gives_no_message_and_no_file(tmp_path: Path) -> None:
    refusal("node", *NOWHERE, "--storage", tmp_path / "kept")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("arguments", [["--help"], ["status", "--help"]])
def test_help_that_finds_no_room_is_one_line(arguments: list[str], unbuffered: str) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "smarttac_can", *arguments],
            env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert (done.returncode, done.stderr) == (1, "Error: stdout: No space left on device\n")


@pytest.mark.parametrize(
    "error", [OSError("text only"), OSError(errno.ENOSPC, "No space left on device", "a file")]
)
def test_another_error_is_not_one_of_stdout(
    error: OSError, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr("smarttac_can.cli.main", fail)
    with pytest.raises(OSError) as raised:
        __main__.run()
    assert raised.value is error


@pytest.fixture
def taken_port() -> Iterator[int]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", 0))
        yield other.getsockname()[1]


@pytest.mark.parametrize("command", ["node", "scan", "jitter"])
def test_a_udp_port_that_is_taken(command: str, taken_port: int) -> None:
    bus = ("--interface", "udp_multicast", "--channel", GROUP)
    assert (
        f"; UDP port {taken_port} is taken by another program, or by nodes of another user, which "
        "ss -ulnp shows: end that, or give all that share the bus another port, --bus-option port=N"
    ) in refusal(command, *bus, "--bus-option", f"port={taken_port}")


@pytest.mark.parametrize("command", ["node", "plate", "scan", "jitter", "record x.h5"])
def test_no_bus_is_no_bus_called_none(
    command: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    line = refusal(*command.split())
    assert "no bus was named: give interface and channel, such as --interface socketcan" in line
    assert "in Python interface='socketcan', channel='can0'" in line
    assert "None" not in line


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="processors are chosen on Linux")
@pytest.mark.parametrize("command", ["node", "plate"])
def test_a_processor_that_is_not_there(command: str) -> None:
    allowed = ",".join(map(str, sorted(os.sched_getaffinity(0))))
    assert refusal(command, *NOWHERE, "--realtime", "10", "--cpu", "1023", code=2) == (
        "Invalid value: --cpu: processor 1023 is none of those that this process may use: "
        f"{allowed}"
    )


def latched() -> None:
    with Stimulator.simulate("local") as bench:
        bench.voltage = 20.0
        bench.mode = "open_loop"
        bench.set("Fault.Sensor", 3)
        bench.set("Fault.Kind", FaultKind.STUCK)
        bench.run(0.2)


def armed() -> None:
    with Stimulator.simulate("local") as bench:
        bench.arm()
        bench.tare()


@pytest.mark.parametrize(
    ("act", "error", "ends"),
    [
        (
            latched,
            FaultError,
            "remove the cause, then run smarttac reset",
        ),
        (
            armed,
            RefusedError,
            "it is armed or running, first 'mode off' in smarttac watch --drive, or its Esc",
        ),
    ],
)
def test_a_shell_is_not_told_to_call_python(
    act: Callable[[], None], error: type[BenchError], ends: str
) -> None:
    with pytest.raises(error) as in_a_script:
        act()
    assert re.search(r"[a-z]\(\)", str(in_a_script.value))
    with pytest.raises(click.ClickException) as told, plain_errors():
        act()
    assert told.value.message.endswith(ends)
    assert not re.search(r"[a-z]\(\)|\.trace", told.value.message)


_PYTHON: Final = re.compile(r"[a-z]\(\)|=True|^\.trace")
_OF_SCRIPTS: Final = ("the loop of this stimulator runs already, in another thread",)
"""Failures of a script alone, as they take threads."""


def texts_of(path: Path) -> Iterator[str]:
    """Yield the strings of a module, without docstrings."""
    tree = ast.parse(path.read_text())
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in alone:
            yield node.value


def test_no_message_of_the_bench_tells_a_shell_to_call_python() -> None:
    folder = Path(smarttac_can.bench.__file__).parent
    modules = [path for path in folder.glob("*.py") if path.name != "errors.py"]
    found = [text for path in modules for text in texts_of(path) if _PYTHON.search(text)]
    assert len(found) >= 8
    left = [text for text in found if _PYTHON.search(in_shell_words(text))]
    assert [text for text in left if not text.startswith(_OF_SCRIPTS)] == []


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("/nodir/x.h5", "/nodir/x.h5 cannot be made: the folder /nodir does not exist"),
        (
            "z.h5 --raw /nodir/z.log",
            "/nodir/z.log cannot be made: the folder /nodir does not exist",
        ),
        ("z.h5 --raw z.xyz", "cannot log to z.xyz: "),
        ("z.h5 --raw old.log", "old.log exists: give the raw log another name"),
    ],
)
def test_record_refuses_its_files_before_a_bus(
    command: str, said: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.log").touch()
    bus = ("--interface", "virtual", "--channel", "nobody", "--timeout", "0.1")
    assert said in refusal("record", *command.split(), *bus)
    assert [path.name for path in tmp_path.iterdir()] == ["old.log"]


@pytest.mark.skipif(sys.platform != "linux", reason="/proc is of Linux")
def test_a_folder_that_cannot_be_made_is_no_missing_file() -> None:
    line = refusal("campaign", "--fingers", "1", "--output", "/proc/nope")
    assert "/proc/nope: no folder can be made there" in line


@pytest.mark.parametrize(
    "command", ["node --node-id abc", "campaign --fingers abc", "demo --seed abc"]
)
def test_a_text_is_no_integer(command: str) -> None:
    line = refusal(*command.split(), code=2)
    assert "'abc' is not a valid integer" in line
