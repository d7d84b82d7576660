"""Faults on real SocketCAN: rows as without it, and real processes that break."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Iterator
from contextlib import suppress

import can
import pytest
from processes import CHANNEL, GUARD_S, PLATE_ID, NodeProcess
from test_left_at_0_v import connect, stage_voltage

from smarttac_can.bench import BenchError, FaultError, HeartbeatLostError, Mode, Stimulator
from smarttac_can.bench.simulation import STIMULATOR_ID
from smarttac_can.host.bus import BusError
from smarttac_can.od.cia import EMCY_ID, SYNC_ID
from smarttac_can.trials.fault_cases import cases
from smarttac_can.trials.fault_matrix import SocketCanWire, fault_matrix
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.faults import PICKUP_D, FaultKind
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import SATURATED_CYCLES, STUCK_GAUGE_CYCLES

HOLD_CYCLES = 200
HOLD_S = 1.0
PAUSE_CYCLES = 200
ROWS = [
    ("NMT stop", Mode.FRICTION),
    ("heartbeat of the plate lost", Mode.OPEN_LOOP),
    ("drives lost", Mode.AMPLITUDE),
    ("SYNC twice a cycle", Mode.AMPLITUDE_RESONANCE),
    ("bus-off", Mode.IDENTIFY),
    ("S3 stuck", Mode.FRICTION),
    ("measurements corrupt", Mode.IDENTIFY),
    ("a node babbles", Mode.AMPLITUDE),
    ("plate restarts", Mode.AMPLITUDE_RESONANCE),
    ("S3 saturated, plate inside", Mode.OPEN_LOOP),
]
FAULTS = {
    "pick-up saturated": (Mode.OPEN_LOOP, FaultKind.SATURATED, PICKUP_D, SATURATED_CYCLES, 0x5210),
    "gauge stuck": (Mode.AMPLITUDE_RESONANCE, FaultKind.STUCK, 5, STUCK_GAUGE_CYCLES, 0x5211),
}
"""Mode; kind and sensor of the fault; bound in cycles; emergency code."""


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
        bus.send(can.Message(arbitration_id=SYNC_ID, is_extended_id=False))
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


def emergencies(bus: can.BusABC) -> list[int]:
    codes = []
    while (message := bus.recv(0.2)) is not None:
        codes.append(int.from_bytes(message.data[:2], "little"))
    return codes


def emergency_bus() -> can.BusABC:
    filters = [{"can_id": EMCY_ID + STIMULATOR_ID, "can_mask": 0x7FF}]
    return can.Bus(channel=CHANNEL, interface="socketcan", can_filters=filters)


def when_it_answers(bench: Stimulator) -> State:
    """State of a stimulator that first has to work through what it missed."""
    end = time.monotonic() + GUARD_S
    while True:
        try:
            return bench.state
        except HeartbeatLostError:
            assert time.monotonic() < end, "the stimulator does not come back"


@pytest.mark.parametrize("name", FAULTS)
def test_broken_sensor(nodes: tuple[NodeProcess, NodeProcess], name: str) -> None:
    mode, kind, sensor, bound, code = FAULTS[name]
    draw = random.Random(code)
    with connect() as bench, emergency_bus() as bus:
        drive(bench, mode)
        assert stage_voltage() > 0
        bench.set("Fault.Sensor", sensor)
        bench.set("Fault.Kind", kind)
        with pytest.raises(FaultError) as told:
            bench.run(0.1)
        assert told.value.trace is not None
        voltages = told.value.trace.voltage_v.tolist()
        assert voltages.index(0) + 1 <= bound + 1
        assert emergencies(bus)[0] == code
        assert stage_voltage() == 0
        for _ in range(5):
            with suppress(BenchError):
                bench.voltage = draw.uniform(0, 60)
                bench.amplitude = draw.uniform(0, 2)
                bench.mode = draw.choice(list(Mode))
            assert not bench.run(HOLD_S / 5).voltage_v.any()
        assert stage_voltage() == 0
        bench.set("Fault.Kind", FaultKind.NONE)
        bench.run(0.2)
        bench.reset_fault()
        drive(bench, mode)
        assert stage_voltage() > 0


def test_stimulator_process_paused_and_continued(nodes: tuple[NodeProcess, NodeProcess]) -> None:
    _, node = nodes
    with connect() as bench, can.Bus(channel=CHANNEL, interface="socketcan") as bus:
        drive(bench, Mode.OPEN_LOOP)
        node.process.send_signal(signal.SIGSTOP)
        sync = can.Message(arbitration_id=SYNC_ID, is_extended_id=False)
        for _ in range(4):
            bus.send(sync)
        assert stage_voltage() == 0, "the plate does not wait for the stimulator"
        for _ in range(PAUSE_CYCLES):
            bus.send(sync)
        node.process.send_signal(signal.SIGCONT)
        assert when_it_answers(bench) is State.FAULT
        assert not bench.run(1.0).voltage_v.any()
        assert stage_voltage() == 0
