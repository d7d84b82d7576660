"""The examples run as they stand, beside a node or through the tool they are written for."""

import os
import re
import runpy
import struct
import subprocess
import sys
from pathlib import Path
from shutil import copytree
from typing import Any

import pytest
from commands import succeed
from nodes_on_a_bus import in_threads, stimulator_with_plate

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od.eds import load_eds

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
NODE_ID = 32


def test_python_can_with_cantools(
    virtual: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    dbc = tmp_path / "stimulator-32.dbc"
    dbc.write_text(succeed("eds", "dbc", "stimulator", "--node-id", "32"))
    node = stimulator_with_plate(lockstep=False)
    options = ["--interface", virtual["interface"], "--channel", virtual["channel"]]
    monkeypatch.setattr(sys, "argv", ["with_cantools.py", str(dbc), *options])
    with in_threads(virtual, node, lockstep=False):
        runpy.run_path(str(EXAMPLES / "with_cantools.py"), run_name="__main__")
    printed = capsys.readouterr().out.splitlines()
    for number in range(1, 5):
        assert [line for line in printed if f"_TPDO{number} " in line], printed
    assert re.search(r"TPDO2 .*'Contact_Normal_force': -?\d", "\n".join(printed))


@pytest.mark.parametrize(
    ("dbc", "channel", "refusal"),
    [
        ("missing.dbc", "can0", "No such file or directory: 'missing.dbc'"),
        ("broken.dbc", "can0", "Invalid syntax at line 1"),
        ("empty.dbc", "nocan7", "[Errno "),
    ],
)
def test_python_can_example_names_a_missing_cantools(
    dbc: str,
    channel: str,
    refusal: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("broken.dbc").write_text("nonsense")
    Path("empty.dbc").write_text('VERSION ""\n')
    options = ["--interface", "socketcan", "--channel", channel]
    monkeypatch.setattr(sys, "argv", ["with_cantools.py", dbc, *options])
    with pytest.raises(SystemExit, match="2"):
        runpy.run_path(str(EXAMPLES / "with_cantools.py"), run_name="__main__")
    assert refusal in capsys.readouterr().err


@pytest.fixture(scope="module")
def configured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the bus configuration by the commands of the page."""
    page = (ROOT / "docs" / "how-to" / "integrate-with-a-master.md").read_text()
    console = page.partition("## With lely core or ROS 2")[2].split("```")[1]
    commands = [line[2:] for line in console.splitlines() if line.startswith("$ ")]
    assert len(commands) == 3
    folder = tmp_path_factory.mktemp("lely")
    copytree(EXAMPLES, folder / "examples")
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    for command in commands:
        done = subprocess.run(
            command.split(), cwd=folder, env={**os.environ, "PATH": path},
            check=True, capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        warnings = [line for line in done.stderr.splitlines() if "Warning" in line]
        assert not [line for line in warnings if "pkg_resources" not in line]
    return folder / "config"


def test_dcfgen_takes_the_bus_configuration(configured: Path) -> None:
    master = load_eds((configured / "master.dcf").read_text(), 1)
    assert master.number(0x1F81, NODE_ID) & 0b101 == 0b101, "a slave that is booted"
    assert master.number(0x1017) == 100
    assert master.number(0x1005) == 0x4000_0080, "it produces the SYNC that TPDO 2 comes with"
    assert master.number(0x1006) == 10_000


def test_the_stimulator_takes_each_write_that_dcfgen_has_made(configured: Path) -> None:
    """Disable, number 0, entries, number, enable: nothing is written to a mapping in force."""
    data = (configured / "stimulator.bin").read_bytes()
    (count,) = struct.unpack_from("<L", data)
    device = Device(stimulator_od(NODE_ID))
    device.start()
    at, mapped = 4, []
    for _ in range(count):
        index, subindex, size = struct.unpack_from("<HBL", data, at)
        value = data[at + 7 : at + 7 + size]
        at += 7 + size
        command = 0x23 | (4 - size) << 2
        request = struct.pack("<BHB", command, index, subindex) + value.ljust(4, b"\0")
        sent = device.receive(Frame(0x600 + NODE_ID, request))
        (answer,) = [frame for frame in sent if frame.can_id == 0x580 + NODE_ID]
        assert answer.data[0] == 0x60, f"{index:04X}h:{subindex:02X} {value.hex()}"
        mapped += [subindex] if index == 0x1A01 else []
    assert at == len(data)
    assert mapped == [0, 1, 2, 3, 4, 0]
    assert device.od.number(0x1801, 1) == 0x280 + NODE_ID
    device.receive(Frame(0, bytes((1, NODE_ID))))
    for _ in range(3):
        assert [frame.can_id for frame in device.receive(Frame(0x80))] == [0x280 + NODE_ID]
    assert device.od.number(0x1016, 1) == 0x0001_03E8
