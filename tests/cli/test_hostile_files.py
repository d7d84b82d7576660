"""Files that are none, or made to take all there is: one line, exit 1, and a bounded work."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from commands import refusal, run
from nodes_on_a_bus import GUARD_S, processes

from smarttac_can.host.files import read_eds

VIRTUAL = ("--interface", "virtual", "--channel", "hostile")
MIB = 1 << 20
SLACK = MIB // 4
"""Bytes that are read besides the hostile file: our own EDS files, and those of the system."""
IN_FORKS = """
import cProfile, json, os, resource, sys, tempfile
import click
from smarttac_can.cli import main

commands = json.load(sys.stdin)
for name, *_ in commands:
    main.get_command(click.Context(main), name)  # reads its modules

def number(file, key):
    lines = open(f"/proc/self/{file}").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key))

def run(arguments, said):
    os.dup2(said.fileno(), 2)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    resource.setrlimit(resource.RLIMIT_AS, (600 << 20, 600 << 20))
    before = number("io", "rchar")
    status = 0
    profile = cProfile.Profile()
    try:
        profile.runcall(main, arguments)
    except SystemExit as error:
        status = error.code
    sys.stderr.flush()
    read = number("io", "rchar") - before
    calls = sum(entry.callcount for entry in profile.getstats())
    return status, read, number("status", "VmHWM"), calls

def done(arguments):
    with tempfile.TemporaryFile("w+") as said, tempfile.TemporaryFile("w+") as counted:
        if not os.fork():
            json.dump(run(arguments, said), counted)
            counted.flush()
            os._exit(0)
        os.wait()
        said.seek(0)
        counted.seek(0)
        return said.read(), *json.load(counted)

print(json.dumps([done(arguments) for arguments in commands]))
"""


class Done(NamedTuple):
    """How a command ended in a process of its own whose modules were read before."""

    said: str
    status: int
    read: int
    """Bytes."""
    peak_kib: int
    calls: int
    """Calls of functions, built-in ones too: the work, on any machine and beside any load."""


def in_forks(commands: list[list[str]]) -> list[Done]:
    child = subprocess.run(
        [sys.executable, "-c", IN_FORKS],
        input=json.dumps(commands),
        capture_output=True,
        text=True,
        timeout=4 * GUARD_S,
        check=True,
    )
    return [Done(*each) for each in json.loads(child.stdout)]


STIMULATOR = read_eds("stimulator.eds")
HEADER = "t_s,x_mm,Fn_N\n"


def fifo(path: Path) -> None:
    os.mkfifo(path)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(8 << 30)


def text(content: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(content)


def objects(count: int) -> str:
    """The stimulator with as many arrays of 254 objects more."""
    array = "ParameterName=x\nObjectType=8\nDataType=5\nAccessType=ro\nCompactSubObj=254\n"
    return STIMULATOR + "".join(f"[{0xA000 + i:X}]\n{array}" for i in range(count))


NO_FILE = "is no regular file"
SOME = ("node", *VIRTUAL)
CASES: dict[str, tuple[tuple[str, ...], Callable[[Path], object], int, str]] = {
    "zeros as EDS": ((*SOME, "--eds"), device, 0, NO_FILE),
    "8 GiB as EDS": ((*SOME, "--eds"), sparse, 4 * MIB, "is larger than 4194304 bytes"),
    "a million sections": (
        (*SOME, "--eds"),
        text("".join(f"[{i:x}]\n" for i in range(1_000_000))),
        4 * MIB,
        "is larger than 4194304 bytes",
    ),
    "a million lines": (
        (*SOME, "--eds"),
        text("[x]\n" * 1_000_000),
        4 * MIB,
        "line 1003: more than 1000 lines before it are odd",
    ),
    "a million objects": (
        (*SOME, "--eds"),
        text(objects(4000)),
        MIB,
        "there are more than 32768 sub-indices",
    ),
    "a name of 3 MiB": (
        (*SOME, "--eds"),
        text(STIMULATOR.replace("=Mode\n", f"=Mode{' ' * 3 * MIB}x\n")),
        4 * MIB,
        "ParameterName is longer than 241 characters",
    ),
    "8 GiB as storage": ((*SOME, "--storage"), sparse, 4 * MIB, "is larger than 4194304 bytes"),
    "8 GiB as finger": ((*SOME, "--finger"), sparse, 8 * MIB, "is larger than 8388608 bytes"),
    "a field of 7 MB": (
        (*SOME, "--finger"),
        text(f"{HEADER}0,0,{'1' * 7_000_000}\n"),
        8 * MIB,
        "line 2: Fn_N has 7000000 characters, above 100",
    ),
    "7 million fields": (
        (*SOME, "--finger"),
        text(f"{HEADER}{',' * 7_000_000}\n"),
        8 * MIB,
        "line 2: 7000001 fields are not the 3 of the header",
    ),
    "a million rows": (
        (*SOME, "--finger"),
        text(HEADER + "".join(f"{i},0,0\n" for i in range(700_000))),
        8 * MIB,
        "line 100002: there are more than 100000 rows",
    ),
}


@pytest.mark.skipif(sys.platform != "linux", reason="bytes and memory are read from /proc")
def test_one_line_and_no_more_read_than_the_bound(tmp_path: Path) -> None:
    commands = []
    for number, (arguments, make, _, _) in enumerate(CASES.values()):
        path = tmp_path / str(number)
        make(path)
        commands.append([*arguments, str(path)])
    for (name, (_, _, most, message)), command, done in zip(
        CASES.items(), commands, in_forks(commands), strict=True
    ):
        (line,) = done.said.splitlines()
        # The link to a device is followed before its name is told.
        assert line.startswith((f"Error: {command[-1]}: ", "Error: /dev/zero: ")), name
        assert line.endswith(message), name
        assert done.status == 1, name
        assert done.read <= most + SLACK, name
        assert done.peak_kib < 300 * 1024, name


def lines_more(line: str, count: int = 39_000) -> str:
    """The stimulator with as many lines as are taken."""
    number = count - STIMULATOR.count("\n")
    return STIMULATOR + "".join(line.format(n) for n in range(number // line.count("\n")))


OTHER_DCF = ("dcf", "--node-id", "5", "--bitrate", "1000000")
LARGEST = {
    "sub-indices": objects(126),
    "sections": lines_more("[x{}]\n"),
    "keys": lines_more("k{}=1\n"),
    "comments": lines_more("; nothing {}\n"),
    "odd lines": lines_more("odd {}\n"),
    "listed": STIMULATOR.replace(
        "[ManufacturerObjects]\n",
        "[ManufacturerObjects]\n" + "".join(f"{n}=0x2000\n" for n in range(2000, 37_000)),
    ),
}

LARGE = [
    *((("check",), kind) for kind in LARGEST),
    *((command, kind) for command in (("doc",), ("dbc",), OTHER_DCF)
      for kind in ("sub-indices", "keys")),
]  # fmt: skip


@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")
@pytest.mark.parametrize(("command", "kind"), LARGE, ids=str)
def test_largest_files_take_200_calls_a_line_and_300_mib(
    command: tuple[str, ...], kind: str, tmp_path: Path
) -> None:
    """Of 39 000 lines, or 32 000 sub-indices that a few lines make."""
    path = tmp_path / "large.eds"
    path.write_text(LARGEST[kind])
    (done,) = in_forks([["eds", *command, str(path)]])
    assert done.calls < 200 * 39_000
    assert done.peak_kib < 300 * 1024


OTHERS = [
    ("plate", *VIRTUAL, "--eds"),
    ("plate", *VIRTUAL, "--storage"),
    ("plate", *VIRTUAL, "--finger"),
    ("device", *VIRTUAL, "--eds"),
    ("device", *VIRTUAL, "--eds", "{eds}", "--storage"),
    ("scan", *VIRTUAL, "--eds"),
    ("conform", *VIRTUAL, "--node-id", "5", "--eds"),
    ("eds", "check"),
    ("eds", "doc"),
    ("eds", "dbc"),
    ("eds", "dcf", "--node-id", "5", "--bitrate", "1000000"),
]


@pytest.mark.parametrize("arguments", OTHERS, ids=" ".join)
def test_no_command_waits_for_a_pipe(arguments: tuple[str, ...], tmp_path: Path) -> None:
    path, eds = tmp_path / "pipe", tmp_path / "some.eds"
    os.mkfifo(path)
    eds.write_text(read_eds("plate.eds"))
    given = [argument.format(eds=eds) for argument in arguments]
    assert refusal(*given, path) == f"{path}: is no regular file"


@pytest.mark.parametrize("command", ["node", "plate", "device", "replay"])
@pytest.mark.parametrize("content", [b"print(1)\n", b"CO-STOrE"])
def test_malformed_storage_file_is_left_unchanged(
    command: str, content: bytes, tmp_path: Path
) -> None:
    path, beside = tmp_path / "mine.py", tmp_path / "mine.py.new"
    for file in (path, beside, tmp_path / "log"):
        file.write_bytes(content)
    (tmp_path / "eds").write_text(read_eds("plate.eds"))
    nowhere = ["--interface", "nonsense"]
    given = {
        "device": [*nowhere, "--eds", str(tmp_path / "eds")],
        "replay": [str(tmp_path / "log")],
    }.get(command, nowhere)
    said = refusal(command, *given, "--storage", path)
    assert said == f"{path}: holds nothing that a device has stored"
    assert path.read_bytes() == beside.read_bytes() == content


@pytest.mark.parametrize("content", [b"", b"CO-S", b"CO-STORE torn"])
def test_storage_file_of_any_device_is_taken(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "kept"
    path.write_bytes(content)
    line = refusal("node", "--interface", "nonsense", "--storage", path)
    assert "cannot open the nonsense bus" in line


HOSTILE_RUNS = {
    "deep": ("results.json", text("[" * MIB), "maximum recursion depth exceeded"),
    "pipe": ("results.json", fifo, NO_FILE),
    "8 GiB": ("results.json", sparse, "is larger than 4194304 bytes"),
    "pipe of traces": ("traces.csv", fifo, NO_FILE),
    "8 GiB of traces": ("traces.csv", sparse, "line 1 is neither # format: SMARTTAC traces 2 nor"),
}


@pytest.mark.parametrize(("name", "make", "message"), HOSTILE_RUNS.values(), ids=HOSTILE_RUNS)
def test_a_run_that_is_none(
    name: str, make: Callable[[Path], object], message: str, tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    if name == "traces.csv":
        (tmp_path / "results.json").write_text(json.dumps({"trace_sha256": ""}))
    make(tmp_path / name)
    assert message in refusal("report", tmp_path)


COLOUR = "\x1b[31m"


@pytest.mark.parametrize("character", ["\0", "\x07", "\x1b", "\x7f", "\x9b"])
@pytest.mark.parametrize("arguments", [(*SOME, "--eds"), ("eds", "doc")])
def test_control_characters_in_a_name_are_refused(
    arguments: tuple[str, ...], character: str, tmp_path: Path
) -> None:
    path = tmp_path / "some.eds"
    before, name, after = STIMULATOR.partition("=Mode\n")
    assert name
    path.write_text(f"{before}=Mo{character}de\n{after}", encoding="utf-8")
    number = 1 + before.count("\n")
    said = refusal(*arguments, path)
    assert said == f"{path}: line {number}: {character!r} is a control character"


def test_nothing_that_a_terminal_obeys_reaches_it(tmp_path: Path) -> None:
    path = tmp_path / f"{COLOUR}.eds"
    backwards = "\u202e"
    odd = "".join(f"[{backwards}{number}]\n" for number in range(50))
    path.write_text(odd + read_eds("plate.eds"), encoding="utf-8")
    result = run(*SOME, "--eds", path)
    assert result.exit_code == 1
    *warnings, error = result.stderr.splitlines()
    assert result.stderr.replace("\n", "").isprintable()
    assert "\\x1b[31m.eds: line 1 and of 49 more: not all characters are ASCII" in warnings[0]
    assert "\\x1b[31m.eds: section [\\u202e0] is not known, ignored" in warnings[1]
    assert len(warnings) == 21
    assert warnings[-1].endswith(": 31 more warnings")
    assert "does not suit the device" in error
    finger = tmp_path / "finger.csv"
    finger.write_text(f"{HEADER}0,0,{COLOUR}\n")
    assert refusal(*SOME, "--finger", finger).endswith("Fn_N '\\x1b[31m' is not a number")


def test_a_value_of_3_mb_is_told_in_500_characters(tmp_path: Path) -> None:
    path = tmp_path / "long.eds"
    path.write_text(STIMULATOR.replace("DefaultValue=15000", f"DefaultValue={'1' * 3_000_000}"))
    said = refusal(*SOME, "--eds", path)
    assert said.endswith("1...")
    assert len(said) == 503


def test_the_largest_files_that_are_taken_leave_signals_alone(
    multicast: dict[str, Any], tmp_path: Path
) -> None:
    finger, eds = tmp_path / "finger.csv", tmp_path / "large.eds"
    finger.write_text(HEADER + "".join(f"{i},0,0\n" for i in range(100_000)))
    comments = "; nothing\n" * (39_990 - STIMULATOR.count("\n"))
    eds.write_text(STIMULATOR + comments)
    with processes(multicast, f"node --finger {finger} --eds {eds}") as (node,):
        status, lines, complaints = node.end()
    assert (status, complaints) == (0, "")
    assert lines[-1] == "stimulator 32 stopped at 0 V"
