"""Faults on real SocketCAN: rows as without it, and real processes that break."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator

import can
import pytest
from processes import CHANNEL, GUARD_S, PLATE_ID, NodeProcess
from test_left_at_0_v import connect, stage_voltage

from smarttac_can.assurance.trials.fault_cases import cases
from smarttac_can.assurance.trials.fault_matrix import SocketCanWire, fault_matrix
from smarttac_can.assurance.trials.rig import Rig
from smarttac_can.bench import HeartbeatLostError, Mode, Stimulator
from smarttac_can.canopen.bus.bus import BusError
from smarttac_can.canopen.od import cia
from smarttac_can.vocabulary.states import State

HOLD_CYCLES = 200
PAUSE_CYCLES = 200
ROWS = [
    ("NMT stop", Mode.FRICTION),
    ("SYNC twice a cycle", Mode.AMPLITUDE_RESONANCE),
    ("a node babbles", Mode.AMPLITUDE),
    ("S3 saturated, plate inside", Mode.OPEN_LOOP),
]


@pytest.mark.parametrize(("name", "mode"), ROWS, ids=[name for name, _ in ROWS])
def test_row_of_the_fault_matrix_is_the_same(name: str, mode: Mode) -> None:
    chosen = cases([name], [mode.name.lower()])
    carried = list(fault_matrix(chosen, hold=HOLD_CYCLES, channel=CHANNEL))
    assert carried == list(fault_matrix(chosen, hold=HOLD_CYCLES))
    assert carried[0].passed


def test_frames_of_a_row_cross_the_bus_and_nobody_else_may_send() -> None:
    with (
        can.Bus(channel=CHANNEL, interface="socketcan") as bus,
        SocketCanWire(CHANNEL) as wire,
    ):
        rig = Rig(wire=wire)
        rig.start()
        assert bus.recv(0) is not None
        bus.send(can.Message(arbitration_id=cia.SYNC_ID, is_extended_id=False))
        with pytest.raises(BusError, match="somebody else sends on vcan0"):
            rig.cycle()


@pytest.fixture
def nodes() -> Iterator[tuple[NodeProcess, NodeProcess]]:
    with NodeProcess("plate") as plate, NodeProcess("node", "--plate-node", str(PLATE_ID)) as node:
        yield plate, node


def drive(bench: Stimulator, mode: Mode) -> None:
    bench.finger.lift()
    bench.start_run()
    bench.tare()
    bench.voltage, bench.amplitude = 20, 1.0
    bench.mode = mode
    assert bench.run(0.2).voltage_v[-1] > 0


def when_it_answers(bench: Stimulator) -> State:
    """State of a stimulator that first has to work through its backlog."""
    end = time.monotonic() + GUARD_S
    while True:
        try:
            return bench.state
        except HeartbeatLostError:
            assert time.monotonic() < end, "the stimulator does not come back"


def test_stimulator_process_paused_and_continued(nodes: tuple[NodeProcess, NodeProcess]) -> None:
    _, node = nodes
    # With patience: a process that was paused has much to hear.
    with connect(10.0) as bench, can.Bus(channel=CHANNEL, interface="socketcan") as bus:
        drive(bench, Mode.OPEN_LOOP)
        node.process.send_signal(signal.SIGSTOP)
        sync = can.Message(arbitration_id=cia.SYNC_ID, is_extended_id=False)
        for _ in range(4):
            bus.send(sync)
        assert stage_voltage() == 0, "the plate does not wait for the stimulator"
        for _ in range(PAUSE_CYCLES):
            bus.send(sync)
        node.process.send_signal(signal.SIGCONT)
        assert when_it_answers(bench) is State.FAULT
        assert not bench.run(1.0).voltage_v.any()
        assert stage_voltage() == 0
