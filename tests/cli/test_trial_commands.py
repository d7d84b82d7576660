"""Commands that break things on purpose: results, files and exit codes."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from commands import refusal, run, succeed
from nodes_on_a_bus import GUARD_S, until

from smarttac_can.host.log_file import read_candump
from smarttac_can.trials.fault_matrix import FaultRow
from smarttac_can.trials.sensor_sweep import Cell, parse_cell
from smarttac_can.trials.soak import ProcessSize

ONE = ("faults", "--fault", "measurements lost", "--mode", "friction", "--hold", "20")


def test_faults_shows_a_line_for_each_row() -> None:
    (line,) = succeed(*ONE).splitlines()
    assert line.startswith("ok     measurements lost")
    assert "friction" in line and "0 V after" in line


def test_rows_as_json_have_the_agreed_keys() -> None:
    (row,) = json.loads(succeed(*ONE, "--json", "-"))
    assert {
        "fault",
        "mode",
        "voltage_before_v",
        "detection_bound_cycles",
        "cycles_to_zero",
        "emcy_code",
        "state_after",
        "held",
        "recovered",
    } <= set(row)
    assert row["voltage_before_v"] > 0
    assert row["cycles_to_zero"] <= row["detection_bound_cycles"] + 1


def test_json_and_log_go_to_files(tmp_path: Path) -> None:
    table, log = tmp_path / "faults.json", tmp_path / "faults.log"
    succeed(*ONE, "--json", table, "--log", log)
    (row,) = json.loads(table.read_text())
    times = [time for time, _ in read_candump(log)]
    assert times == sorted(times)
    assert times[0] < row["injected_at_s"] * 1e6 <= times[-1]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Log and rows of one fault."""
    folder = tmp_path_factory.mktemp("faults")
    log, rows = folder / "faults.log", folder / "faults.json"
    succeed(*ONE[:-1], "200", "--json", rows, "--log", log)
    return log, rows


def test_rows_of_a_short_hold_say_so(tmp_path: Path) -> None:
    log, rows = tmp_path / "log", tmp_path / "rows"
    succeed(*ONE, "--json", rows, "--log", log)
    assert refusal("faults", "--verify", log, rows) == (
        "row 1 (measurements lost, friction): was held for 20 cycles, of which the log shows "
        "nothing: only one made with --hold 200 or more can be verified"
    )


def test_log_confirms_its_rows(kept: tuple[Path, Path]) -> None:
    assert succeed("faults", "--verify", *kept) == (
        "rows: 1, fields as the log shows them: 7, fields it does not show: 0\n"
    )


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('"cycles_to_zero": 3', '"cycles_to_zero": 2', "cycles_to_zero is 2 in the row, 3 in the"),
        ('"held": true', '"held": false', "held is false in the row, true in the log"),
        ('"recovered": true', '"recovered": false', "recovered is false in the row, true in the"),
        ('"8251h"', '"8252h"', 'emcy_codes is ["8250h", "8252h", "8253h"] in the row'),
        ('"detection_bound_cycles": 3', '"detection_bound_cycles": 1', "in the log are 3"),
    ],
)
def test_falsified_row_is_one_line(
    old: str, new: str, complaint: str, kept: tuple[Path, Path], tmp_path: Path
) -> None:
    log, rows = kept
    falsified = tmp_path / "rows"
    text = rows.read_text()
    assert old in text
    falsified.write_text(text.replace(old, new))
    line = refusal("faults", "--verify", log, falsified)
    assert line.startswith("row 1 (measurements lost, friction): ")
    assert complaint in line


def test_log_and_rows_exchanged_are_told_apart(kept: tuple[Path, Path]) -> None:
    log, rows = kept
    line = refusal("faults", "--verify", rows, log)
    assert line.startswith(f"{log}: is no --json file (")
    assert line.endswith("); --verify takes LOG ROWS")


@pytest.mark.parametrize(
    ("rows", "complaint"),
    [
        ("", "Expecting value"),
        ("{}", "there is no list of rows"),
        ("[" * 100_000, "recursion"),
        ('[{"fault": "measurements lost"}]', "row 1: mode null is none of"),
    ],
)
def test_rows_that_are_none_are_one_line(
    rows: str, complaint: str, kept: tuple[Path, Path], tmp_path: Path
) -> None:
    path = tmp_path / "rows"
    path.write_text(rows)
    assert complaint in refusal("faults", "--verify", kept[0], path)


@pytest.mark.parametrize(
    ("falsify", "complaint"),
    [
        (lambda text: "", "the log ends before its recovery"),
        (lambda text: text[:-5], "is cut: no line of a candump log"),
        (lambda text: f"hello\n{text}", "line 1: 'hello' is no line of a candump log"),
        (lambda text: f"(nan) can0 080#\n{text}", "line 1: '(nan) can0 080#' is no line of a"),
        (lambda text: "0" * 100_000, "is too long: no line of a candump log"),
        (lambda text: text.replace(" 4A1#", " 4A2#"), "the log does not show the stage"),
        (lambda text: text.replace(" 080#", " 081#"), "the log has no SYNC before the fault"),
    ],
)
def test_falsified_log_is_one_line(
    falsify: Callable[[str], str], complaint: str, kept: tuple[Path, Path], tmp_path: Path
) -> None:
    log, rows = kept
    path = tmp_path / "log"
    path.write_text(falsify(log.read_text()))
    assert complaint in refusal("faults", "--verify", path, rows)


def test_only_files_are_verified(kept: tuple[Path, Path], tmp_path: Path) -> None:
    log, rows = kept
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for files in ((pipe, rows), (log, pipe)):
        assert refusal("faults", "--verify", *files) == f"{pipe}: is no regular file"
    assert refusal("faults", "--verify", "nowhere", rows) == "nowhere: there is no such file"


def test_two_processes_give_the_same_rows_and_the_same_log(tmp_path: Path) -> None:
    chosen = ("--fault", "measurements corrupt", "--fault", "NMT stop", "--mode", "amplitude")
    for jobs in ("1", "2"):
        files = ("--json", str(tmp_path / f"{jobs}.json"), "--log", str(tmp_path / f"{jobs}.log"))
        command = [sys.executable, "-m", "smarttac_can", "faults", *chosen, *files]
        command += ["--hold", "20", "--jobs", jobs]
        # A process of its own: that of multiprocessing which tracks resources outlives the pool.
        subprocess.run(command, check=True, capture_output=True)
    assert (tmp_path / "1.json").read_bytes() == (tmp_path / "2.json").read_bytes()
    assert (tmp_path / "1.log").read_bytes() == (tmp_path / "2.log").read_bytes()
    assert len(json.loads((tmp_path / "1.json").read_text())) == 2
    times = [time for time, _ in read_candump(tmp_path / "1.log")]
    assert times == sorted(times)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("faults", "--fault", "rust"), "there is no fault 'rust': 'NMT pre-operational', '"),
        (("faults", "--fault", "s3 stuck"), "no fault 's3 stuck': perhaps 'S3 stuck' or '"),
        (("faults", "--json", "-", "--log", "-"), "'--log': '-' is no file"),
        (("faults", "--mode", "off"), "'off' is not one of"),
        (
            ("faults", "--fault", "resonance out of reach", "--mode", "open_loop"),
            "fault 'resonance out of reach' is not injected in mode open_loop",
        ),
        (
            ("faults", "--jobs", "2", "--channel", "vcan0"),
            "--jobs 2: with --channel there is one process",
        ),
        (
            ("faults", "--verify", "log", "rows", "--hold", "5"),
            "--hold has no meaning with --verify",
        ),
        (("faults", "--verify", "log"), "Option '--verify' requires 2 arguments"),
        (("soak",), "Missing option '--hours'"),
        (("soak", "--hours", "1", "--jobs", "0"), "0 is not in the range"),
        (("soak", "--hours", "0"), "0.0 is not in the range"),
        (("soak", "--hours", "nan"), "nan is not a finite number"),
        (("soak", "--hours", "inf"), "inf is not a finite number"),
    ],
)
def test_wrong_options_are_refused(arguments: tuple[str, ...], complaint: str) -> None:
    assert complaint in refusal(*arguments, code=2)


@pytest.mark.parametrize(
    "arguments",
    [
        (*ONE, "--json", "nowhere/result"),
        (*ONE, "--log", "nowhere/result"),
        ("soak", "--hours", "1000", "--json", "nowhere/result"),
    ],
)
def test_file_that_cannot_be_written_is_refused_before_the_run(arguments: tuple[str, ...]) -> None:
    assert refusal(*arguments).endswith("nowhere/result: the folder nowhere does not exist")


def test_old_files_stay_when_a_run_fails(tmp_path: Path) -> None:
    table, log = tmp_path / "faults.json", tmp_path / "faults.log"
    table.write_text("old")
    refusal(*ONE, "--channel", "vcan9", "--json", table, "--log", log)
    assert table.read_text() == "old"
    assert list(tmp_path.iterdir()) == [table]


@pytest.mark.parametrize(
    "command",
    [
        ("soak", "--hours", "3", "--jobs", "1"),
        ("faults", "--jobs", "1", "--log", "faults.log"),
        ("reproduce",),
    ],
    ids=lambda command: command[0],
)
def test_a_signal_leaves_nothing_half_written(command: tuple[str, ...], tmp_path: Path) -> None:
    part = tmp_path / "results.json.part"
    with subprocess.Popen(
        [sys.executable, "-m", "smarttac_can", *command, "--json", "results.json"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as begun:
        until(lambda: part.exists() or begun.poll() is not None)
        assert begun.poll() is None
        begun.terminate()
        _, complaints = begun.communicate(timeout=GUARD_S)
    assert (begun.returncode, complaints.split()) == (1, ["Aborted!"])
    assert not list(tmp_path.iterdir())


def test_no_import_that_swallows_an_interrupt_is_left_for_a_run() -> None:
    look = "import smarttac_can.cli.trials, sys; print('numpy.random' in sys.modules)"
    said = subprocess.run([sys.executable, "-c", look], stdout=subprocess.PIPE, check=True).stdout
    assert said == b"True\n"


def test_results_may_go_to_a_device() -> None:
    succeed(*ONE, "--json", "/dev/null")
    assert not Path("/dev/null").is_file()


def test_channel_that_is_not_there_is_one_clear_line() -> None:
    line = refusal(*ONE, "--channel", "vcan9")
    assert line.startswith("cannot open the socketcan bus, channel vcan9: [Errno ")


@pytest.mark.parametrize(
    ("number", "cure"),
    [
        (errno.EAFNOSUPPORT, "no SocketCAN; udp_multicast needs none, and tools/with-vcan has its"),
        (errno.ENODEV, "there is no such interface; ip link lists those there are"),
    ],
)
def test_channel_that_is_not_there_has_its_cure_as_elsewhere(
    number: int, cure: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_arguments: object) -> None:
        raise OSError(number, "no")

    monkeypatch.setattr("smarttac_can.trials.fault_matrix.socket.socket", refuse)
    assert cure in refusal(*ONE, "--channel", "vcan9")


def test_channel_of_a_python_without_socketcan(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("socket.CAN_RAW", raising=False)
    assert "this kernel has no SocketCAN" in refusal(*ONE, "--channel", "vcan9")


def test_row_that_fails_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FaultRow, "passed", property(lambda row: False))
    result = run(*ONE)
    assert result.exit_code == 1
    assert result.stdout.startswith("FAILED measurements lost")
    assert "1 of 1 faults did not end as they must" in result.stderr


def test_soak_reports_and_repeats(tmp_path: Path) -> None:
    report = tmp_path / "soak.json"
    said = succeed("soak", "--hours", "0.001", "--seed", "5", "--json", report)
    first = json.loads(report.read_text())
    assert first["seed"] == 5 and first["passed"] is True
    assert first["simulated_s"] >= 3.6
    assert f"fingerprint {first['fingerprint']}, 0 violated" in said
    assert first["margins"]["sync_lost"] == dict.fromkeys(first["margins"]["voltage"], 0.333)
    (line,) = [line for line in said.splitlines() if line.startswith("sync lost ")]
    assert set(line.split()) == {"sync", "lost", "0.33"}
    again = json.loads(succeed("soak", "--hours", "0.001", "--seed", "5", "--json", "-"))
    assert again["fingerprint"] == first["fingerprint"]


def test_soak_with_a_violation_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ProcessSize, "complaint", lambda _: "something")
    result = run("soak", "--hours", "0.0001")
    assert result.exit_code == 1
    assert "something" in result.stdout
    assert "1 violated invariants" in result.stderr


# Cells and healthy runs of ``fmeda``.


SOUND = "failure=d:gain:1,mode=AMPLITUDE,identified=sound,cycles=50"


def test_a_cell_of_the_results_runs_alone_to_the_same(tmp_path: Path) -> None:
    file = tmp_path / "results.json"
    succeed("fmeda", "--jobs", "1", "--random", "12", "--seed", "3", "--json", file)
    whole = json.loads(file.read_text())
    assert (whole["cells"], len(whole["results"])) == (12, 12)
    for one in whole["results"][:4]:
        alone = json.loads(succeed("fmeda", "--jobs", "1", "--cell", one["cell"], "--json", "-"))
        assert alone["results"] == [one]


def test_processes_come_to_the_same_as_one(tmp_path: Path) -> None:
    file = tmp_path / "shared"
    command = (sys.executable, "-m", "smarttac_can", "fmeda", "--random", "16", "--seed", "4")
    # In a process of its own: the tracker of shared resources outlives the pool in this one.
    subprocess.run((*command, "--jobs", "2", "--json", str(file)), check=False, timeout=GUARD_S)
    alone = succeed("fmeda", "--jobs", "1", "--random", "16", "--seed", "4", "--json", "-")
    assert json.loads(file.read_text()) == json.loads(alone)


def test_the_old_name_of_jobs_is_taken_and_deprecated() -> None:
    result = run("fmeda", "--cell", SOUND, "--workers", "1")
    assert result.exit_code == 0
    assert result.stderr.startswith("--workers is deprecated: use --jobs\n")
    assert "--workers" not in succeed("fmeda", "--help")


@pytest.mark.parametrize(("more", "asked"), [((), (7, False)), (("--fine",), (7, True))])
def test_the_seed_draws_the_grid_as_well(
    more: tuple[str, ...], asked: tuple[int, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    grids: list[tuple[int, bool]] = []

    def grid(seed: int, *, fine: bool = False) -> list[Cell]:
        grids.append((seed, fine))
        return [parse_cell(SOUND)]

    monkeypatch.setattr("smarttac_can.cli.trials.grid_cells", grid)
    assert "1 cells, 0 violations" in succeed("fmeda", "--jobs", "1", "--seed", "7", *more)
    assert grids == [asked]


def test_a_cell_within_the_promise_is_shown() -> None:
    assert "1 cells, 0 violations" in succeed("fmeda", "--jobs", "1", "--cell", SOUND)


def test_a_false_trip_before_the_failure_is_a_violation() -> None:
    # A limit of the force that the finger passes before the sensor fails.
    result = run(
        "fmeda",
        "--jobs",
        "1",
        "--cell",
        "failure=S3:offset:5000,mode=AMPLITUDE,motion=holding,force=9",
    )
    assert result.exit_code == 1
    assert "a false trip" in result.stdout
    assert "1 cells break the promise" in result.output


def test_healthy_runs_are_counted() -> None:
    said = run("fmeda", "--jobs", "1", "--healthy", "2", "--seed", "1", "--json", "-").stdout
    whole = json.loads(said[: said.rindex("}") + 1])
    assert whole["runs"] == 2
    assert whole["cycles"] > 500


@pytest.mark.parametrize(
    "arguments",
    [
        ("--cell", "failure=d:gone:1"),
        ("--cell", "mode=SIDEWAYS"),
        ("--random", "3", "--healthy", "3"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments: tuple[str, ...]) -> None:
    refusal("fmeda", *arguments, code=2)
