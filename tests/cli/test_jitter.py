"""``smarttac jitter``: its structure and its ends, but not how punctual a machine is that tests."""

import json
import os
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import can
import psutil
import pytest
from commands import refusal, run
from nodes_on_a_bus import GUARD_S, driven_voltages, multicast_options, processes, until

DELAYS = {"p50_us", "p99_us", "p999_us", "max_us"}
KEYS = {
    *("sync", "drive", "measurement", "missed", "ticks", "lost", "deadline_ms", "gap_max_us"),
    *("stage", "state", "message", "refused", "build"),
}

PATIENCE_S = 20.0


def children() -> list[psutil.Process]:
    return psutil.Process().children(recursive=True)


def test_a_second_on_a_simulated_plate(multicast: dict[str, Any], tmp_path: Path) -> None:
    results, folder = tmp_path / "jitter.json", tmp_path / "pictures"
    files = ("--json", results, "--output", folder)
    done = run("jitter", *multicast_options(multicast), "--seconds", "1", *files)
    figures = json.loads(results.read_text())
    assert set(figures) == KEYS
    for name in ("sync", "drive", "measurement"):
        assert set(figures[name]) == DELAYS
        assert 0 <= figures[name]["p50_us"] <= figures[name]["max_us"]
    assert figures["ticks"] > 0
    assert 0 <= figures["missed"] <= figures["ticks"]
    assert figures["gap_max_us"] > 0
    assert figures["refused"] == [], "nothing was asked for"
    deadline = figures["deadline_ms"]
    if deadline is None:
        assert figures["stage"] is None
    else:
        assert 2 * figures["gap_max_us"] - 2 <= 1000 * deadline
        assert figures["stage"]["final_um"] == 7.5
    # A machine that is too busy may not get as far, or not stay there, and has to say so.
    if done.exit_code:
        assert "the loop never ran: " in done.stderr
    assert figures["state"] == "running" or figures["message"]
    assert (figures["state"] == "running") == ("the loop was RUNNING to the end" in done.stdout)
    assert f"of {figures['ticks']} ticks missed" in done.stdout
    assert (folder / "jitter.png").read_bytes().startswith(b"\x89PNG")
    assert not children()


@pytest.mark.long
@pytest.mark.usefixtures("without_privileges")
def test_jitter_names_each_refusal_of_its_nodes(multicast: dict[str, Any]) -> None:
    done = run(
        "jitter", *multicast_options(multicast), "--seconds", "1", "--realtime", "50", "--json", "-"
    )
    refused = json.loads(done.stdout)["refused"]
    assert len(set(refused)) == len(refused), "two nodes, one line"
    assert set(refused) <= set(done.stderr.splitlines())
    if os.geteuid() == 0:
        assert any("SCHED_FIFO 50 is refused" in line for line in refused)


def test_a_plate_that_is_there_stays_at_0_v(multicast: dict[str, Any]) -> None:
    with processes(multicast, "plate") as (plate,), driven_voltages(multicast) as heard:
        done = run(
            "jitter",
            *multicast_options(multicast),
            "--seconds",
            "1",
            "--plate-node",
            "33",
            "--json",
            "-",
        )
        assert done.exit_code == 0, done.output
        figures = json.loads(done.stdout)
        assert figures["ticks"] > 0
        assert figures["state"] in ("not_ready", "ready")
        assert plate.process.poll() is None
        assert set(heard) == {0}
    assert not children()


def test_a_signal_ends_it_with_its_nodes(multicast: dict[str, Any]) -> None:
    command = [sys.executable, "-m", "smarttac_can", "jitter", *multicast_options(multicast)]
    with subprocess.Popen(
        [*command, "--seconds", "3600", "--json", "-"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            until(lambda: len(psutil.Process(process.pid).children()) >= 2)
            nodes = psutil.Process(process.pid).children()
            with can.Bus(**multicast) as bus:
                until(lambda: (heard := bus.recv(GUARD_S)) and heard.arbitration_id == 0x221)
        finally:
            process.terminate()
            said, complaints = process.communicate(timeout=GUARD_S)
        assert not any(node.is_running() for node in nodes)
    assert "Traceback" not in complaints
    if said:
        assert set(json.loads(said)) == KEYS
    else:
        assert "the loop never ran" in complaints


@pytest.mark.long
def test_nothing_is_left_of_one_that_is_killed(multicast: dict[str, Any]) -> None:
    command = [sys.executable, "-m", "smarttac_can", "jitter", *multicast_options(multicast)]
    nodes: list[psutil.Process] = []
    with (
        driven_voltages(multicast) as heard,
        subprocess.Popen([*command, "--seconds", "3600"], stderr=subprocess.DEVNULL) as process,
    ):
        try:
            until(lambda: heard)
            # A machine that is too busy ends the loop by a missed deadline before it has a voltage.
            patience = time.monotonic() + PATIENCE_S
            while not any(heard) and time.monotonic() < patience:
                time.sleep(0.005)
            nodes = psutil.Process(process.pid).children(recursive=True)
            process.kill()
            ended, alive = psutil.wait_procs(nodes, GUARD_S)
            assert not alive
            assert len(ended) >= 2
            # The last drive; it was sent, and may still be on its way to this thread.
            until(lambda: heard[-1] == 0)
        finally:
            process.kill()
            for node in nodes:
                with suppress(psutil.NoSuchProcess):
                    node.kill()


def test_a_node_that_ends_is_named(multicast: dict[str, Any]) -> None:
    """As the plate's node-ID is the stimulator's."""
    line = refusal("jitter", *multicast_options(multicast), "--plate-node", "32")
    assert line.startswith("smarttac node has ended: --plate-node 32 is the --node-id")
    assert not children()


def test_a_plate_that_is_not_there(multicast: dict[str, Any]) -> None:
    line = refusal("jitter", *multicast_options(multicast), "--plate-node", "44")
    assert line.startswith("no node 44 answers on udp_multicast:")
    assert not children()


def test_a_loop_that_is_there_already(
    multicast: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smarttac_can.assurance.timing.loop_run._ANSWER_S", GUARD_S)
    with can.Bus(**multicast) as bus:
        over = threading.Event()

        def produce() -> None:
            while not over.wait(0.01):
                bus.send(can.Message(arbitration_id=0x80, is_extended_id=False))

        producer = threading.Thread(target=produce)
        producer.start()
        try:
            line = refusal("jitter", *multicast_options(multicast))
        finally:
            over.set()
            producer.join()
    assert line == "somebody produces SYNC on this bus: end that loop first"


@pytest.mark.parametrize(
    ("command", "others", "node_id"),
    [
        ("node --lockstep", ("--plate-node", "44"), 32),
        ("plate", (), 33),
    ],
)
def test_a_node_that_is_there_already(
    command: str,
    others: tuple[str, ...],
    node_id: int,
    multicast: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("smarttac_can.assurance.timing.loop_run._ANSWER_S", GUARD_S)
    with processes(multicast, command) as (node,):
        line = refusal("jitter", *multicast_options(multicast), *others)
        assert len(children()) == 1
        assert node.process.poll() is None
    assert line == (
        f"a node {node_id} is on this bus already, and two would have one node-ID: "
        "end it, or give it another by LSS or --node-id"
    )


def test_a_node_that_is_stopped_is_known_by_its_heartbeat(
    multicast: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smarttac_can.assurance.timing.loop_run._ANSWER_S", GUARD_S)
    with processes(multicast, "node"), can.Bus(**multicast) as bus:
        bus.send(can.Message(arbitration_id=0, data=[2, 32], is_extended_id=False))
        assert refusal("jitter", *multicast_options(multicast)).startswith(
            "a node 32 is on this bus already"
        )


def test_a_bus_without_time_stamps_of_the_kernel() -> None:
    line = refusal("jitter", "--interface", "virtual", "--channel", "test_jitter")
    assert line.startswith("the loop is timed by the kernel's time stamps")
    assert "socketcan or udp_multicast have them" in line


def test_the_picture_without_matplotlib(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("smarttac_can.bench.traces.find_spec", lambda name: None)
    line = refusal("jitter", "--interface", "virtual", "--output", str(tmp_path / "pictures"))
    assert line == "the pictures need matplotlib: pip install 'smarttac-can[report]'"
    assert not list(tmp_path.iterdir())
