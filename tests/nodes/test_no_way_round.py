"""There is no way round a fault, or into a drive, but the one that is meant."""

import struct

from line import RESET_COMMUNICATION, START, SYNC, Line
from loop import AMPLITUDE_RESONANCE, MASTER, SETPOINT_DEADLINE_MS, Loop

from smarttac_can.bench.open_link import PLATE_ID, plate_od, stimulator_od
from smarttac_can.device.frame import Frame
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.state_machine import State
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.nodes.watchdogs import Watchdog
from smarttac_can.plant.faults import THERMOMETER, FaultKind

STATE = 0x08000022
RESET_FAULT = 0x80
ZERO = int.from_bytes(b"zero", "little")


def latched(loop: Loop, watchdog: Watchdog) -> bool:
    return bool(loop.node.od["Diagnosis.Latched"].value >> watchdog & 1)


def reset_fault(loop: Loop) -> int:
    assert loop.line.write(loop.node, "Controlword", 0) == 0
    return loop.line.write(loop.node, "Controlword", RESET_FAULT)


def test_start_run_does_not_hide_what_is_still_wrong() -> None:
    loop = Loop(AMPLITUDE_RESONANCE)
    loop.break_plate(FaultKind.STUCK, THERMOMETER)
    loop.cycle(110)
    assert latched(loop, Watchdog.STUCK)
    assert loop.line.write(loop.node, "Simulation.Start run", 1) == 0
    for _ in range(20):
        assert reset_fault(loop) == STATE
        loop.cycle()
    loop.break_plate(FaultKind.NONE)
    loop.cycle(20)
    assert reset_fault(loop) == 0


def test_the_gauges_are_not_tared_while_armed_or_running() -> None:
    loop = Loop(AMPLITUDE_RESONANCE)
    for state, word in ((State.RUNNING, 3), (State.ARMED, 1)):
        assert loop.line.write(loop.node, "Controlword", word) == 0
        assert loop.state is state
        assert loop.line.write(loop.node, "AI auto-zero.AI auto-zero normal force", ZERO) == STATE
    assert loop.line.write(loop.node, "Controlword", 0) == 0
    assert loop.line.write(loop.node, "AI auto-zero.AI auto-zero normal force", ZERO) == 0


def test_a_force_above_its_limit_is_not_tared_away() -> None:
    loop = Loop(AMPLITUDE_RESONANCE)
    loop.limit("Normal force", 100)
    loop.cycle(100)
    assert latched(loop, Watchdog.NORMAL_FORCE)
    assert loop.line.write(loop.node, "AI auto-zero.AI auto-zero normal force", ZERO) == STATE
    loop.cycle()
    assert reset_fault(loop) == STATE


def test_a_heartbeat_that_was_lost_before_a_reset_can_be_reset() -> None:
    loop = Loop()
    loop.heartbeat = False
    loop.cycle(40)
    assert latched(loop, Watchdog.HEARTBEAT)
    assert reset_fault(loop) == STATE
    loop.line.nmt(RESET_COMMUNICATION, 0x20)
    loop.line.nmt(START, 0x20)
    loop.cycle(20)
    assert reset_fault(loop) == 0


def test_a_setpoint_that_is_waited_for_no_more_can_be_reset() -> None:
    loop = Loop()
    loop.setpoints = False
    loop.cycle(20)
    assert latched(loop, Watchdog.SETPOINT)
    assert reset_fault(loop) == STATE
    assert loop.line.write_data(loop.node, loop.node.od.entry(0x1401, 5), bytes(2)) == 0
    assert reset_fault(loop) == 0


def test_rewriting_a_watch_does_not_end_it() -> None:
    loop = Loop()
    watch = struct.pack("<HBB", 50, MASTER, 0)
    assert loop.line.write_data(loop.node, loop.node.od.entry(0x1016, 1), watch) == 0
    loop.heartbeat = False
    loop.cycle(51)
    assert latched(loop, Watchdog.HEARTBEAT)
    assert loop.voltage == 0


def test_rewriting_a_deadline_does_not_end_it() -> None:
    loop = Loop()
    deadline = loop.node.od.entry(0x1401, 5)
    assert loop.line.write_data(loop.node, deadline, struct.pack("<H", 10)) == 0
    loop.setpoints = False
    loop.cycle(11)
    assert latched(loop, Watchdog.SETPOINT)
    assert loop.voltage == 0


def test_setpoints_outside_their_limits_are_none() -> None:
    loop = Loop()
    loop.setpoints = False
    for _ in range(SETPOINT_DEADLINE_MS + 1):
        loop.line.send(Frame(0x320, struct.pack("<HI", 0xFFFF, 4_339_000)))
        loop.cycle()
    assert latched(loop, Watchdog.SETPOINT)
    assert loop.voltage == 0


def test_a_period_that_disagrees_ends_the_drive_at_once() -> None:
    loop = Loop()
    period = loop.node.od.entry(0x1006)
    assert loop.line.write_data(loop.node, period, struct.pack("<I", 2000)) == 0
    loop.cycle(2)
    assert loop.voltage == 0
    assert latched(loop, Watchdog.MEASUREMENT)


def test_nobody_else_produces_the_sync_of_a_producer() -> None:
    plate = PlateNode(plate_od())
    node = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, produce_sync=True)
    line = Line(plate, node, lockstep=False)
    line.nmt(START)
    line.advance(100)
    assert line.write(node, "Setpoint.Voltage", 2000) == 0
    line.run(node, 1)
    line.advance(50)
    assert plate.od["Stage.Voltage"].value == 2000
    line.send(SYNC)
    assert plate.od["Stage.Voltage"].value == 0
    assert node.od["Diagnosis.Latched"].value == 1 << Watchdog.SYNC_IRREGULAR
    line.send(SYNC)
    assert line.write(node, "Controlword", 0) == 0
    assert line.write(node, "Controlword", RESET_FAULT) == STATE
    line.advance(20)
    assert line.write(node, "Controlword", 0) == 0
    assert line.write(node, "Controlword", RESET_FAULT) == 0
    line.run(node, 1)
    line.advance(50)
    assert plate.od["Stage.Voltage"].value == 2000


def test_a_loop_that_pauses_does_not_hide_a_lost_resonance() -> None:
    loop = Loop(AMPLITUDE_RESONANCE)
    loop.break_plate(FaultKind.RESONANCE_SHIFT, 1, -1500)
    for amplitude in (0, 1000) * 10:
        if loop.state is State.RUNNING:
            assert loop.line.write(loop.node, "Setpoint.Amplitude", amplitude) == 0
        loop.cycle(40)
    assert latched(loop, Watchdog.RESONANCE)
    assert loop.voltage == 0
