"""``smarttac selftest`` as a command: lines, JSON, exit codes, and 0 V after Ctrl-C."""

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from nodes_on_a_bus import GUARD_S, multicast_options, processes

from smarttac_can.bench import Stimulator
from smarttac_can.vocabulary.faults import FaultKind


def command(bus: dict[str, Any], *arguments: str) -> list[str]:
    own = [sys.executable, "-W", "error", "-m", "smarttac_can", "selftest"]
    return [*own, *multicast_options(bus), *arguments]


def run(bus: dict[str, Any], *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(bus, *arguments), capture_output=True, text=True, check=False, timeout=GUARD_S
    )


def test_a_sound_plate_and_a_broken_one(multicast: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "selftest.json"
    with processes(multicast, "node --lockstep --finger none"):
        sound = run(multicast, "--lockstep", "--json", str(path))
        with Stimulator.connect(**multicast, lockstep=True) as bench:
            bench.set("Fault.Sensor", 3)
            bench.set("Fault.Value", 100)
            bench.set("Fault.Kind", FaultKind.OFFSET)
        broken = run(multicast, "--lockstep", "--json", "-")
    assert (sound.returncode, sound.stdout) == (0, "passed: 35 checks\n")
    assert sound.stderr.splitlines()[0] == (
        "ok      timing.lost rows                      0 %     (0..5)"
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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_0_v(number: int, multicast: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "selftest.json"
    with processes(multicast, "node --finger none") as (node,):
        test = subprocess.Popen(
            command(multicast, "--json", str(path)),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        node.wait_for("stimulator 32 mode open_loop")
        test.send_signal(number)
        _, complaints = test.communicate(timeout=GUARD_S)
        node.wait_for("stimulator 32 mode off")
    assert test.returncode == 1
    assert complaints.splitlines()[-1] == "Aborted!"
    assert "Traceback" not in complaints
    assert not list(tmp_path.iterdir())


def test_nobody_there(multicast: dict[str, Any]) -> None:
    result = run(multicast)
    assert (result.returncode, result.stdout) == (1, "")
    (line,) = result.stderr.splitlines()
    assert line.startswith("Error: no node 32 answers on udp_multicast:")
