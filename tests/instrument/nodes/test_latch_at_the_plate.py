"""A plate takes drives of the stimulator it works with, and none while that is in FAULT."""

from __future__ import annotations

from line import (
    PREOP,
    RESET_COMMUNICATION,
    START,
    Line,
    both_nodes,
    cycle,
    drive,
    driven_both,
    driven_plate,
    plate_alone,
    stage,
    tick_of,
)

from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import State

OPEN_LOOP = 1


def in_fault() -> tuple[Line, PlateNode, StimulatorNode]:
    """Both nodes after 20 V: the stimulator is in FAULT."""
    line, plate, node = driven_both()
    assert line.write(node, "Limit.Temperature", 1500) == 0
    line.sync()
    assert node.block.state is State.FAULT
    assert line.write(node, "Limit.Temperature", 6000) == 0
    return line, plate, node


def test_plate_takes_no_drive_in_fault_and_pre_operational() -> None:
    line, plate, node = in_fault()
    line.nmt(PREOP, STIMULATOR_ID)
    for sender in range(1, 128):
        if sender == STIMULATOR_ID:
            continue
        for _ in range(10):
            line.sync()
            now = tick_of(plate)
            line.send(drive(0, now - 9 & 0xFF, source=sender))
            line.send(drive(15_000, now, source=sender))
            assert stage(plate) == 0
    assert node.block.state is State.FAULT


def test_0_v_in_fault_does_not_free_the_plate_and_the_reset_does() -> None:
    line, plate, node = in_fault()
    for _ in range(20):
        line.sync()
        assert plate.block.inhibited
        plate.receive(drive(15_000, tick_of(plate)))
        assert stage(plate) == 0
    assert line.write(node, "Controlword", 0) == 0
    assert line.write(node, "Controlword", 0x80) == 0
    assert not plate.block.inhibited, "told at once"
    line.run(node, OPEN_LOOP)
    line.sync()
    assert stage(plate) == 2000


def test_first_drive_of_0_v_names_the_stimulator_until_a_reset() -> None:
    line, plate = plate_alone()
    line.nmt(START)
    line.sync()
    line.send(drive(2000, 0, source=40), drive(0, 99, source=40), drive(2000, 0, source=40))
    assert stage(plate) == 2000
    line.sync()
    line.send(drive(1000, 1, source=32))
    assert stage(plate) == 2000, "another one's is none"
    for session, command, voltage in ((1, PREOP, 0), (2, RESET_COMMUNICATION, 1000)):
        line.nmt(command)
        line.nmt(START)
        line.sync()
        now = tick_of(plate)
        line.send(drive(0, 99, session=session), drive(1000, now, session=session))
        assert stage(plate) == voltage


def test_reset_plate_is_driven_again_whatever_was_sent_meanwhile() -> None:
    line, plate, node = in_fault()
    line.sync(5)
    line.nmt(RESET_COMMUNICATION, PLATE_ID)
    line.nmt(START, PLATE_ID)
    # 0 V at once, with the check of the session before: the next one is not known yet.
    assert line.write(node, "Controlword", 0) == 0
    assert line.write(node, "Controlword", 0x80) == 0
    line.sync(10)
    line.run(node, OPEN_LOOP)
    line.sync(3)
    assert stage(plate) == 2000


def test_three_wrong_checks_bar_and_one_in_21_cycles_does_not() -> None:
    line, plate = driven_plate()
    strange = drive(15_000, 0, source=40)
    for at in range(84):
        assert cycle(line, plate, 20, *[strange] * (at % 21 == 0)) == 20
    assert plate.od["Cycle.Corrupt drives"].value == 4
    for _ in range(3):
        assert stage(plate) == 2000
        cycle(line, plate, 20)
        line.send(strange)
    assert stage(plate) == 0
    line.sync()
    assert line.frames[-4].data[:2] == bytes.fromhex("53 82"), "8253h"
    line.send(*[strange] * 4)
    cycles = 0
    while not stage(plate):
        line.send(drive(0, 0), drive(2000, tick_of(plate)))
        cycles += 1
        line.sync()
    assert cycles == 23, "that of the wrong ones, 21 without one, and that of the drive"


def test_a_stimulator_follows_the_session_of_its_plate() -> None:
    line, plate, node = both_nodes()
    line.nmt(START)
    line.sync(70)
    for _ in range(3):
        line.nmt(PREOP, PLATE_ID)
        line.nmt(START, PLATE_ID)
        line.sync(30)
    assert plate.block.session == 3
    assert line.write(node, "Setpoint.Voltage", 2000) == 0
    line.run(node, OPEN_LOOP)
    line.sync(3)
    assert stage(plate) == 2000
