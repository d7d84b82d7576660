"""``smarttac node`` and ``smarttac plate`` as processes on a bus of sockets."""

import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import psutil
import pytest
from nodes_on_a_bus import (
    GUARD_S,
    driven_voltages,
    in_threads,
    processes,
    stimulator_with_plate,
    until,
    watched,
)

from smarttac_can.bench import Mode, NotRunningError, RefusedError, Stimulator
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import State


def test_a_signal_leaves_0_v(multicast: dict[str, Any]) -> None:
    """Which ones do is tested in ``tests/host/test_process_signals.py``."""
    nodes = ("plate --lockstep", "node --plate-node 33 --lockstep")
    with processes(multicast, *nodes) as (plate, node):
        with driven_voltages(multicast) as voltages:
            bench = Stimulator.connect(**multicast, plate_node_id=33, lockstep=True)
            bench.run(0.2)
            bench.amplitude = 1.0
            bench.mode = "amplitude"
            bench.run(0.02)
            bench._link.close()
            bench._disown()  # it has gone without a word
            node.wait_for("stimulator 32 mode amplitude")
            until(lambda: voltages[-1:] > [1000])
            status, lines, complaints = node.end()
            assert (status, complaints) == (0, "")
            assert lines[-1] == "stimulator 32 stopped at 0 V"
            until(lambda: voltages[-1] == 0)
        status, lines, complaints = plate.end()
        assert (status, complaints) == (0, "")
        assert lines == ["plate 33 operational", "plate 33 stopped at 0 V"]


LOST_MS = 3000
"""After which a bench of these tests counts as lost: a busy machine stops one for more than 1 s."""
KILLED = """
import sys
from smarttac_can.bench import NotReadyError, Stimulator, remote_device
remote_device._LOST_MS = int(sys.argv[4])
bench = Stimulator.connect(
    interface=sys.argv[1], channel=sys.argv[2], port=int(sys.argv[3]), timeout=60
)
bench.voltage = 20
for attempt in range(600):
    try:
        bench.mode = "open_loop"
        break
    except NotReadyError:  # a loop that a busy machine holds up is not tared yet
        bench.run(0.1)
exec(sys.argv[5])
print("drives", flush=True)
input()
"""


@contextmanager
def driver(bus: dict[str, Any], then: str = "") -> Iterator[subprocess.Popen[bytes]]:
    """Run a bench script that drives, and does something more, for the block to kill."""
    place = [str(bus[key]) for key in ("interface", "channel", "port")]
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, *place, str(LOST_MS), then],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as bench:
        assert bench.stdout is not None
        assert bench.stdout.readline() == b"drives\n"
        yield bench


@pytest.fixture
def node(multicast: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> Iterator[StimulatorNode]:
    """Run a node in a thread, which ends no run because the machine is busy."""
    monkeypatch.setattr("smarttac_can.bench.remote_device._LOST_MS", LOST_MS)
    made = stimulator_with_plate(lockstep=False)
    with in_threads(multicast, made, lockstep=False):
        yield made


def test_a_killed_bench_leaves_0_v_and_the_next_one_resets_that(
    node: StimulatorNode, multicast: dict[str, Any]
) -> None:
    """A bench that only reads does not stand in for the killed one."""
    mode = node.od["Mode display"]
    with Stimulator.connect(**multicast, timeout=GUARD_S) as reader:
        with driver(multicast) as killed:
            until(lambda: reader.get("Vibration.Voltage") > 0.0)
            killed.kill()
        until(lambda: mode.value == Mode.OFF)
        until(lambda: reader.get("Vibration.Voltage") == 0.0)
        assert reader.message == "the heartbeat of a supervised node is lost"
        with Stimulator.connect(**multicast, timeout=GUARD_S) as bench:
            assert bench.state is State.FAULT
            assert bench.message == "the heartbeat of a supervised node is lost"
            bench.reset_fault()
            bench.mode = "open_loop"
            assert watched(bench).count(0x7F << 16 | 3000) == 1


AT_0_V = {
    "bench.mode = 'off'": State.NOT_READY,
    "bench.quick_stop()": State.NOT_READY,
    "bench.mode = 'off'; bench.arm()": State.FAULT,
}
"""Acts of a bench before it is killed, and the state of its stimulator then."""


def test_a_bench_killed_at_0_v_locks_nobody_out(
    node: StimulatorNode, multicast: dict[str, Any]
) -> None:
    with Stimulator.connect(**multicast, timeout=GUARD_S) as reader:
        for then, state in AT_0_V.items():
            with driver(multicast, then) as killed:
                killed.kill()
            until(lambda state=state: reader.state is state)
            with Stimulator.connect(**multicast, timeout=GUARD_S) as bench:
                bench.reset_fault()
                bench.mode = "open_loop"
                assert bench.state is State.RUNNING, then


def test_one_command_shows_a_master_forces_and_a_cof(multicast: dict[str, Any]) -> None:
    with (
        processes(multicast, "node") as (node,),
        can.Bus(**multicast) as master,
    ):
        master.send(can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False))
        node.wait_for("stimulator 32 operational")
        Fn = cof = 0
        guard = time.monotonic() + GUARD_S
        while not (cof and Fn > 400):
            message = master.recv(GUARD_S)
            assert message is not None and time.monotonic() < guard, "no finger touches"
            if message.arbitration_id == 0x2A0:
                Ft, Fn, cof, _ = struct.unpack("<hhHH", message.data)
        assert 400 < Fn < 600
        assert abs(cof / 1e4 - Ft / Fn) < 0.05


def test_a_line_per_change_of_state_and_none_per_cycle(multicast: dict[str, Any]) -> None:
    with processes(multicast, "node --lockstep") as (node,):
        with Stimulator.connect(**multicast, lockstep=True) as bench:
            bench.run(0.2)
            bench.voltage = 10.0
            bench.mode = "open loop"
            bench.run(0.2)
            bench.mode = Mode.OFF
            bench.run(0.05)
        status, lines, complaints = node.end()
        assert (status, complaints) == (0, "")
        assert lines == [
            "stimulator 32 operational",
            "stimulator 32 mode open_loop",
            "stimulator 32 mode off",
            "stimulator 32 stopped at 0 V",
        ]


def test_the_faults_outlive_a_power_cut_where_there_is_storage(
    multicast: dict[str, Any], tmp_path: Path
) -> None:
    file = tmp_path / "kept.faults"
    command = f"node --storage {tmp_path / 'kept'}"
    with processes(multicast, f"{command} --lockstep") as (node,):
        with Stimulator.connect(**multicast, lockstep=True) as bench, can.Bus(**multicast) as other:
            bench.run(0.2)
            bench.voltage = 20
            device = bench._link._stimulator  # type: ignore[attr-defined]
            device.write(device.od.entry(0x1016, 4), 5 << 16 | 100)
            other.send(can.Message(arbitration_id=0x705, data=[5], is_extended_id=False))
            bench.mode = "open_loop"
            with pytest.raises(NotRunningError):  # 1029h: it leaves Operational
                bench.run(0.5)
        node.wait_for("stimulator 32 mode off")
        until(file.exists)
        node.process.kill()
    with processes(multicast, command), Stimulator.connect(**multicast) as bench:
        fault = bench._link.read("Fault memory.Fault 1")
        assert fault.startswith(
            "8131h the heartbeat of a supervised node is lost; mode open loop, "
        )
        assert "Voltage 20000 mV" in fault
        assert bench.state is not State.FAULT, "the memory is not the latch"


def test_node_runs_although_its_fault_file_cannot_be_had(
    multicast: dict[str, Any], tmp_path: Path
) -> None:
    (tmp_path / "kept.faults").mkdir()
    with processes(multicast, f"node --storage {tmp_path / 'kept'}") as (node,):
        status, _, complaints = node.end()
        assert status == 0
        assert "the newest faults are not kept" in complaints


def test_a_running_node_takes_less_than_120_mb(multicast: dict[str, Any]) -> None:
    with (
        processes(multicast, "node --lockstep") as (node,),
        Stimulator.connect(**multicast, lockstep=True) as bench,
    ):
        bench.run(0.3)
        status = Path(f"/proc/{node.process.pid}/status")
        if status.exists():
            peak = next(line for line in status.read_text().splitlines() if "VmHWM" in line)
            assert int(peak.split()[1]) < 120_000, peak
        assert psutil.Process(node.process.pid).memory_info().rss < 120e6


def test_a_node_with_the_plate_inside_knows_its_nulls(multicast: dict[str, Any]) -> None:
    """By default its finger strokes; a tare under it is refused."""
    with (
        processes(multicast, "node --lockstep"),
        Stimulator.connect(**multicast, lockstep=True) as bench,
    ):
        bench.run(1.0)
        assert bench.read().normal_force > 0.2
        with pytest.raises(RefusedError, match=r"not tared: S\d reads .* than 60 mN from its null"):
            bench.tare()
