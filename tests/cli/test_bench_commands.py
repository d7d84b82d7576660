"""Commands at a stimulator: its state, reset, live view, self-test and calibration."""

import fcntl
import itertools
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import click
import pytest
from click.testing import Result
from commands import refusal, run
from nodes_on_a_bus import (
    GUARD_S,
    both,
    in_threads,
    multicast_options,
    processes,
    stimulator_with_plate,
    until,
)

from smarttac_can.bench import BenchError, Mode, Placing, State, Stimulator, read_plan
from smarttac_can.bench.self_test import Check
from smarttac_can.canopen.commissioning.node_ids import wait_until
from smarttac_can.cli.bench import _check_line
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

# ``smarttac status`` says how a stimulator is, and ``smarttac reset`` resets its fault.


STUCK = {
    "code": int(WATCHDOGS[Watchdog.STUCK].code),
    "text": "a sensor is stuck",
    "remedy": "check the sensors, their amplifiers and cables",
}


@pytest.fixture
def node(virtual: dict[str, Any]) -> Iterator[StimulatorNode]:
    made = stimulator_with_plate(lockstep=False)
    with in_threads(virtual, made, lockstep=False):
        yield made


@pytest.fixture
def driven(virtual: dict[str, Any]) -> Iterator[Stimulator]:
    """A bench whose node has no time but that of its runs, so that nothing else trips."""
    with (
        in_threads(virtual, stimulator_with_plate()),
        Stimulator.connect(**virtual, lockstep=True) as bench,
    ):
        bench.run(0.2)
        yield bench


def smarttac(virtual: dict[str, Any], command: str, *arguments: str) -> Result:
    bus = ["--interface", virtual["interface"], "--channel", virtual["channel"], "--timeout", "5"]
    return run(command, *bus, *arguments)


def lines(result: Result) -> dict[str, str]:
    assert (result.exit_code, result.stderr) == (0, "")
    return {line[:15].strip(): line[15:] for line in result.stdout.splitlines()}


def break_a_gauge(bench: Stimulator) -> None:
    bench.set("Fault.Sensor", 3)
    bench.set("Fault.Kind", FaultKind.STUCK)
    with pytest.raises(BenchError):
        while True:
            bench.run(0.1)


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for a heartbeat however busy the machine is."""
    monkeypatch.setattr("smarttac_can.bench.status._HEARTBEATS_WAITED", GUARD_S)


@pytest.mark.usefixtures("patient")
def test_a_node_that_nobody_has_started(virtual: dict[str, Any], node: StimulatorNode) -> None:
    """It is not started by the question."""
    said = lines(smarttac(virtual, "status"))
    bus = f"virtual:{virtual['channel']}"
    assert said["nodes"] == f"stimulator 32 pre-operational, on {bus}"
    assert said["state"] == "not ready, mode off (live)"
    assert said["driven by"] == "nobody"
    assert said["voltage"] == "0 of 150 V, 0%"
    assert "fault" not in said
    assert node.device.nmt_state.name == "PRE_OPERATIONAL"


@pytest.mark.usefixtures("patient")
def test_a_boot_up_is_no_state(virtual: dict[str, Any], node: StimulatorNode) -> None:
    booted = can.Message(arbitration_id=0x720, data=[0], is_extended_id=False)
    with can.Bus(**virtual) as bus:
        bus.send_periodic(booted, 0.05, duration=0.5)
        said = json.loads(smarttac(virtual, "status", "--json").stdout)
    assert said["nmt"] == node.device.nmt_state.name.lower().replace("_", "-")


def test_status_names_the_commander(virtual: dict[str, Any], node: StimulatorNode) -> None:
    with Stimulator.connect(**virtual) as bench:
        bench.run(0.2)
        bench.arm()
        said = json.loads(smarttac(virtual, "status", "--json").stdout)
        text = lines(smarttac(virtual, "status"))
    assert (said["node_id"], said["nmt"], said["plate"]) == (32, "operational", None)
    assert said["driven_by"] == [{"node_id": 127, "bench": True, "heard": True}]
    assert text["driven by"] == "a bench script, heartbeat of node 127"


def test_state_and_levels_of_a_run_that_goes_on(
    driven: Stimulator, virtual: dict[str, Any]
) -> None:
    driven.voltage = 12.0
    driven.mode = "open_loop"
    driven.run(0.1)
    said = json.loads(smarttac(virtual, "status", "--json").stdout)
    text = lines(smarttac(virtual, "status"))
    assert driven.state is State.RUNNING
    assert (said["state"], said["mode"]) == ("running", "open_loop")
    assert said["flags"] == ["live", "driving"]
    assert said["driven_by"] == []
    assert said["levels"]["voltage"] == {"value": 12.0, "limit": 150.0, "unit": "V", "level": 0.08}
    assert 0.1 < said["levels"]["amplitude"]["value"] < 1.0
    assert said["levels"]["temperature"]["limit"] == 60.0
    # Nothing but the bench moves the time of its node, and so its heartbeat.
    assert said["nmt"] == "unknown"
    assert text["state"] == "running, mode open_loop (live, driving)"
    assert text["driven by"] == "a commander whose heartbeat is not supervised"
    assert text["voltage"] == "12 of 150 V, 8%"
    assert text["nodes"].startswith(
        "stimulator 32 in an unknown NMT state (no heartbeat), on virtual:"
    )


def test_values_that_no_cycle_has_renewed_are_named(virtual: dict[str, Any]) -> None:
    with in_threads(virtual, stimulator_with_plate()):
        said = smarttac(virtual, "status").stdout.splitlines()
    assert said[3] == "no cycles      the values below are of the last cycle, if any"


def test_a_fault_is_named_and_reset_when_its_cause_is_gone(
    driven: Stimulator, virtual: dict[str, Any]
) -> None:
    driven.arm()
    break_a_gauge(driven)
    there = lines(smarttac(virtual, "status"))
    assert there["state"] == "fault, mode off (live, fault)"
    assert there["fault"] == f"{STUCK['code']:04X}h {STUCK['text']}; {STUCK['remedy']}"
    assert there["message"] == "a sensor is stuck"
    refused = smarttac(virtual, "reset", "--lockstep")
    assert refused.stderr == "Error: the fault cannot be reset: a sensor is stuck\n"
    assert refused.exit_code == 1
    driven.set("Fault.Kind", FaultKind.NONE)
    driven.run(0.1)
    gone = json.loads(smarttac(virtual, "status", "--json").stdout)
    assert (gone["latched"], gone["present"]) == ([STUCK], [])
    assert lines(smarttac(virtual, "status"))["fault"].endswith(
        "; no longer present: smarttac reset"
    )
    done = smarttac(virtual, "reset")
    assert done.output == "stimulator 32 is reset (a sensor is stuck): ready\n"
    assert done.exit_code == 0
    assert driven.state is State.READY


def test_no_reset_beside_a_bench_that_drives(virtual: dict[str, Any], node: StimulatorNode) -> None:
    with Stimulator.connect(**virtual) as bench:
        bench.run(0.2)
        bench.arm()
        break_a_gauge(bench)
        refused = smarttac(virtual, "reset")
    assert refused.exit_code == 1
    assert "another bench script drives node 32" in refused.stderr


def test_a_reset_that_is_not_needed_disturbs_nobody(
    driven: Stimulator, virtual: dict[str, Any]
) -> None:
    driven.voltage = 5.0
    driven.mode = "open_loop"
    assert smarttac(virtual, "reset").output == (
        "stimulator 32 has no fault: its state is running\n"
    )
    assert driven.state is State.RUNNING


@pytest.mark.usefixtures("patient")
def test_the_plate_node_is_found(virtual: dict[str, Any]) -> None:
    with in_threads(virtual, *both(lockstep=False), lockstep=False):
        said = lines(smarttac(virtual, "status"))
        assert said["nodes"].startswith("stimulator 32 pre-operational, plate 33 pre-operational")
        assert said["driven by"] == "nobody"


def test_a_master_that_is_not_heard(virtual: dict[str, Any], node: StimulatorNode) -> None:
    node.od.entry(0x1016, 2).value = 5 << 16 | 100
    said = lines(smarttac(virtual, "status"))
    assert said["driven by"] == "nobody; node 5 supervised and silent"


def test_a_lost_master_is_named_with_the_cure(
    virtual: dict[str, Any], node: StimulatorNode
) -> None:
    watch = "Consumer heartbeat time.Consumer heartbeat time 2"
    with Stimulator.connect(**virtual) as bench, can.Bus(**virtual) as bus:
        bench.run(0.2)
        bench.set(watch, 5 << 16 | 2000)
        bus.send(can.Message(arbitration_id=0x705, data=[5], is_extended_id=False))
        bench.arm()
        wait_until(lambda: bench.state is State.FAULT, 60.0)
    for _ in range(2):
        refused = smarttac(virtual, "reset")
        assert (refused.exit_code, refused.stderr) == (
            1,
            "Error: the fault cannot be reset: the heartbeat of a supervised node is lost; node 5 "
            "is supervised and silent: start it again, or write 0 to 1016h sub-index 2 of node 32, "
            "or reset node 32 (NMT)\n",
        )
    with Stimulator.connect(**virtual) as bench:
        bench.set(watch, 0)
    assert smarttac(virtual, "reset").exit_code == 0


# ``smarttac watch`` as a command: in a terminal of its own, and its refusals.


class Terminal:
    """A command in a pseudo-terminal, as at the far end of ssh."""

    def __init__(self, *arguments: str, columns: int = 80, lines: int = 24) -> None:
        self._end, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        self.process = subprocess.Popen(
            [sys.executable, "-W", "error", "-m", "smarttac_can", "watch", *arguments],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            env=os.environ | {"TERM": "xterm-256color"},
            start_new_session=True,
        )
        os.close(theirs)
        self.seen = ""

    def read(self) -> bool:
        """Take the new output; False at its end."""
        if not select.select([self._end], [], [], 0.1)[0]:
            return True
        try:
            data = os.read(self._end, 65536)
        except OSError:  # Linux says so that the other end is closed
            return False
        self.seen += data.decode(errors="replace")
        return bool(data)

    def wait_for(self, text: str) -> None:
        guard = time.monotonic() + GUARD_S
        while text not in self.seen:
            assert self.read() or text in self.seen, self.seen
            assert time.monotonic() < guard, self.seen

    def press(self, keys: str) -> None:
        os.write(self._end, keys.encode())

    def end(self) -> int:
        guard = time.monotonic() + GUARD_S
        while self.read() and time.monotonic() < guard:
            pass
        try:
            return self.process.wait(GUARD_S)
        finally:
            self.process.kill()
            self.process.wait()
            os.close(self._end)


@contextmanager
def terminal(*arguments: str, **size: int) -> Iterator[Terminal]:
    made = Terminal(*arguments, **size)
    try:
        yield made
    finally:
        if made.process.returncode is None:
            made.process.kill()
            made.end()


def test_a_watch_that_drives_leaves_0_v_with_ctrl_c(multicast: dict[str, Any]) -> None:
    options = multicast_options(multicast)
    with processes(multicast, "node") as (node,), terminal(*options, "--drive") as watch:
        watch.wait_for("ready")
        watch.press("mode open_loop\r")
        node.wait_for("stimulator 32 mode open_loop")
        watch.press("\x03")
        node.wait_for("stimulator 32 mode off")
        assert watch.end() == 0
    assert "Traceback" not in watch.seen


def test_a_watch_that_is_killed_leaves_0_v(multicast: dict[str, Any]) -> None:
    stimulator = stimulator_with_plate(lockstep=False)
    mode, message = stimulator.od["Mode display"], stimulator.od["Message"]
    with (
        in_threads(multicast, stimulator, lockstep=False),
        terminal(*multicast_options(multicast), "--drive") as watch,
    ):
        watch.wait_for("ready")

        keys = itertools.cycle(("mode open_loop\r", "reset\r"))

        def drives() -> bool:
            """Press again where a busy machine stopped the watch for its heartbeat time."""
            watch.press(next(keys))
            pressed = time.monotonic()
            while mode.value != Mode.OPEN_LOOP and time.monotonic() < pressed + 3.0:
                watch.read()  # a terminal that is full stops it
            return mode.value == Mode.OPEN_LOOP

        until(drives)
        watch.process.send_signal(signal.SIGKILL)
        until(lambda: mode.value == Mode.OFF)
        assert message.value == "the heartbeat of a supervised node is lost"


def test_watch_drive_without_a_node_is_one_line(multicast: dict[str, Any]) -> None:
    with terminal(*multicast_options(multicast), "--drive") as watch:
        assert watch.end() == 1
    said = watch.seen.strip().splitlines()
    assert len(said) == 1
    assert said[0].startswith("Error: no node 32 answers on udp_multicast:239.74.163.3")


def test_without_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smarttac_can.cli.bench.find_spec", lambda name: None)
    line = refusal("watch", "--interface", "virtual")
    assert line == "watch needs Textual: pip install 'smarttac-can[watch]'"


def test_without_a_terminal() -> None:
    line = refusal("watch", "--interface", "virtual")
    assert line == "watch needs a terminal; to get a file, log the bus"


def test_watch_drive_refuses_the_option_no_sdo() -> None:
    line = refusal("watch", "--drive", "--no-sdo", code=2)
    assert line == "--drive writes by SDO: leave out --no-sdo"


# ``smarttac selftest`` as a command: lines, JSON, exit codes, and 0 V after Ctrl-C.


def selftest(bus: dict[str, Any], *arguments: str) -> subprocess.CompletedProcess[str]:
    own = [sys.executable, "-W", "error", "-m", "smarttac_can", "selftest"]
    return subprocess.run(
        [*own, *multicast_options(bus), *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=GUARD_S,
    )


def test_a_sound_plate_and_a_broken_one(multicast: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "selftest.json"
    with processes(multicast, "node --lockstep --finger none"):
        sound = selftest(multicast, "--lockstep", "--json", str(path))
        with Stimulator.connect(**multicast, lockstep=True) as bench:
            bench.set("Fault.Sensor", 3)
            bench.set("Fault.Value", 100)
            bench.set("Fault.Kind", FaultKind.OFFSET)
        broken = selftest(multicast, "--lockstep", "--json", "-")
    assert (sound.returncode, sound.stdout) == (0, "passed: 36 checks\n")
    assert sound.stderr.splitlines()[0] == (
        "ok      timing.lost rows                   0.00 %     (0..5)"
    )
    results = json.loads(path.read_text())
    assert results["passed"] is True
    assert (results["node_id"], results["plate_serial_number"]) == (32, 1)
    assert all(check["passed"] for check in results["checks"])
    assert broken.returncode == 1
    assert "FAILED  drift.S3" in broken.stderr
    bad = [check for check in json.loads(broken.stdout)["checks"] if not check["passed"]]
    assert [check["name"] for check in bad] == ["null.S3", "drift.S3"]
    bad = bad[1:]
    assert (bad[0]["unit"], bad[0]["high"]) == ("mN", 41.0)
    assert 90 < bad[0]["value"] < 110


def test_a_finger_on_the_plate_is_named(virtual: dict[str, Any]) -> None:
    node = stimulator_with_plate()
    node.od["Finger.Motion"].default = 1
    with in_threads(virtual, node):
        with Stimulator.connect(**virtual, lockstep=True) as bench:
            bench.run(0.2)
            bench.tare()
            bench.run(0.5)
        bus = ("--interface", virtual["interface"], "--channel", virtual["channel"])
        touched = run("selftest", *bus, "--lockstep")
    assert touched.exit_code == 1
    assert touched.stderr.splitlines()[-1] == "a finger touches the plate: lift it, and repeat"


# ``smarttac calibrate`` as a command, on a simulated plate that is pressed and pulled as told.


G = 9.80665
PLAN = """mass_g,angle_deg,azimuth_deg,x_mm
200,30,0,0
200,30,90,0
300,0,0,-20
300,0,0,20
"""
CHECKED_PLAN = f"""{PLAN}300,0,0,0
200,30,180,0
"""
"""It has more weighings than the fit has unknowns."""


class Laboratory:
    """A simulated bench whose person follows each request."""

    def __init__(self, bench: Stimulator, plan: list[Placing]) -> None:
        self.bench = bench
        self.written: dict[str, int] = {}
        self.gravity = G
        self.asked: list[str] = []
        self._write, bench._link.write = bench._link.write, self.write  # type: ignore[method-assign]
        level = Placing(0.0, 0.0, 0.0, 0.0)
        self._wanted = [load for one in plan for load in (one._replace(mass_g=0.0), one)] + [level]

    def write(self, name: str, raw: int) -> None:
        self.written[name] = raw
        self._write(name, raw)

    def do(self, what: str) -> None:
        self.bench.finger.put(self._wanted[len(self.asked)], self.gravity)
        self.asked.append(what)


@pytest.fixture
def laboratory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Laboratory]:
    plan = tmp_path / "plan.csv"
    plan.write_text(PLAN)
    with Stimulator.simulate("local") as bench:
        bench.run(0.2)
        made = Laboratory(bench, read_plan(plan))
        monkeypatch.setattr(Stimulator, "connect", lambda **_: bench)
        monkeypatch.setattr("smarttac_can.cli.bench._ask", made.do)
        yield made


def calibrate(folder: Path, *arguments: str) -> Result:
    plan = folder / "plan.csv"
    return run("calibrate", plan, "--certificate", folder / "plate.json", *arguments)


def test_a_plate_is_calibrated_and_has_its_nulls(laboratory: Laboratory, tmp_path: Path) -> None:
    result = calibrate(tmp_path, "--write")
    assert result.exit_code == 0, result.output
    assert laboratory.asked[:2] == [
        "1: tilt the plate by 30 degrees towards 0, nothing on it",
        "1: put 200 g at 0 mm",
    ]
    assert laboratory.asked[-1] == "level the plate, nothing on it"
    certificate = json.loads((tmp_path / "plate.json").read_text())
    found = certificate["calibration"]["objects"]
    # The simulated cross-talk is ((1, 0.04), (-0.03, 1.02)); its gauges stand at +-28 mm.
    assert found["Calibration.Fx from S2"] == pytest.approx(-0.0392, abs=0.01)
    assert found["Calibration.Position of S3"] == pytest.approx(-28_000, abs=300)
    assert certificate["calibration"]["normal_scale"] == pytest.approx(1.0, abs=0.01)
    assert len(certificate["weighings"]) == 4
    assert len(certificate["weighings"][0]["loaded_mN"]) == 6
    assert certificate["written"]["Gauge null.Window"] == 60
    assert laboratory.written["Gauge null.Window"] == 60
    assert laboratory.written["Calibration.Fx from S2"] == round(
        found["Calibration.Fx from S2"] * 1e4
    )
    assert "S3 to S6 show" in result.stdout
    assert "Calibration.Position of S3: -2" in result.stdout
    assert re.fullmatch(r"Calibration.Position of S3: -2\d{4} um", result.stdout.splitlines()[4])
    assert "the lateral matrix is unchecked" in result.stdout
    assert "the positions are unchecked" in result.stdout
    assert "residual of x" not in result.stdout


def test_a_calibration_is_rehearsed_without_a_person(
    multicast: dict[str, Any], tmp_path: Path
) -> None:
    """Also of a plate that a finger strokes by default: it is lifted."""
    (tmp_path / "plan.csv").write_text(PLAN)
    options = (*multicast_options(multicast), "--plate-node", "33", "--lockstep")
    with processes(multicast, "node --lockstep --plate-node 33", "plate --lockstep"):
        result = calibrate(tmp_path, *options, "--rehearse", "--write")
    assert result.exit_code == 0, result.output
    assert result.stderr.splitlines()[:2] == [
        "1: tilt the plate by 30 degrees towards 0, nothing on it",
        "1: put 200 g at 0 mm",
    ]
    certificate = json.loads((tmp_path / "plate.json").read_text())
    assert certificate["written"]["Calibration.Fx from S2"] == pytest.approx(-0.0392, abs=0.005)
    assert certificate["written"]["Gauge null.Null of S3"] == pytest.approx(-1045.7, abs=3.0)


def test_rehearsal_with_more_weighings_than_unknowns_has_a_residual(
    multicast: dict[str, Any], tmp_path: Path
) -> None:
    (tmp_path / "plan.csv").write_text(CHECKED_PLAN)
    options = (*multicast_options(multicast), "--plate-node", "33", "--lockstep")
    with processes(multicast, "node --lockstep --plate-node 33", "plate --lockstep"):
        result = calibrate(tmp_path, *options, "--rehearse")
    assert result.exit_code == 0, result.output
    calibration = json.loads((tmp_path / "plate.json").read_text())["calibration"]
    assert calibration["unchecked"] == []
    assert 0.0 < calibration["residual_rms"]["Fx_N"] < 0.01
    assert 0.0 < calibration["residual_rms"]["x_mm"] < 1.0
    assert re.search(r"^residual of Fx: \d\.\d mN rms$", result.stdout, re.MULTILINE)
    assert re.search(r"^residual of x: 0\.\d{3} mm rms$", result.stdout, re.MULTILINE)
    assert "unchecked" not in result.stdout


def test_without_write_nothing_changes(laboratory: Laboratory, tmp_path: Path) -> None:
    result = calibrate(tmp_path)
    assert result.exit_code == 0, result.output
    assert json.loads((tmp_path / "plate.json").read_text())["written"] == {}
    assert "Gauge null.Window" not in laboratory.written


def test_calibrate_writes_no_calibration_with_large_residuals(
    laboratory: Laboratory, tmp_path: Path
) -> None:
    laboratory.gravity = 0.9 * G
    result = calibrate(tmp_path, "--write")
    assert result.exit_code == 1
    line = result.stderr.splitlines()[-1]
    assert line.startswith("Error: not to be used: Fn is left with")
    assert "S3 to S6 show 0.899" in line
    certificate = json.loads((tmp_path / "plate.json").read_text())
    assert certificate["written"] == {}
    assert len(certificate["calibration"]["shortcomings"]) == 2
    assert "Gauge null.Window" not in laboratory.written


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mass\n", "plan.csv: line 1: the header is not mass_g,angle_deg,azimuth_deg,x_mm"),
        (PLAN.replace("300,0,0,20", "300,0,0,99"), "line 5: x_mm 99 is outside -38..38"),
    ],
)
def test_a_plan_is_looked_at_before_a_bus_is_opened(
    text: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "plan.csv").write_text(text)
    result = calibrate(tmp_path, "--interface", "virtual")
    assert result.exit_code == 1
    assert message in result.stderr.splitlines()[-1]
    assert not (tmp_path / "plate.json").exists()


def test_calibrate_refuses_tilts_in_one_direction_at_once(
    laboratory: Laboratory, tmp_path: Path
) -> None:
    (tmp_path / "plan.csv").write_text(PLAN.replace("200,30,90,0\n", ""))
    result = calibrate(tmp_path)
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert line == (
        f"Error: {tmp_path}/plan.csv: the tilted weighings load one direction only: "
        "tilt along x and along y"
    )
    assert laboratory.asked == []
    assert not (tmp_path / "plate.json").exists()


@pytest.mark.parametrize(
    ("check", "shown"),
    [
        (Check("timing.missed ticks", 32.2034, "%", 0.0, 20.0), "32.2"),
        (Check("null.W_d", -0.0640625, "nm", -5.0, 5.0), "-0.1"),
        (Check("sweep.resonance", 43389.6, "Hz", 43329.9, 43449.9), "43390"),
        (Check("timing.foreign ticks", 3.0, "", 0.0, 0.0), "3"),
        # 5.0 would not tell why it failed.
        (Check("noise.W_d", 5.0013, "nm", 0.05, 5.0), "5.001"),
    ],
)
def test_selftest_shows_the_digits_that_its_limits_deserve(check: Check, shown: str) -> None:
    assert f" {shown} " in _check_line(check)


def test_selftest_command_is_refused_while_another_bench_drives(
    laboratory: Laboratory, tmp_path: Path
) -> None:
    laboratory.bench.voltage = 5.0
    laboratory.bench.mode = "open_loop"
    result = calibrate(tmp_path, "--write")
    assert result.exit_code == 1
    assert result.stderr.startswith("Error: the stimulator is in use: it is armed or running")
    assert laboratory.asked == []
    assert not (tmp_path / "plate.json").exists()


@pytest.mark.parametrize("end", [click.Abort, KeyboardInterrupt])
def test_calibrate_interrupted_says_that_nothing_is_kept(
    laboratory: Laboratory,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    end: type[BaseException],
) -> None:
    def leave(what: str) -> None:
        if what.startswith("2: put"):
            raise end
        laboratory.do(what)

    monkeypatch.setattr("smarttac_can.cli.bench._ask", leave)
    result = calibrate(tmp_path, "--write")
    assert (result.exit_code, result.stderr) == (
        1,
        "Error: interrupted after 1 of 4 weighings: none is kept, and nothing was set in the "
        "stimulator\n",
    )
    assert [path.name for path in tmp_path.iterdir()] == ["plan.csv"]


@pytest.mark.parametrize("certificate", ["plan.csv", "linked.json"])
def test_the_certificate_never_takes_the_place_of_the_plan(
    certificate: str, tmp_path: Path
) -> None:
    plan = tmp_path / "plan.csv"
    plan.write_text(PLAN)
    (tmp_path / "linked.json").symlink_to(plan)
    arguments = (plan, "--certificate", tmp_path / certificate, "--force")
    assert "is the plan: name another file" in refusal("calibrate", *arguments, code=2)
    assert plan.read_text() == PLAN
