"""``smarttac record``: a file of what others do, by Ctrl-C, by time, and after a kill."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import h5py
import pytest
from click.testing import CliRunner
from nodes_on_a_bus import GUARD_S, multicast_options, processes

from smarttac_can.bench import Stimulator
from smarttac_can.bench.recording_file import Summary
from smarttac_can.cli import main
from smarttac_can.cli.recording import _lines
from smarttac_can.host.frame_log import RECORD, FrameLogReader


@contextmanager
def recorder(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-W", "error", "-m", "smarttac_can", "record", *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def node(multicast: dict[str, Any]) -> Iterator[None]:
    with processes(multicast, "node"):
        yield


def records_in(log: Path) -> int:
    return log.stat().st_size // RECORD.itemsize if log.exists() else 0


def wait_for_records(log: Path, more: int) -> None:
    begun = records_in(log)
    guard = time.monotonic() + GUARD_S
    while records_in(log) < begun + more:
        assert time.monotonic() < guard, "it does not record"
        time.sleep(0.05)


@pytest.mark.usefixtures("node")
def test_ctrl_c_ends_a_recording_with_its_file(multicast: dict[str, Any], tmp_path: Path) -> None:
    path, raw = tmp_path / "run.h5", tmp_path / "run.asc"
    log = tmp_path / "run.h5.log"
    arguments = (
        str(path),
        *multicast_options(multicast),
        "--raw",
        str(raw),
        "--json",
        "-",
        "--timeout",
        "5",
    )
    with recorder(*arguments) as process:
        # The head takes 2700 records' room.
        wait_for_records(log, 8000)
        with Stimulator.connect(**multicast, timeout=5.0) as bench:
            for voltage in (10, 20, 30):
                bench.voltage = voltage
        wait_for_records(log, 2000)
        process.send_signal(signal.SIGINT)
        said, complaints = process.communicate(timeout=GUARD_S)
    assert (process.returncode, complaints) == (0, f"recording {path}\n")
    result = json.loads(said)
    with h5py.File(path) as file:
        assert result["rows"] == len(file["tick"]) > 1000
        changes = file["set_points"][:]
        assert file["channels/status"].shape == file["tick"].shape
    assert [(row["name"], row["value"]) for row in changes] == [
        (b"Setpoint.Voltage", voltage) for voltage in (10, 20, 30)
    ]
    assert not log.exists()
    frames = [message.arbitration_id for message in can.LogReader(raw)]
    assert frames.count(0x4A0) >= result["rows"]
    # What the recorder itself sent, and what others and the node said.
    assert {0x620, 0x5A0, 0x1A0} <= set(frames)


def test_a_recording_without_a_cycle_is_no_success(
    multicast: dict[str, Any], tmp_path: Path
) -> None:
    """Nodes in lockstep take no step while nobody runs them."""
    path = tmp_path / "run.h5"
    arguments = ["record", str(path), *multicast_options(multicast), "--seconds", "0.2"]
    with processes(multicast, "node --lockstep"):
        result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 1
    assert f"{path}: 0 rows, " in result.stdout
    assert "has no row: no cycle came" in result.stderr
    with h5py.File(path) as file:
        assert len(file["tick"]) == 0


@pytest.mark.usefixtures("node")
def test_a_killed_recording_is_recovered(multicast: dict[str, Any], tmp_path: Path) -> None:
    path, log = tmp_path / "run.h5", tmp_path / "run.h5.log"
    with recorder(str(path), *multicast_options(multicast), "--timeout", "5") as process:
        wait_for_records(log, 8000)
        killed = time.time()
        process.kill()
        process.wait(GUARD_S)
    assert not path.exists()
    result = CliRunner().invoke(main, ["record", "--recover", str(log), str(path)])
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.output.startswith(f"{path}: ")
    with h5py.File(path) as file:
        assert len(file["tick"]) > 1000
        assert file["host_time_ns"][-1] * 1e-9 > killed - 1.0
    assert FrameLogReader(log).head["version"]
    again = CliRunner().invoke(main, ["record", "--recover", str(log), str(path)])
    assert (again.exit_code, again.output) == (
        1,
        f"Error: {path} exists: give the recording another name\n",
    )


@pytest.mark.parametrize("command", [("record", "x.h5"), ("scan",), ("plate",)])
def test_a_bus_that_cannot_be_opened_is_one_line(command: tuple[str, ...]) -> None:
    """python-can says at its end that a bus was not shut down, which stands on stderr as well."""
    bus = ("--interface", "udp_multicast", "--channel", "10.0.0.1")
    ended = subprocess.run(
        [sys.executable, "-m", "smarttac_can", *command, *bus],
        capture_output=True,
        text=True,
        timeout=GUARD_S,
        check=False,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (
        1,
        "",
        "Error: cannot open the udp_multicast bus, channel 10.0.0.1: could not create or configure "
        "socket; the channel has to be a group, such as 239.74.163.2\n",
    )


def test_a_recording_is_recovered_into_a_folder_that_is_there(tmp_path: Path) -> None:
    log = tmp_path / "killed.log"
    with Stimulator.simulate() as bench, bench.record(tmp_path / "run.h5") as recording:
        bench.run(0.01)
        log.write_bytes(recording.log_path.read_bytes())
    path = tmp_path / "missing" / "x.h5"
    result = CliRunner().invoke(main, ["record", "--recover", str(log), str(path)])
    assert (result.exit_code, result.output) == (
        1,
        f"Error: {path}: the folder {path.parent} does not exist\n",
    )
    path.parent.mkdir()
    assert CliRunner().invoke(main, ["record", "--recover", str(log), str(path)]).exit_code == 0
    assert [entry.name for entry in path.parent.iterdir()] == ["x.h5"]


def test_refusals(tmp_path: Path) -> None:
    def refused(*arguments: str) -> str:
        result = CliRunner().invoke(main, ["record", *arguments])
        assert result.exit_code in (1, 2)
        assert "Traceback" not in result.output
        return result.output.splitlines()[-1]

    path = str(tmp_path / "run.h5")
    bus = ("--interface", "virtual", "--channel", "nobody", "--timeout", "0.05")
    assert "no node 32 answers on virtual:nobody" in refused(path, *bus)
    assert "0 is not in the range 0.1<=x" in refused(path, *bus, "--seconds", "0")
    (tmp_path / "other").write_text("something else")
    other = str(tmp_path / "other")
    assert "is no log of a recording" in refused("--recover", other, path)
    assert "--recover needs a log and no bus" in refused("--recover", other, path, *bus[:2])
    assert "does not exist" in refused("--recover", str(tmp_path / "none"), path)
    assert not (tmp_path / "run.h5").exists()


@pytest.mark.parametrize("option", ["--json", "--raw"])
@pytest.mark.parametrize("suffix", ["", ".log", ".part"])
def test_one_file_twice_is_refused(tmp_path: Path, option: str, suffix: str) -> None:
    path = tmp_path / "run.h5"
    arguments = ["record", str(path), option, f"{path}{suffix}", "--interface", "virtual"]
    refused = CliRunner().invoke(main, arguments)
    assert refused.exit_code == 2
    assert f"run.h5{suffix} is a file of the recording itself" in refused.output
    assert list(tmp_path.iterdir()) == []


def test_one_is_one_and_not_many() -> None:
    few = _lines(Path("run.h5"), Summary(1, 1, 1, 1, 1, 1, 1, 1, 1))
    assert few == [
        "run.h5: 1 row, 1 lost tick in 1 gap, 1 run, 1 marker, 1 change of set-points, "
        "1 texture, 1 emergency",
        "1 record of the log was cut or damaged, and left out",
    ]
    many = _lines(Path("run.h5"), Summary(2, 0, 0, 2, 0, 2, 0, 0, 0))
    assert many == [
        "run.h5: 2 rows, 0 lost ticks in 0 gaps, 2 runs, 0 markers, 2 changes of set-points, "
        "0 textures, 0 emergencies"
    ]
