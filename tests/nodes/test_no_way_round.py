"""There is no way round a fault, or into a drive, but the one that is meant."""

import struct

import pytest
from line import PREOP, RESET_COMMUNICATION, START, SYNC, Line
from loop import AMPLITUDE_RESONANCE, MASTER, SETPOINT_DEADLINE_MS, Loop

from smarttac_can.bench.open_link import PLATE_ID, plate_od, stimulator_od
from smarttac_can.device.frame import Frame
from smarttac_can.device.storage import Memory
from smarttac_can.device.stored_image import Image, pack_image
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
    assert loop.line.write_entry(loop.node, loop.node.od.entry(0x1401, 5), 0) == 0
    assert reset_fault(loop) == 0


@pytest.mark.parametrize(
    ("index", "subindex", "raw", "silent", "watchdog", "cycles"),
    [
        (0x1016, 1, MASTER << 16 | 50, "heartbeat", Watchdog.HEARTBEAT, 51),
        (0x1401, 5, 10, "setpoints", Watchdog.SETPOINT, 11),
    ],
    ids=["heartbeat", "set-points"],
)
def test_rewriting_a_watch_does_not_end_it(
    index: int, subindex: int, raw: int, silent: str, watchdog: Watchdog, cycles: int
) -> None:
    loop = Loop()
    assert loop.line.write_entry(loop.node, loop.node.od.entry(index, subindex), raw) == 0
    setattr(loop, silent, False)
    loop.cycle(cycles)
    assert latched(loop, watchdog)
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
    assert loop.line.write_entry(loop.node, period, 2000) == 0
    loop.cycle(2)
    assert loop.voltage == 0
    assert latched(loop, Watchdog.MEASUREMENT)


def test_nobody_else_produces_the_sync_of_a_producer() -> None:
    plate = PlateNode(plate_od(), deadline_ms=3)
    node = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, produce_sync=True, deadline_ms=3)
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


PRESSED = ("Gauge zero.Zero of S3", "Calibration.Fx from S1", "Calibration.Position of S3")


@pytest.mark.parametrize("name", PRESSED)
def test_zeros_and_calibration_do_not_change_under_a_drive_or_hide_a_force(name: str) -> None:
    loop = Loop(AMPLITUDE_RESONANCE)
    raw = loop.node.od[name].value
    assert loop.line.write(loop.node, name, raw + 1) == STATE
    assert loop.line.write(loop.node, name, raw) == 0, "what was read may be written back"
    loop.limit("Normal force", 100)
    loop.cycle(100)
    assert latched(loop, Watchdog.NORMAL_FORCE)
    assert loop.line.write(loop.node, name, raw + 1) == STATE
    loop.limit("Normal force", 4000)
    loop.cycle(10)
    assert reset_fault(loop) == 0
    assert loop.line.write(loop.node, name, raw + 1) == 0


def test_a_calibration_that_hides_forces_is_none() -> None:
    loop = Loop()
    assert loop.line.write(loop.node, "Controlword", 0) == 0
    for lateral in ("Fx from S1", "Fy from S1"):
        assert loop.line.write(loop.node, f"Calibration.{lateral}", 0) == 0
    loop.cycle(2)
    assert loop.node.od["Diagnosis.Present"].value == 1 << Watchdog.CALIBRATION
    assert loop.line.write(loop.node, "Controlword", 1) == STATE


def test_the_tare_at_power_on_does_not_come_while_armed() -> None:
    loop = Loop(AMPLITUDE_RESONANCE)
    names = [f"Gauge zero.Zero of S{number}" for number in range(1, 7)]
    zeros = [loop.node.od[name].value for name in names]
    assert loop.line.write(loop.node, "Controlword", 0) == 0
    for name in names:
        assert loop.line.write(loop.node, name, 0) == 0
    assert loop.line.write(loop.node, "Simulation.Start run", 1) == 0
    for name, zero in zip(names, zeros, strict=True):
        assert loop.line.write(loop.node, name, zero) == 0
    loop.cycle(3)
    loop.line.run(loop.node, AMPLITUDE_RESONANCE)
    loop.cycle(100)
    assert loop.state is State.RUNNING
    assert [loop.node.od[name].value for name in names] == zeros


@pytest.mark.parametrize("rpdo", [0x1404, 0x1405, 0x1406])
@pytest.mark.parametrize("running", [True, False])
def test_a_measurement_pdo_that_is_disabled_ends_the_drive(rpdo: int, running: bool) -> None:
    loop = Loop()
    # Without its own deadline the plate would go on.
    assert loop.line.write_entry(loop.plate, loop.plate.od.entry(0x1400, 5), 100) == 0
    if not running:
        assert loop.line.write(loop.node, "Controlword", 0) == 0
    entry = loop.node.od.entry(rpdo, 1)
    assert loop.line.write_entry(loop.node, entry, entry.value | 1 << 31) == 0
    loop.cycle(4)
    assert loop.voltage == 0
    assert latched(loop, Watchdog.MEASUREMENT) == running
    assert loop.state is (State.FAULT if running else State.NOT_READY)


def test_a_standing_controlword_is_not_obeyed_after_another_pdo() -> None:
    loop = Loop()
    loop.line.nmt(PREOP, 0x20)
    loop.cycle(5)
    loop.line.nmt(START, 0x20)
    loop.cycle(5)
    assert loop.state is State.FAULT
    for _ in range(5):
        loop.line.send(Frame(0x220, bytes((RESET_FAULT, 0, 1))))
        loop.cycle()
    assert loop.state is State.FAULT, "it stood there before"


def test_a_node_that_is_watched_twice_is_found_once() -> None:
    loop = Loop()
    loop.node.on_error_control(5, True)
    loop.node.on_error_control(5, True)
    loop.node.on_error_control(5, False)
    assert reset_fault(loop) == 0


def test_sync_of_another_is_right_again_when_the_node_produces_none() -> None:
    loop = Loop()
    for index, raw in ((0x1006, 0), (0x1019, 0), (0x1006, 1000)):
        for node in (loop.node, loop.plate):
            assert loop.line.write_entry(node, node.od.entry(index), raw) == 0
    producer = loop.node.od.entry(0x1005)
    loop.syncs = 0
    assert loop.line.write_entry(loop.node, producer, 0x4000_0080) == 0
    loop.line.advance(20)
    assert loop.line.write_entry(loop.node, producer, 0x80) == 0
    for _ in range(20):
        loop.line.advance(1)
        loop.line.send(SYNC, Frame(0x701, b"\5"), Frame(0x320, struct.pack("<HI", 2000, 4_339_000)))
    assert loop.node.od["Diagnosis.Present"].value == 0
    assert reset_fault(loop) == 0


def test_stored_settings_that_contradict_each_other_are_defaults_again() -> None:
    od = stimulator_od()
    memory = Memory()
    identity = (od.number(0x1018, 1), od.number(0x1018, 2), od.number(0x1018, 3))
    crossed = {(0x2041, 3): (4_500_000), (0x2041, 4): 4_200_000}
    values = {address: raw.to_bytes(4, "little") for address, raw in crossed.items()}
    memory.write(pack_image(identity, Image(values=values)))
    line = Line(PlateNode(plate_od()), StimulatorNode(od, plate_node_id=PLATE_ID, storage=memory))
    assert od["Limit.Lowest frequency"].value == od["Limit.Lowest frequency"].default
    sent = [frame.data[:2] for frame in line.frames if frame.can_id == 0xA0]
    assert sent == [(0x5530).to_bytes(2, "little")]
    line.nmt(START)
    line.sync(70)
    line.run(line.nodes[1], 1)
