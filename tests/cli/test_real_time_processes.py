"""``smarttac node`` and ``plate`` in real time: stopped, flooded or ignored.

Nothing here says how fast: order and state are asserted. A busy machine may hold an ordinary
process up for longer than the loop's deadline of 20 ms, so it is 100 ms where the loop has to run.
"""

import fcntl
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

import pytest
from nodes_on_a_bus import GUARD_S, ODS, multicast_options, processes, until
from stage_watch import MASTER_ID, StageWatch

from smarttac_can.bench import FaultError, HeartbeatLostError, Stimulator
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.instrument.nodes.loop_frames import crc8
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

DEADLINE_MS = 100
PAUSE_S = 0.3
VOLTAGE_V = 40.0
RAW = 4000
MISSED = 0x8130 | MASTER_ID << 16
"""In the history of a node that watches the master."""
NODES = ("plate", f"node --plate-node {PLATE_ID} --produce-sync")


def drive(bench: Stimulator) -> None:
    """Run with a voltage; a machine that is so busy that it trips on the way gets another try."""
    end = time.monotonic() + GUARD_S
    while bench.state is not State.RUNNING:
        assert time.monotonic() < end, bench.message
        bench.disarm()
        bench.reset_fault()
        bench.start_run()
        bench.tare()
        bench.set("Limit.Missed ticks", 50)
        bench.voltage = VOLTAGE_V
        bench.mode = "open_loop"


def undisturbed(bench: Stimulator, act: Callable[[], object]) -> None:
    """See that a run outlasts an act; one that a busy machine gives half its ticks is repeated."""
    end = time.monotonic() + GUARD_S
    while True:
        drive(bench)
        with suppress(FaultError):
            act()
        if bench.state is State.RUNNING:
            return
        assert bench.message.startswith(WATCHDOGS[Watchdog.MISSED_TIME].text)
        assert time.monotonic() < end, bench.message


@contextmanager
def connected(bus: dict[str, Any]) -> Iterator[Stimulator]:
    """Be a bench whose stimulator may be gone when it leaves, not before."""
    bench = Stimulator.connect(**bus, plate_node_id=PLATE_ID)
    try:
        yield bench
    finally:
        with suppress(HeartbeatLostError), bench:
            pass


@contextmanager
def loop(bus: dict[str, Any]) -> Iterator[tuple[list[Any], StageWatch]]:
    """Plate and stimulator, with deadlines that a busy machine keeps, and their watcher."""
    with processes(bus, *NODES) as nodes, StageWatch(**bus) as watch:
        watch.set_deadlines(DEADLINE_MS)
        yield nodes, watch


def at_rest(watch: StageWatch) -> bool:
    return watch.read_stage().raw == 0


@contextmanager
def unread(bus: dict[str, Any], command: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node whose stdout is a full pipe from when it is ready."""
    reader, writer = os.pipe()
    fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, 4096)
    arguments = [sys.executable, "-m", "smarttac_can", *command.split(), *multicast_options(bus)]
    process = subprocess.Popen(arguments, stdout=writer)
    os.close(writer)
    with process, os.fdopen(reader, "rb", buffering=0) as said:
        try:
            assert b" ready on " in said.readline()
            # Opened anew: a pipe that does not block here still blocks there.
            full = os.open(f"/proc/self/fd/{reader}", os.O_WRONLY | os.O_NONBLOCK)
            with pytest.raises(BlockingIOError):
                while True:
                    os.write(full, b"\n")
            os.close(full)
            yield process
        finally:
            process.kill()


def assert_cycles_rise(watch: StageWatch, node_id: int, name: str) -> None:
    before = watch.read(node_id, ODS[node_id][name])
    until(lambda: watch.read(node_id, ODS[node_id][name]) != before)


@pytest.mark.skipif(sys.platform != "linux", reason="the size of a pipe is set")
def test_stimulator_with_unread_stdout_runs_and_ends_at_0_v(
    multicast: dict[str, Any],
) -> None:
    with (
        processes(multicast, "plate"),
        unread(multicast, f"node --plate-node {PLATE_ID} --produce-sync") as node,
        StageWatch(**multicast) as watch,
    ):
        watch.set_deadlines(DEADLINE_MS)
        with connected(multicast) as bench:
            for _ in range(3):
                bench.mode = "off"
                drive(bench)
            until(lambda: not at_rest(watch))
            assert_cycles_rise(watch, STIMULATOR_ID, "Contact.Tick")
            assert bench.state is State.RUNNING
            node.terminate()
            assert node.wait(GUARD_S) == 0
            until(lambda: at_rest(watch))
            # By its word, before the deadline of the plate.
            assert (PLATE_ID, 0x8253) not in watch.emergencies


@pytest.mark.skipif(sys.platform != "linux", reason="the size of a pipe is set")
def test_plate_goes_on_and_ends_with_an_unread_stdout(multicast: dict[str, Any]) -> None:
    with unread(multicast, "plate") as plate, StageWatch(**multicast) as watch:
        for command in (1, 128, 1, 128, 1):
            watch.send(0, bytes((command, 0)))
        controller = Controller(watch)
        controller.drive_until_voltage()
        controller.cycle(RAW)
        assert_cycles_rise_with(controller, watch)
        plate.terminate()
        assert plate.wait(GUARD_S) == 0


class Controller:
    """A stimulator that sends given frames, and SYNC."""

    def __init__(self, watch: StageWatch) -> None:
        self.watch = watch
        watch.write(PLATE_ID, ODS[PLATE_ID].entry(0x1400, 5), DEADLINE_MS)
        watch.send(0, bytes((1, 0)))

    def cycle(self, raw: int) -> None:
        """Have a measurement, and answer it."""
        self.watch.send(0x80, b"")
        self.watch.listen(0.002)
        self.send_drive(self.watch.tick, raw)

    def send_drive(self, tick: int, raw: int) -> None:
        values = struct.pack("<HIB", raw, 4_339_000, tick & 0xFF)
        check = crc8(values + bytes((0, STIMULATOR_ID)))
        self.watch.send(0x200 + PLATE_ID, values + bytes((check,)))

    def drive_until_voltage(self) -> None:
        """Say 0 V once, then a voltage, until it is there, in the place of a stimulator."""

        def driven() -> bool:
            self.cycle(0)
            for _ in range(5):
                self.cycle(RAW)
            return self.watch.read_stage().raw == RAW

        until(driven)


def assert_cycles_rise_with(controller: Controller, watch: StageWatch) -> None:
    before = watch.read(PLATE_ID, ODS[PLATE_ID]["Cycle.Ticks"])
    controller.cycle(0)
    until(lambda: watch.read(PLATE_ID, ODS[PLATE_ID]["Cycle.Ticks"]) > before)


def test_resumed_plate_process_is_at_0_v_before_queued_frames(
    multicast: dict[str, Any],
) -> None:
    with processes(multicast, "plate") as (plate,), StageWatch(**multicast) as watch:
        controller = Controller(watch)
        controller.drive_until_voltage()
        watch.emergencies.clear()
        # The first drive that waits answers the measurement that the plate has sent before.
        watch.send(0x80, b"")
        watch.listen(0.02)
        plate.process.send_signal(signal.SIGSTOP)
        for tick in range(watch.tick, watch.tick + 10):
            controller.send_drive(tick, RAW)
            watch.ask()
            watch.send(0x80, b"")
        time.sleep(PAUSE_S)
        plate.process.send_signal(signal.SIGCONT)
        assert at_rest(watch), "the answer came behind the drives that waited"
        until(lambda: at_rest(watch) and (PLATE_ID, 0x8253) in watch.emergencies)
        for _ in range(20):
            controller.cycle(RAW)
            assert at_rest(watch), "barred until it was told 0 V"
        controller.drive_until_voltage()


def test_a_killed_stimulator_leaves_0_v(multicast: dict[str, Any]) -> None:
    with (
        loop(multicast) as ((_, node), watch),
        connected(multicast) as bench,
    ):
        drive(bench)
        until(lambda: not at_rest(watch))
        node.process.kill()
        until(lambda: at_rest(watch))
        watch.listen(PAUSE_S)
        assert at_rest(watch)


FLOOD = """
import socket
import sys
import can
from can.interfaces.udp_multicast.utils import pack_message
_, channel, port, can_id = sys.argv[1:]
read = can.Message(arbitration_id=int(can_id), data=b"@\\0\\x10" + bytes(5), is_extended_id=False)
packed = pack_message(read)
print("ready", flush=True)
input()
with socket.socket(type=socket.SOCK_DGRAM) as sender:
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
    while True:
        sender.sendto(packed, (channel, int(port)))
"""
"""Reads of 1000h: their answers keep the node busy for longer than it takes to send it."""


@contextmanager
def process(script: str, *arguments: object) -> Iterator[subprocess.Popen[bytes]]:
    """Run a script that prints a line, until the block ends."""
    command = [sys.executable, "-c", script, *map(str, arguments)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as running:
        try:
            assert running.stdout is not None
            assert running.stdout.readline()
            yield running
        finally:
            running.kill()


def test_lost_master_heartbeat_is_seen_in_a_flood(
    multicast: dict[str, Any],
) -> None:
    """By a stimulator; a plate is flooded on vcan.

    That device time keeps up at every moment of it is shown in ``tests/host/test_runner.py``.
    """
    with ExitStack() as stack:
        _, watch = stack.enter_context(loop(multicast))
        # On two processors one of them runs while the node does.
        floods = [
            stack.enter_context(process(FLOOD, *multicast.values(), 0x600 + STIMULATOR_ID))
            for _ in range(2)
        ]
        drive(stack.enter_context(connected(multicast)))
        watch.write(STIMULATOR_ID, ODS[STIMULATOR_ID].entry(0x1016, 3), MASTER_ID << 16 | 3000)
        watch.beats = True
        watch.listen(0.5)
        assert MISSED not in watch.errors(STIMULATOR_ID)
        for flood in floods:
            assert flood.stdin is not None
            flood.stdin.write(b"\n")
            flood.stdin.flush()
        watch.listen(1.0)
        watch.beats = False
        until(lambda: MISSED in watch.errors(STIMULATOR_ID))
        until(lambda: at_rest(watch))
        assert all(flood.poll() is None for flood in floods)
        for flood in floods:
            flood.kill()


READS = """
import sys
from contextlib import suppress
from smarttac_can.bench import FaultError, Stimulator
interface, channel, port = sys.argv[1:]
bench = Stimulator.connect(interface=interface, channel=channel, port=int(port))
with suppress(FaultError):
    bench.run(0.1)
print("reads", flush=True)
while True:
    with suppress(FaultError):
        bench.run(0.02)
    assert bench.state
"""
"""The commander judges a fault."""


def test_run_goes_on_when_a_reading_bench_is_killed(
    multicast: dict[str, Any],
) -> None:
    with (
        processes(multicast, "node --finger none"),
        Stimulator.connect(**multicast) as bench,
    ):

        def read() -> None:
            with process(READS, *multicast.values()) as reader:
                assert bench.run(0.2).voltage_v[-1] > 0
                reader.send_signal(signal.SIGSTOP)
                assert bench.run(1.5).voltage_v.all()
            assert bench.run(0.5).voltage_v.all()

        undisturbed(bench, read)
