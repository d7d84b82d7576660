"""``smarttac replay``: a log in any format, its first difference, and what is no such log."""

import gc
import json
import tracemalloc
from pathlib import Path

import can
import pytest
from click.testing import CliRunner, Result

from smarttac_can.bench import Stimulator
from smarttac_can.cli import main
from smarttac_can.device.frame import Frame
from smarttac_can.host.files import packaged_eds
from smarttac_can.host.frame_log import FrameLog
from smarttac_can.host.log_file import CandumpWriter
from smarttac_can.host.python_can import to_message

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


def replay(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["replay", *map(str, arguments)])


def one_line(result: Result) -> str:
    assert result.exit_code in (1, 2), result.output
    assert isinstance(result.exception, SystemExit)
    [line] = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    return line


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".csv", ".trc"])
def test_every_format_is_replayed(run: Log, tmp_path: Path, suffix: str) -> None:
    log = write(run, tmp_path / f"run{suffix}")
    result = replay(log, "--lockstep", "--json", tmp_path / "found.json")
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "found.json").read_text())
    assert found["same"] is True
    assert found["difference"] is None
    assert (found["log"], found["frames"]) == (str(log), len(run))
    # All but that of the end, which no frame explains.
    assert found["drives"] == sum(frame.can_id == DRIVE for _, frame in run) - 1 > 90
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
    assert one_line(result) == (
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
    line = one_line(replay(write(log, tmp_path / "run.log"), "--lockstep"))
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
    line = one_line(replay(log, *given, "--plate-node", "44"))
    assert hint in line
    assert "--plate-node" not in line


def test_another_eds_is_another_stimulator(run: Log, tmp_path: Path) -> None:
    log = write(run, tmp_path / "run.log")
    text = packaged_eds("stimulator.eds").read_text()
    eds = tmp_path / "other.eds"
    eds.write_text(text.replace("DefaultValue=0x21100220", "DefaultValue=0x21100110", 1))
    assert replay(log, "--lockstep", "--eds", packaged_eds("stimulator.eds")).exit_code == 0
    assert "drive, TPDO 5 (221h)" in one_line(replay(log, "--lockstep", "--eds", eds))
    line = one_line(replay(log, "--lockstep", "--eds", packaged_eds("plate.eds")))
    assert "plate.eds does not suit the device" in line


def test_what_is_no_log_is_refused_in_one_line(run: Log, tmp_path: Path) -> None:
    for suffix in (".log", ".asc", ".blf", ".csv", ".trc"):
        rubbish = tmp_path / f"rubbish{suffix}"
        rubbish.write_bytes(b"\x00\xff rubbish\n" * 100)
        one_line(replay(rubbish))
        empty = tmp_path / f"empty{suffix}"
        empty.touch()
        one_line(replay(empty))
        long = tmp_path / f"long{suffix}"
        long.write_bytes(b"1" * 3_000_000)
        one_line(replay(long))
    unknown = tmp_path / "run.txt"
    unknown.touch()
    assert "run.txt is none of .log, .asc, .csv, .trc, .blf" in one_line(replay(unknown))
    assert "does not exist" in one_line(replay(tmp_path / "none.log"))
    assert "is a directory" in one_line(replay(tmp_path))


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


def test_damage_in_the_middle_is_told_with_its_place(run: Log, tmp_path: Path) -> None:
    torn = write(run, tmp_path / "torn.log")
    lines = torn.read_text().splitlines()
    torn.write_text("\n".join([*lines[:300], lines[300][:20], *lines[301:], ""]))
    assert one_line(replay(torn, "--lockstep")) == (
        f"Error: {torn}, line 301: {lines[300][:20].strip()!r} is no line of a candump log"
    )
    torn = write(run, tmp_path / "torn.blf")
    data = torn.read_bytes()
    torn.write_bytes(data[:2000] + bytes(50) + data[2050:])
    assert one_line(replay(torn, "--lockstep")).startswith(
        f"Error: {torn} is no BLF log, or damaged"
    )


def test_the_log_of_a_recording_points_to_its_raw_log(tmp_path: Path) -> None:
    path = tmp_path / "run.h5.log"
    with FrameLog(path, {}):
        pass
    assert "is the log of a recording" in one_line(replay(path))


def test_what_a_log_lacks_is_said_in_one_line(run: Log, tmp_path: Path) -> None:
    log = write(run, tmp_path / "run.log")
    assert "no boot-up message of node 5" in one_line(replay(log, "--node-id", "5"))
    later = write(run[500:], tmp_path / "later.log")
    assert "no boot-up message of node 32" in one_line(replay(later, "--lockstep"))
    silent = write([item for item in run if item[1].can_id != 0x80], tmp_path / "silent.log")
    assert "needs SYNC" in one_line(replay(silent, "--lockstep"))


def test_options_that_contradict_are_refused(run: Log, tmp_path: Path) -> None:
    log = write(run, tmp_path / "run.log")
    assert replay(log, "--plate-node", "32").exit_code == 2
    assert replay(log, "--lockstep", "--produce-sync").exit_code == 2
    assert replay(log, "--deadline", "0").exit_code == 2


def test_the_stored_parameters_stay_as_they_are(run: Log, tmp_path: Path) -> None:
    log = write(run, tmp_path / "run.log")
    stored = tmp_path / "node.bin"
    stored.write_bytes(b"CO-STORE, torn")
    result = replay(log, "--lockstep", "--storage", stored)
    # It says that it does not understand them, which that of the log did not.
    assert "the log lacks the EMCY (0A0h)" in one_line(result)
    assert stored.read_bytes() == b"CO-STORE, torn"


def test_a_long_log_takes_no_more_memory(tmp_path: Path) -> None:
    logs = [write(amplitude_run(seconds), tmp_path / f"{seconds}.log") for seconds in (0.1, 1.0)]
    size = []
    # What is imported and kept the first time is not the log's.
    for log in (logs[0], *logs):
        gc.collect()
        tracemalloc.start()
        assert replay(log, "--lockstep").exit_code == 0
        size.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # The log of a second has a million bytes more in it.
    assert size[2] < size[1] + 100_000


@pytest.mark.parametrize("text", ["", "\n"])
def test_an_empty_log(tmp_path: Path, text: str) -> None:
    log = tmp_path / "empty.log"
    log.write_text(text)
    assert one_line(replay(log)) == f"Error: {log}: the log is empty: there is no frame in it"
