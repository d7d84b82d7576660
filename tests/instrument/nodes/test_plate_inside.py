"""The stimulator node with the simulated plate inside: its own ticker is the loop's clock."""

import struct

import pytest
from line import (
    DRIVE,
    PUBLIC,
    RESET,
    RESET_COMMUNICATION,
    START,
    SYNC,
    Line,
    ids,
    measurement,
    plate_inside,
    ready_inside,
)

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import State

OFF, AMPLITUDE, FRICTION = 0, 2, 4
STATE = 0x08000022


def driving(mode: int = AMPLITUDE) -> tuple[Line, StimulatorNode]:
    line, node = ready_inside()
    assert line.write(node, "Setpoint.Amplitude", 1000) == 0
    line.run(node, mode)
    line.advance(20)
    assert node.od["Drive.Voltage"].value > 1000
    assert abs(node.od["Vibration.Amplitude"].read() - 10_000) < 200
    return line, node


def test_a_master_that_only_starts_it_sees_forces_and_a_cof() -> None:
    line, node = plate_inside(Finger__Motion=1, Finger__Speed=200)
    line.nmt(START)
    frames = line.advance(1000)
    assert [ids(frames).count(can_id) for can_id in PUBLIC[1:]] == [10, 10, 10]
    contact = [frame.data for frame in frames if frame.can_id == PUBLIC[1]][-1]
    Ft, Fn, cof, _ = struct.unpack("<HHHH", contact)
    assert 400 < Fn < 600
    assert abs(cof / 1e4 - Ft / Fn) < 0.01
    assert 0.3 < cof / 1e4 < 0.5, "subject 1 without vibration"
    assert node.od["Cycle.Cycles"].value == 1000


@pytest.mark.parametrize(("transmission", "period_ms"), [(1, 1), (1, 7), (3, 10), (240, 1)])
def test_public_sync_times_the_public_pdos_and_not_the_loop(
    transmission: int, period_ms: int
) -> None:
    line, node = plate_inside()
    for number in range(3):
        kind = node.od.entry(0x1801 + number, 2)
        assert line.write_entry(node, kind, transmission) == 0
    line.nmt(START)
    count = 2 * transmission + 1
    sent = []
    for _ in range(count):
        assert set(ids(line.advance(period_ms))) <= {PUBLIC[0], 0x720}
        sent.append(ids(line.send(SYNC)))
    turns = [[*PUBLIC[1:]] if k % transmission == 0 else [] for k in range(1, count + 1)]
    assert sent == turns
    assert node.od["Cycle.Cycles"].value == count * period_ms


def test_any_cycle_period_is_as_good_as_any() -> None:
    line, node = plate_inside()
    assert line.write_entry(node, node.od.entry(0x1006), 20_000) == 0
    line.nmt(START)
    assert 0xA0 not in ids(line.advance(50) + line.sync(5) + line.advance(50))
    assert node.od["Cycle.Cycles"].value == 100


def test_shutdown_is_0_v() -> None:
    _, node = driving()
    *_, vibration = said = node.shutdown()
    assert ids(said) == [*PUBLIC]
    assert struct.unpack_from("<H", vibration.data) == (0,), "the voltage"
    assert node.od["Drive.Voltage"].value == node.od["Mode"].value == 0


def test_reset_restores_defaults_presets_and_the_plate() -> None:
    line, node = plate_inside(Simulation__Seed=9, Finger__Motion=1)

    def begin() -> list[Frame]:
        line.nmt(START)
        return line.advance(300)

    first = begin()
    for name, raw in (
        ("Simulation.Seed", 5),
        ("Simulation.Subject", 3),
        ("Finger.Force", 900),
        ("Controller.Amplitude pole", 500),
        ("Setpoint.Amplitude", 700),
    ):
        assert line.write(node, name, raw) == 0
        assert line.read(node, name) == raw
    assert line.nmt(RESET) == [Frame(0x720, b"\0")]
    assert line.read(node, "Simulation.Seed") == 9
    assert line.read(node, "Simulation.Subject") == 1
    assert line.read(node, "Controller.Amplitude pole") == 200
    assert line.read(node, "Setpoint.Amplitude") == 0
    assert begin() == first, "the plate starts anew as well"


def test_plate_inside_starts_with_values_of_the_objects() -> None:
    od, plate = stimulator_od(), PlateBlock(plate_od())
    od["Simulation.Subject"].default = 4
    StimulatorNode(od, plate).start()
    assert plate.od["Simulation.Subject"].value == 4


def test_reset_communication_keeps_the_application() -> None:
    line, node = plate_inside()
    assert line.write(node, "Setpoint.Amplitude", 700) == 0
    assert line.write_entry(node, node.od.entry(0x1801, 2), 1) == 0
    line.nmt(RESET_COMMUNICATION)
    assert line.read(node, "Setpoint.Amplitude") == 700
    assert node.od.entry(0x1801, 2).value == 255


def test_a_simulated_finger_by_sdo() -> None:
    line, node = ready_inside()
    assert line.write(node, "Finger.Motion", 2) == STATE, "there is no recording"
    for name, raw in (("Finger.Motion", 1), ("Finger.Force", 800), ("Simulation.Subject", 4)):
        assert line.write(node, name, raw) == 0
    assert node.od["Contact.Touching"].value == 0, "from the next run on"
    assert line.write(node, "Simulation.Start run", 1) == 0
    line.advance(500)
    assert abs(line.read(node, "Contact.Normal force") - 800) < 80


def test_a_late_call_has_one_cycle_and_keeps_the_phase() -> None:
    line, node = plate_inside()
    node.advance(7400)
    assert line.read(node, "Cycle.Cycles") == 1
    assert line.read(node, "Cycle.Missed deadlines") == 6
    node.advance(599)
    assert line.read(node, "Cycle.Cycles") == 1
    node.advance(1)
    assert line.read(node, "Cycle.Cycles") == 2


def test_sdo_between_the_ticks_changes_nothing() -> None:
    def recorded(*, disturbed: bool) -> list[tuple[int, ...]]:
        line, node = driving()
        rows = []
        for k in range(100):
            if disturbed:
                line.read(node, "Contact.COF")
                line.write(node, "Simulation.Seed", k)
                line.write(node, "Setpoint.Amplitude", 1000)
                line.write(node, "Limit.Lowest frequency", 4_450_000)
            line.advance(1)
            rows.append(tuple(entry.read() for entry in node.od if entry.name.startswith("Vib")))
        return rows

    assert recorded(disturbed=True) == recorded(disturbed=False)


def test_lockstep_or_by_the_clock_the_plate_does_the_same() -> None:
    def vibration(*, lockstep: bool) -> list[int]:
        line, node = plate_inside(lockstep=lockstep, Finger__Motion=1)
        line.nmt(START)
        line.write(node, "Setpoint.Amplitude", 1000)
        values = []
        for tick in range(270):
            if tick == 70:
                line.run(node, FRICTION)
            if lockstep:
                line.sync()
            else:
                line.advance(1)
            values.append(node.od["Vibration.W_d"].read())
        return values

    assert vibration(lockstep=True) == vibration(lockstep=False)


def test_frames_of_a_plate_node_are_no_measurements() -> None:
    line, node = driving()
    line.write(node, "Controlword", 0)
    for number, frame in zip((5, 6, 7), measurement(0), strict=True):
        cob_id = node.od.entry(0x1400 + number - 1, 1)
        assert line.write_entry(node, cob_id, frame.can_id) == 0
    line.run(node, AMPLITUDE)
    cycles = node.od["Cycle.Cycles"].value
    for tick in range(10):
        first, second, last = measurement(tick)
        line.send(SYNC, first, second, last, first, last)
    assert node.block.state is State.RUNNING
    assert node.od["Cycle.Cycles"].value == cycles
    assert node.od["Cycle.Lost cycles"].value == 0
    assert node.od["Cycle.Surplus measurements"].value == 0


def test_a_change_of_state_sends_no_drive() -> None:
    line, node = driving()
    assert line.write(node, "Controlword", 0) == 0
    assert line.write_entry(node, node.od.entry(0x1804, 1), DRIVE) == 0
    line.run(node, AMPLITUDE)
    line.advance(5)
    assert line.write(node, "Controlword", 0) == 0
    assert PUBLIC[0] in ids(line.frames)
    assert DRIVE not in ids(line.frames)
