"""A recording is made, and a log computed again: ``record`` and ``replay``."""

import gc
import json
import re
import signal
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import can
import h5py
import pytest
from commands import refusal, succeed
from commands import run as command
from nodes_on_a_bus import (
    GUARD_S,
    both,
    in_threads,
    multicast_options,
    processes,
    regulate_friction,
    until,
)

from smarttac_can.bench import Stimulator
from smarttac_can.bench.recording_file import Summary
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.cli.recording import _lines
from smarttac_can.host.files import packaged_eds
from smarttac_can.host.frame_log import RECORD, FrameLog, FrameLogReader
from smarttac_can.host.log_file import CandumpWriter, read_log
from smarttac_can.host.python_can import to_message

# ``smarttac record``: a file of others' runs, by Ctrl-C, by time, and after a kill.


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
    until(lambda: records_in(log) >= begun + more, pause=0.05)


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
    # Frames of the recorder itself, of others and of the node.
    assert {0x620, 0x5A0, 0x1A0} <= set(frames)


def test_a_recording_without_a_cycle_is_no_success(
    multicast: dict[str, Any], tmp_path: Path
) -> None:
    """Nodes in lockstep take no step while nobody runs them."""
    path = tmp_path / "run.h5"
    with processes(multicast, "node --lockstep"):
        result = command("record", path, *multicast_options(multicast), "--seconds", "0.2")
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
    result = command("record", "--recover", log, path)
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.output.startswith(f"{path}: ")
    with h5py.File(path) as file:
        ticks = file["tick"][:].tolist()
        gaps = [(gap["first_tick"], gap["last_tick"]) for gap in file["gaps"][:]]
        lost = [tick for first, last in gaps for tick in range(first, last + 1)]
        assert len(ticks) > 1000
        assert sorted([*ticks, *lost]) == list(range(ticks[0], ticks[-1] + 1))
        assert file["host_time_ns"][-1] * 1e-9 > killed - 1.0
    assert FrameLogReader(log).head["version"]
    again = refusal("record", "--recover", log, path)
    assert again == f"{path} exists: give the recording another name"


def test_a_bus_that_cannot_be_opened_is_one_line() -> None:
    """python-can says at its end that a bus was not shut down, which stands on stderr as well."""
    bus = ("--interface", "udp_multicast", "--channel", "10.0.0.1")
    ended = subprocess.run(
        [sys.executable, "-m", "smarttac_can", "scan", *bus],
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
    line = refusal("record", "--recover", log, path)
    assert line == f"{path}: the folder {path.parent} does not exist"
    path.parent.mkdir()
    succeed("record", "--recover", log, path)
    assert [entry.name for entry in path.parent.iterdir()] == ["x.h5"]


def test_refusals(tmp_path: Path) -> None:
    refused = partial(refusal, "record", code=None)
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
@pytest.mark.parametrize("suffix", ["", ".log"])
def test_one_file_twice_is_refused(tmp_path: Path, option: str, suffix: str) -> None:
    path = tmp_path / "run.h5"
    arguments = ("record", path, option, f"{path}{suffix}", "--interface", "virtual")
    line = refusal(*arguments, code=2)
    assert f"run.h5{suffix} is a file of the recording itself" in line
    assert list(tmp_path.iterdir()) == []


def test_one_is_one_and_not_many() -> None:
    few = _lines(Path("run.h5"), Summary(1, 1, 1, 1, 1, 1, 1, 1, 1, 1))
    assert few == [
        "run.h5: 1 row, 1 lost tick in 1 gap, 1 run, 1 marker, 1 change of set-points, "
        "1 texture, 1 row at a limit, 1 emergency",
        "1 record of the log was cut or damaged, and left out",
    ]
    many = _lines(Path("run.h5"), Summary(2, 0, 0, 2, 0, 2, 0, 0, 0, 0))
    assert many == [
        "run.h5: 2 rows, 0 lost ticks in 0 gaps, 2 runs, 0 markers, 2 changes of set-points, "
        "0 textures, 0 rows at a limit, 0 emergencies"
    ]


# ``smarttac replay``: a log in any format, its first difference, and other files.


Log = list[tuple[int, Frame]]
DRIVE = 0x221
LINE = (
    "{log}: {frames} frames up to {seconds:.3f} s, from the boot-up at 0.000 s on; {drives} drives"
    " and {others} other frames of the node recomputed and the same"
)


def amplitude_run(seconds: float) -> Log:
    log: Log = []
    with Stimulator.simulate(log=lambda *frame: log.append(frame)) as bench:
        bench.start_run()
        bench.amplitude = 1.0
        bench.mode = "amplitude"
        bench.run(seconds)
    return log


@pytest.fixture(scope="module")
def run() -> Log:
    return amplitude_run(0.1)


def write(log: Log, path: Path) -> Path:
    if path.suffix == ".log":
        with path.open("w") as file:
            for time, frame in log:
                CandumpWriter(file).write(time, frame)
        return path
    with can.Logger(path) as logger:
        for time, frame in log:
            message = to_message(frame)
            message.timestamp = 1e9 + time * 1e-6
            logger(message)
    return path


replay = partial(command, "replay")
no_replay = partial(refusal, "replay")
not_judged = partial(refusal, "replay", code=3)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".trc"])
def test_every_format_is_replayed(run: Log, tmp_path: Path, suffix: str) -> None:
    log = write(run, tmp_path / f"run{suffix}")
    result = replay(log, "--lockstep", "--json", tmp_path / "found.json")
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["same"] is True
    assert found["difference"] is None
    assert (found["log"], found["frames"]) == (str(log), len(run))
    assert found["drives"] == sum(frame.can_id == DRIVE for _, frame in run) > 90
    assert (found["unjudged"], found["unjudged_share"]) == ([], 0.0)
    assert result.stdout.strip() == LINE.format(
        log=log,
        frames=len(run),
        seconds=found["ended_s"],
        drives=found["drives"],
        others=found["compared"] - found["drives"],
    )


def test_the_first_difference_is_named(run: Log, tmp_path: Path) -> None:
    place = [p for p, (_, frame) in enumerate(run) if frame.can_id == DRIVE][80]
    time, frame = run[place]
    other = Frame(DRIVE, frame.data[:2] + bytes((frame.data[2] ^ 1,)) + frame.data[3:])
    log = write([*run[:place], (time, other), *run[place + 1 :]], tmp_path / "run.log")
    result = replay(log, "--lockstep", "--json", tmp_path / "found.json")
    found = json.loads((tmp_path / "found.json").read_text())
    there, here = (int.from_bytes(f.data[2:6], "little") / 100 for f in (other, frame))
    seconds = (time - run[0][0]) * 1e-6
    assert result.exit_code == 1
    assert result.stderr.splitlines()[-1] == (
        f"Error: {log}: frame {place + 1} at {seconds:.6f} s, drive, TPDO 5 (221h): "
        f"Drive.Frequency is {there:.12g} Hz in the log, {here:.12g} Hz recomputed; so early, it "
        "may have been started with an option that is not given: --produce-sync, --plate-node, "
        "--deadline, --eds, --storage"
    )
    assert found["same"] is False
    assert found["drives"] == 80
    assert found["difference"] == {
        "frame": place + 1,
        "time_s": pytest.approx(seconds),
        "what": "drive, TPDO 5",
        "can_id": DRIVE,
        "recorded": other.data.hex(),
        "recomputed": frame.data.hex(),
        "objects": [
            {
                "name": "Drive.Frequency",
                "recorded": f"{there:.12g} Hz",
                "recomputed": f"{here:.12g} Hz",
            }
        ],
    }


def test_options_are_no_cause_of_a_late_difference(tmp_path: Path) -> None:
    log = amplitude_run(1.2)
    place = [p for p, (_, frame) in enumerate(log) if frame.can_id == DRIVE][-2]
    time, frame = log[place]
    log[place] = time, Frame(DRIVE, bytes((frame.data[0] ^ 1,)) + frame.data[1:])
    line = no_replay(write(log, tmp_path / "run.log"), "--lockstep")
    assert "Drive.Voltage is " in line
    assert line.endswith(" mV recomputed")


@pytest.mark.parametrize(
    ("given", "hint"),
    [((), "--lockstep, --produce-sync, "), (("--lockstep",), ": --produce-sync, ")],
)
def test_options_that_are_not_given_are_named(
    run: Log, tmp_path: Path, given: tuple[str, ...], hint: str
) -> None:
    log = write(run, tmp_path / "run.log")
    line = no_replay(log, *given, "--plate-node", "44")
    assert hint in line
    assert "--plate-node" not in line


def test_another_eds_is_another_stimulator(run: Log, tmp_path: Path) -> None:
    log = write(run, tmp_path / "run.log")
    text = packaged_eds("stimulator.eds").read_text()
    eds = tmp_path / "other.eds"
    eds.write_text(text.replace("DefaultValue=0x21100220", "DefaultValue=0x21100110", 1))
    assert replay(log, "--lockstep", "--eds", packaged_eds("stimulator.eds")).exit_code == 0
    assert "drive, TPDO 5 (221h)" in no_replay(log, "--lockstep", "--eds", eds)
    line = no_replay(log, "--lockstep", "--eds", packaged_eds("plate.eds"))
    assert "plate.eds does not suit the device" in line


def test_replay_refuses_other_files_in_one_line(run: Log, tmp_path: Path) -> None:
    for suffix in (".log", ".asc", ".blf", ".csv", ".trc"):
        rubbish = tmp_path / f"rubbish{suffix}"
        rubbish.write_bytes(b"\x00\xff rubbish\n" * 100)
        not_judged(rubbish)
        empty = tmp_path / f"empty{suffix}"
        empty.touch()
        not_judged(empty)
        long = tmp_path / f"long{suffix}"
        long.write_bytes(b"1" * 3_000_000)
        not_judged(long)
    unknown = tmp_path / "run.txt"
    unknown.touch()
    assert "run.txt: the log is empty" in not_judged(unknown)
    assert "does not exist" in no_replay(tmp_path / "none.log", code=2)
    assert "is a directory" in no_replay(tmp_path, code=2)


@pytest.mark.parametrize("suffix", [".log", ".asc", ".csv", ".trc"])
def test_a_log_whose_logger_was_killed_is_replayed_up_to_there(
    run: Log, tmp_path: Path, suffix: str
) -> None:
    torn = write(run, tmp_path / f"torn{suffix}")
    text = torn.read_text()
    lines = text[: len(text) // 2].splitlines()
    torn.write_text("\n".join(lines)[:-1])
    result = replay(torn, "--lockstep")
    assert result.exit_code == 0, result.output
    assert result.stderr == f"{torn}: the last line, {len(lines)}, is cut and left out\n"


@pytest.mark.parametrize("left", [-1, -500, 150])
def test_a_binary_log_that_is_cut_is_replayed_up_to_there(
    run: Log, tmp_path: Path, left: int
) -> None:
    torn = write(run, tmp_path / "torn.blf")
    data = torn.read_bytes()
    assert replay(torn, "--lockstep").stderr == ""
    torn.write_bytes(data[:left])
    result = replay(torn, "--lockstep")
    line = (
        f"{torn}: cut after {len(data[:left])} of {len(data)} bytes, "
        "and its last frames may be missing"
    )
    assert line in result.stderr.splitlines()
    assert result.exit_code == (0 if left < 0 else 3), "150 bytes hold no frame"
    with pytest.raises(ValueError, match=f"^{re.escape(line)}$"):
        list(read_log(torn))


def test_replay_reads_a_binary_log_of_a_killed_logger(run: Log, tmp_path: Path) -> None:
    """python-can states the size when it ends a log; until then it is that of the header."""
    log = write(run, tmp_path / "run.blf")
    data = bytearray(log.read_bytes())
    data[16:24] = (144).to_bytes(8, "little")
    log.write_bytes(data)
    result = replay(log, "--lockstep")
    assert result.exit_code == 0, result.output
    line = f"{log}: its logger has not ended it, and its last frames may be missing\n"
    assert result.stderr == line


def test_damage_in_the_middle_of_a_binary_log_is_told(run: Log, tmp_path: Path) -> None:
    torn = write(run, tmp_path / "torn.blf")
    data = torn.read_bytes()
    torn.write_bytes(data[:2000] + bytes(50) + data[2050:])
    assert not_judged(torn, "--lockstep").startswith(f"{torn} is no BLF log, or damaged")


def test_the_log_of_a_recording_points_to_its_raw_log(tmp_path: Path) -> None:
    path = tmp_path / "run.h5.log"
    with FrameLog(path, {}):
        pass
    assert "is the log of a recording" in not_judged(path)


def test_options_that_contradict_are_refused(run: Log, tmp_path: Path) -> None:
    log = write(run, tmp_path / "run.log")
    for options in (("--lockstep", "--produce-sync"), ("--deadline", "0")):
        refusal("replay", log, *options, code=2)


def test_the_stored_parameters_stay_as_they_are(run: Log, tmp_path: Path) -> None:
    log = write(run, tmp_path / "run.log")
    stored = tmp_path / "node.bin"
    stored.write_bytes(b"CO-STORE, torn")
    # It says that it does not understand them, which that of the log did not.
    line = no_replay(log, "--lockstep", "--storage", stored)
    assert "the log lacks the EMCY (0A0h)" in line
    assert stored.read_bytes() == b"CO-STORE, torn"


def test_a_long_log_takes_no_more_memory(tmp_path: Path) -> None:
    logs = [write(amplitude_run(seconds), tmp_path / f"{seconds}.log") for seconds in (0.1, 0.4)]
    size = []
    # Modules imported the first time are not the log's.
    for log in (logs[0], *logs):
        gc.collect()
        tracemalloc.start()
        assert replay(log, "--lockstep").exit_code == 0
        size.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # The longer log has 300 000 bytes more in it.
    assert size[2] < size[1] + 50_000


@pytest.mark.parametrize("text", ["", "\n"])
def test_an_empty_log(tmp_path: Path, text: str) -> None:
    log = tmp_path / "empty.log"
    log.write_text(text)
    assert not_judged(log) == f"{log}: the log is empty: there is no frame in it"


# ``smarttac record --raw`` beside a script, and ``smarttac replay`` of its log.


BOOT_UPS = {0x720, 0x721}
SDO_TO = 0x620


def reset_all(bus: Mapping[str, Any]) -> None:
    """Reset both nodes, and wait until they have."""
    with can.Bus(**bus) as handle:
        handle.send(can.Message(arbitration_id=0, data=[129, 0], is_extended_id=False))
        seen: set[int] = set()
        guard = time.monotonic() + GUARD_S
        while not seen >= BOOT_UPS:
            assert time.monotonic() < guard, "they do not boot"
            message = handle.recv(0.1)
            if message is not None and message.data == b"\0":
                seen.add(message.arbitration_id)


def at_rest(bench: Stimulator) -> None:
    """Ask much, and drive nothing: a system that is busy trips over no deadline then."""
    for voltage in (10, 20, 30):
        bench.voltage = voltage
        bench.run(0.1)
        assert bench.get("Setpoint.Voltage", "V") == voltage


TRIES = 4
EXCUSED = r"SDO answer \(5A0h\)|lacks the TPDO [1-4] |makes the node send this EMCY|the log lacks "
"""What a request that crossed another one leaves: its answer, or a TPDO whose type it has set. And
what a process leaves that was held up: a deadline that it has missed, and no log has, or frames
that the log has lost."""


def replayed(log: Path, *options: str) -> dict[str, Any]:
    """Replay a log that begins before the boot-up; that this is not judged is said."""
    path = log.with_suffix(".json")
    line = not_judged(log, *options, "--json", path)
    found = dict(json.loads(path.read_text()))
    assert found["same"] is False
    assert found["difference"] is None
    before, *found["others"] = found["unjudged"]
    assert before["why"] == "before the boot-up message of node 32"
    assert (before["begun_s"], before["ended_s"]) == (0.0, found["begun_s"])
    assert f"could not be judged: 0.000 s to {before['ended_s']:.3f} s, before the boot" in line
    share = sum(part["ended_s"] - part["begun_s"] for part in found["unjudged"])
    assert found["unjudged_share"] == pytest.approx(share / found["ended_s"])
    return found


def frames(log: Path, can_id: int) -> list[Frame]:
    """Frames with an identifier behind the boot-up, where a replay begins."""
    heard = [frame for _, frame in read_log(log)]
    behind = heard[heard.index(Frame(0x720, b"\0")) :]
    return [frame for frame in behind if frame.can_id == can_id]


def patient_eds(path: Path) -> Path:
    """EDS of a stimulator that waits as long as it may before it misses a measurement."""
    text = packaged_eds("stimulator.eds").read_text()
    limits = "LowLimit=1\nHighLimit=100\nDefaultValue="
    assert text.count(f"{limits}20") == len(("RPDO 5", "RPDO 6", "RPDO 7"))
    path.write_text(text.replace(f"{limits}20", f"{limits}100"))
    return path


def test_replay_recomputes_a_recording_in_real_time(
    multicast: dict[str, Any], tmp_path: Path
) -> None:
    told = ("--produce-sync", "--eds", str(patient_eds(tmp_path / "patient.eds")))
    # Requests of script and recorder may cross on multicast: their order in the log is then not
    # that in which the node heard them, which a bus with one order for all cannot do.
    for attempt in range(TRIES):
        raw = tmp_path / f"run{attempt}.log"
        record_process(multicast, raw, told)
        result = replay(raw, *told)
        if result.exit_code != 1 or not re.search(EXCUSED, result.output):
            break
    found = replayed(raw, *told)
    # A process that was held up for long may have left a part that is not judged.
    assert 200 < found["drives"] <= len(frames(raw, DRIVE))
    assert found["others"] or found["drives"] == len(frames(raw, DRIVE))
    # Of the script, and of the recorder, which sets the types of the TPDOs again.
    assert len(frames(raw, SDO_TO)) > 50


def record_process(multicast: dict[str, Any], raw: Path, told: tuple[str, ...]) -> None:
    """Have a process record a script with both nodes, at rest."""
    rows = raw.with_suffix(".h5")
    command = [sys.executable, "-W", "error", "-m", "smarttac_can", "record", "--plate-node", "33"]
    command += ["--raw", str(raw), "--timeout", "5", *multicast_options(multicast)]
    with processes(multicast, "plate", " ".join(("node --plate-node 33", *told))):
        with subprocess.Popen([*command, str(rows)], stderr=subprocess.PIPE, text=True) as recorder:
            try:
                assert recorder.stderr is not None
                assert recorder.stderr.readline() == f"recording {rows}\n"
                reset_all(multicast)
                with Stimulator.connect(**multicast, plate_node_id=33, timeout=5.0) as bench:
                    at_rest(bench)
                recorder.send_signal(signal.SIGINT)
                recorder.communicate(timeout=GUARD_S)
            finally:
                recorder.kill()
        assert recorder.returncode == 0


def test_replay_recomputes_a_recording_in_lockstep(virtual: dict[str, Any], tmp_path: Path) -> None:
    raw = tmp_path / "run.log"
    options = {**virtual, "plate_node_id": 33, "lockstep": True, "timeout": 5.0}
    with in_threads(virtual, *both()):
        with (
            Stimulator.connect(**options) as recorder,
            recorder.record(tmp_path / "run.h5", raw=raw) as recording,
        ):
            reset_all(virtual)
            with Stimulator.connect(**options) as bench:
                bench.start_run()
                regulate_friction(bench)
            # The recorder's own requests come in between.
            assert recorder.get("Mode") == 0
            recorder.voltage = 5
        assert recording.raw_note == ""
    found = replayed(raw, "--lockstep")
    assert found["others"] == []
    assert found["drives"] == len(frames(raw, DRIVE)) > 400
