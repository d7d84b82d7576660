"""A watched master falls silent in a flood that does not end: 0 V while it goes on.

The machine below `with-vcan` may have one slow processor. There a loop with a plate node lives on
by its deadlines of 100 ms only now and then, so with a plate node it is the plate's own watch that
is shown, whether its stage has a voltage at that time or not. Nothing here says how fast. And with
one processor no flood goes on while the node runs, whose queue is empty soon: that device time
keeps up where it is not is shown in ``tests/host/test_runner.py``.
"""

from __future__ import annotations

import struct
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest
from nodes_on_a_bus import ODS
from processes import CHANNEL, GUARD_S, PLATE_ID, NodeProcess
from stage_watch import MASTER_ID, StageWatch

from smarttac_can.bench.simulation import STIMULATOR_ID
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.vocabulary.states import Mode

MASTER_MS = 3000
MISSED = 0x8130 | MASTER_ID << 16
"""In the history of a node that watches the master."""
FOREIGN_ID = 0x333


@contextmanager
def flood(can_id: int) -> Iterator[subprocess.Popen[bytes]]:
    """Have can-utils' cangen send SDO aborts, which have no answer, as fast as it can."""
    command = ("cangen", CHANNEL, "-g", "0", "-i", "-I", f"{can_id:X}", "-L", "8")
    with subprocess.Popen((*command, "-D", "8000000000000000")) as process:
        try:
            yield process
        finally:
            process.kill()


def voltage(watch: StageWatch, node_id: int) -> int:
    name = "Stage.Voltage" if node_id == PLATE_ID else "Vibration.Voltage"
    return watch.read(node_id, ODS[node_id][name])


def drive(watch: StageWatch) -> None:
    """Start all nodes, and run the stimulator with 40 V in open loop."""
    watch.send(0x000, b"\x01\x00")
    watch.listen(0.2)
    watch.send(0x320, struct.pack("<HI", 4000, 4_339_000))
    for controlword in (0x00, 0x80, 0x00, 0x01, 0x03):
        watch.send(0x220, struct.pack("<HB", controlword, Mode.OPEN_LOOP))
        watch.listen(0.05)


def assert_missed_in_a_flood(watch: StageWatch, node_id: int, can_id: int) -> None:
    """See that a node misses its master, and is at 0 V, before the flood ends."""
    with flood(can_id) as process:
        watch.listen(1.0)
        watch.beats = False
        end = time.monotonic() + GUARD_S
        while MISSED not in watch.errors(node_id) or voltage(watch, node_id):
            assert time.monotonic() < end, "the master is not missed"
        assert process.poll() is None


def watch_master(watch: StageWatch, node_id: int) -> None:
    watch.write(node_id, ODS[node_id].entry(0x1016, 4), MASTER_ID << 16 | MASTER_MS)
    watch.beats = True
    watch.listen(0.3)
    assert MISSED not in watch.errors(node_id)


@pytest.mark.parametrize("can_id", [0x600 + STIMULATOR_ID, FOREIGN_ID], ids=["heard", "foreign"])
def test_plate_inside(can_id: int) -> None:
    bus = {"interface": "socketcan", "channel": CHANNEL}
    with NodeProcess("node", lockstep=False) as node, StageWatch(**bus) as watch:
        watch_master(watch, STIMULATOR_ID)
        drive(watch)
        assert voltage(watch, STIMULATOR_ID) == 4000
        assert_missed_in_a_flood(watch, STIMULATOR_ID, can_id)
        assert node.terminate() == 0


@pytest.mark.parametrize("can_id", [0x600 + PLATE_ID, FOREIGN_ID], ids=["heard", "foreign"])
def test_plate_node(can_id: int) -> None:
    bus = {"interface": "socketcan", "channel": CHANNEL}
    with (
        NodeProcess("plate", lockstep=False) as plate,
        NodeProcess(
            "node", "--plate-node", str(PLATE_ID), "--produce-sync", lockstep=False
        ) as node,
        StageWatch(**bus) as watch,
    ):
        watch.set_deadlines(100)
        watch_master(watch, PLATE_ID)
        # The plate's watch is the one that is to end it.
        watch.write(STIMULATOR_ID, ODS[STIMULATOR_ID]["Drive unwatched"], 1)
        drive(watch)
        assert_missed_in_a_flood(watch, PLATE_ID, can_id)
        assert [node.terminate(), plate.terminate()] == [0, 0]


def test_kernel_drops_blocked_identifiers_until_wanted_again() -> None:
    with (
        closing(PythonCanBus("socketcan", CHANNEL)) as mine,
        closing(PythonCanBus("socketcan", CHANNEL)) as other,
    ):
        mine.block(frozenset({0x123, 0x124}))
        for can_id in (0x122, 0x123, 0x124, 0x125):
            other.send(Frame(can_id))
        assert [mine.receive(GUARD_S), mine.receive(GUARD_S)] == [Frame(0x122), Frame(0x125)]
        assert mine.receive(0.0) is None
        mine.block(frozenset({0x124}))
        for can_id in (0x124, 0x123):
            other.send(Frame(can_id))
        assert mine.receive(GUARD_S) == Frame(0x123)
        mine.block(frozenset(range(0x100, 0x200)))
        for can_id in (0x100, 0x1C7, 0x200):
            other.send(Frame(can_id))
        assert mine.receive(GUARD_S) == Frame(0x200)
