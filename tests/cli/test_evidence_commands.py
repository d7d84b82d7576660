"""Commands that break things on purpose: results, files and exit codes."""

from __future__ import annotations

import errno
import json
import subprocess
import sys
from pathlib import Path

import pytest
from commands import refusal, run, succeed
from nodes_on_a_bus import GUARD_S, until

from smarttac_can.assurance.trials.fault_cases import CASES
from smarttac_can.assurance.trials.fault_matrix import FaultRow
from smarttac_can.assurance.trials.sensor_sweep import Cell, parse_cell
from smarttac_can.assurance.trials.soak import ProcessSize

PROGRAM = (sys.executable, "-m", "smarttac_can.assurance")
ONE = ("faults", "--fault", "measurements lost", "--mode", "friction", "--hold", "20")


def test_a_fault_has_a_line_and_a_row(tmp_path: Path) -> None:
    table = tmp_path / "faults.json"
    (line,) = succeed(*ONE, "--json", table).splitlines()
    assert line.startswith("ok     measurements lost")
    assert "friction" in line and "0 V after" in line
    (row,) = json.loads(table.read_text())
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


def test_two_processes_give_the_same_rows(tmp_path: Path) -> None:
    chosen = ("--fault", "measurements corrupt", "--fault", "NMT stop", "--mode", "amplitude")
    for jobs in ("1", "2"):
        command = [*PROGRAM, "faults", *chosen, "--json", str(tmp_path / f"{jobs}.json")]
        command += ["--hold", "20", "--jobs", jobs]
        # A process of its own: that of multiprocessing which tracks resources outlives the pool.
        subprocess.run(command, check=True, capture_output=True)
    assert (tmp_path / "1.json").read_bytes() == (tmp_path / "2.json").read_bytes()
    assert len(json.loads((tmp_path / "1.json").read_text())) == 2


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("faults", "--fault", "rust"), "there is no fault 'rust': faults --list shows all "),
        (("faults", "--fault", "s3 stuck"), "no fault 's3 stuck', perhaps 'S3 stuck': faults --li"),
        (("faults", "--fault", "S3 stick"), "no fault 'S3 stick', perhaps 'S3 stuck' or '"),
        (
            ("faults", "--fault", "resonance out of reach", "--mode", "open_loop"),
            "fault 'resonance out of reach' is not injected in mode open_loop",
        ),
        (
            ("faults", "--jobs", "2", "--channel", "vcan0"),
            "--jobs 2: with --channel there is one process",
        ),
        (("soak", "--hours", "nan"), "nan is not a finite number"),
        (("soak", "--hours", "1e308"), "is not in the range 0.0<x<=10000.0"),
        (("sensors", "--cell", "failure=d:gone:1"), "gone"),
        (("sensors", "--cell", "mode=SIDEWAYS"), "SIDEWAYS"),
        (("sensors", "--random", "3", "--healthy", "3"), "--healthy"),
    ],
)
def test_wrong_options_are_refused(arguments: tuple[str, ...], complaint: str) -> None:
    line = refusal(*arguments, code=2)
    assert complaint in line
    assert len(line) < 200


def test_faults_are_listed_by_name_without_a_run() -> None:
    names = succeed("faults", "--list").splitlines()
    assert names == sorted({case.name for case in CASES})


def test_old_files_stay_when_a_run_fails(tmp_path: Path) -> None:
    table = tmp_path / "faults.json"
    table.write_text("old")
    file = ("--json", table, "--force")
    assert "cannot open the socketcan bus" in refusal(*ONE, "--channel", "vcan9", *file)
    assert table.read_text() == "old"
    assert list(tmp_path.iterdir()) == [table]


def test_a_signal_leaves_nothing_half_written(tmp_path: Path) -> None:
    with subprocess.Popen(
        [*PROGRAM, "faults", "--jobs", "1", "--json", "results.json"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as begun:
        until(lambda: any(tmp_path.glob("results.json.*.part")) or begun.poll() is not None)
        assert begun.poll() is None
        begun.terminate()
        _, complaints = begun.communicate(timeout=GUARD_S)
    assert (begun.returncode, complaints.split()) == (1, ["Aborted!"])
    assert not list(tmp_path.iterdir())


def test_no_import_that_swallows_an_interrupt_is_left_for_a_run() -> None:
    look = "import smarttac_can.cli.evidence, sys; print('numpy.random' in sys.modules)"
    said = subprocess.run([sys.executable, "-c", look], stdout=subprocess.PIPE, check=True).stdout
    assert said == b"True\n"


@pytest.mark.parametrize(
    ("number", "cure"),
    [
        (None, "this kernel has no SocketCAN"),
        (errno.EAFNOSUPPORT, "no SocketCAN; udp_multicast needs none, and tools/with-vcan has its"),
        (errno.ENODEV, "there is no such interface; ip link lists those there are"),
    ],
)
def test_channel_that_is_not_there_has_its_cure_as_elsewhere(
    number: int | None, cure: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_arguments: object) -> None:
        raise OSError(number, "no")

    if number is None:
        monkeypatch.delattr("socket.CAN_RAW", raising=False)
    else:
        monkeypatch.setattr("smarttac_can.assurance.trials.fault_matrix.socket.socket", refuse)
    line = refusal(*ONE, "--channel", "vcan9")
    assert line.startswith("cannot open the socketcan bus, channel vcan9: ")
    assert cure in line


def test_row_that_fails_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FaultRow, "passed", property(lambda row: False))
    result = run(*ONE)
    assert result.exit_code == 1
    assert result.stdout.startswith("FAILED measurements lost")
    assert "1 of 1 faults did not end as required" in result.stderr


def test_soak_reports(tmp_path: Path) -> None:
    report = tmp_path / "soak.json"
    said = succeed("soak", "--hours", "0.001", "--seed", "5", "--json", report)
    first = json.loads(report.read_text())
    assert first["seed"] == 5 and first["passed"] is True
    assert first["simulated_s"] >= 3.6
    assert f"fingerprint {first['fingerprint']}, 0 violated" in said
    assert first["margins"]["sync_lost"] == dict.fromkeys(first["margins"]["voltage"], 0.333)
    (line,) = [line for line in said.splitlines() if line.startswith("sync lost ")]
    assert set(line.split()) == {"sync", "lost", "0.33"}


def test_soak_with_a_violation_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ProcessSize, "complaint", lambda _: "something")
    result = run("soak", "--hours", "0.0001")
    assert result.exit_code == 1
    assert "something" in result.stdout
    assert "1 violated invariants" in result.stderr


# Cells and healthy runs of ``sensors``.


SOUND = "failure=d:gain:1,mode=AMPLITUDE,identified=sound,cycles=50"


def test_processes_come_to_the_same_as_one(tmp_path: Path) -> None:
    file = tmp_path / "shared"
    command = (*PROGRAM, "sensors", "--random", "4", "--seed", "4")
    # In a process of its own: the tracker of shared resources outlives the pool in this one.
    subprocess.run((*command, "--jobs", "2", "--json", str(file)), check=False, timeout=GUARD_S)
    alone = succeed("sensors", "--jobs", "1", "--random", "4", "--seed", "4", "--json", "-")
    whole = json.loads(file.read_text())
    assert whole == json.loads(alone)
    assert whole["cells"] == len(whole["results"]) == 4


@pytest.mark.parametrize(("more", "asked"), [((), (7, False)), (("--fine",), (7, True))])
def test_the_seed_draws_the_grid_as_well(
    more: tuple[str, ...], asked: tuple[int, bool], monkeypatch: pytest.MonkeyPatch
) -> None:
    grids: list[tuple[int, bool]] = []

    def grid(seed: int, *, fine: bool = False) -> list[Cell]:
        grids.append((seed, fine))
        return [parse_cell(SOUND)]

    monkeypatch.setattr("smarttac_can.cli.evidence.grid_cells", grid)
    assert "1 cells, 0 violations" in succeed("sensors", "--jobs", "1", "--seed", "7", *more)
    assert grids == [asked]


def test_a_false_trip_before_the_failure_is_a_violation() -> None:
    # A limit of the force that the finger passes before the sensor fails.
    result = run(
        "sensors",
        "--jobs",
        "1",
        "--cell",
        "failure=S3:offset:5000,mode=AMPLITUDE,motion=holding,force=9",
    )
    assert result.exit_code == 1
    assert "a false trip" in result.stdout
    assert "1 cells break the promise" in result.output


def test_healthy_runs_are_counted() -> None:
    said = run("sensors", "--jobs", "1", "--healthy", "2", "--seed", "1", "--json", "-").stdout
    whole = json.loads(said[: said.rindex("}") + 1])
    assert whole["runs"] == 2
    assert whole["cycles"] > 500
