"""One source of each frame of the loop: second plates and stimulators, a stranger's frames."""

from __future__ import annotations

import pytest
from line import (
    DRIVE,
    EMCY_PLATE,
    EMCY_STIMULATOR,
    MEASUREMENT,
    RESET,
    RESET_COMMUNICATION,
    START,
    SYNC,
    Line,
    cycle,
    drive,
    driven_both,
    driven_plate,
    emergencies,
    ids,
    measurement,
    stage,
    stimulator_alone,
)

from smarttac_can.bench.simulation import PLATE_ID, plate_od, stimulator_od
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import State
from smarttac_can.vocabulary.watchdogs import COUNTED, Watchdog

STATE = 0x08000022
COLLISION = bytes.fromhex("50 81")
GONE_MS = 3000
OPEN_LOOP = 1
DOUBLE = 1 << Watchdog.DOUBLE


def stranger(line: Line, tick: int) -> list[Frame]:
    """Frames after a forged measurement, which the plate does not hear."""
    sent = []
    for frame in measurement(tick & 0xFF):
        sent += line.ports[1]._receive(frame) or []
    return sent


def told(line: Line, can_id: int) -> list[bytes]:
    return [frame.data for frame in line.frames if frame.can_id == can_id]


TWO = (
    "another node sends with an identifier of this one or of its plate: two have one node-ID; "
    "clear 3 s after the last such frame"
)


def test_two_plates_do_not_give_two_cycles_a_sync() -> None:
    first, second = (PlateNode(plate_od(), deadline_ms=3) for _ in range(2))
    node = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, lockstep=True, deadline_ms=3)
    line = Line(first, node)
    line.nmt(START)
    line.sync(10)
    line.bus.attach(second)
    line.nmt(START)
    before = node.od["Cycle.Cycles"].value
    line.sync(1000)
    assert node.od["Cycle.Cycles"].value - before <= 1001, "one may be ahead"
    assert node.od["Cycle.Surplus measurements"].value >= 990
    assert node.od["Diagnosis.Present"].value & DOUBLE
    assert line.write(node, "Controlword", 1) == STATE, "it cannot be armed"
    assert COLLISION in [data[:2] for data in told(line, EMCY_PLATE)]


def test_a_second_plate_ends_a_run_at_once() -> None:
    line, plate, node = driven_both()
    second = PlateNode(plate_od(), deadline_ms=3)
    line.bus.attach(second)
    assert stage(plate) == 0, "its boot-up message is enough"
    assert node.block.state is State.FAULT
    assert node.od["Diagnosis.Code"].value == 0x8150
    assert node.od["Message"].value == TWO
    line.nmt(START)
    for _ in range(50):
        line.sync()
        assert stage(plate) == stage(second) == 0


@pytest.mark.parametrize("deadline_ms", [3, 20])
def test_foreign_measurement_per_sync_faults_after_a_deadline(deadline_ms: int) -> None:
    line, _, node = driven_both(deadline_ms)
    cycles = node.od["Cycle.Cycles"].value
    for count in range(2 * deadline_ms + 1):
        if node.block.state is State.FAULT:
            break
        line.sync()
        assert (DRIVE in ids(stranger(line, count + 100))) == (count == 0), "one is ahead"
    assert node.block.state is State.FAULT
    assert deadline_ms < count <= 2 * deadline_ms
    assert node.od["Diagnosis.Latched"].value & DOUBLE
    assert node.od["Cycle.Cycles"].value - cycles == count + 1


@pytest.mark.parametrize("deadline_ms", [3, 20])
def test_surplus_after_unheard_syncs_is_no_fault(deadline_ms: int) -> None:
    line, _, node = driven_both(deadline_ms)
    node_port = line.ports[1]
    receive = node_port._receive
    for _ in range(3):
        # As many in a row as SYNC may be missed, in a window of its watch.
        for _ in range(deadline_ms - 1):
            node_port._receive = lambda frame: [] if frame.can_id == 0x80 else receive(frame)
            line.bus._link_ports()
            line.sync()
        node_port._receive = receive
        line.bus._link_ports()
        line.sync(2 * deadline_ms + 2)
        assert not node.od["Diagnosis.Latched"].value & DOUBLE
    assert node.od["Cycle.Surplus measurements"].value == 3 * (deadline_ms - 1) - 1


def test_a_measurement_that_overtakes_its_sync_is_answered() -> None:
    line, node = stimulator_alone()
    line.nmt(START)
    line.send(SYNC, *measurement(255))
    for tick in range(300):
        assert DRIVE in ids(line.send(*measurement(tick & 0xFF)))
        line.send(SYNC)
    assert node.od["Cycle.Surplus measurements"].value == 0
    assert node.od["Diagnosis.Present"].value & DOUBLE == 0


OWN = {"drive": drive(0, 0), "heartbeat": Frame(0x720, b"\5")}


@pytest.mark.parametrize("frame", OWN.values(), ids=OWN)
def test_a_frame_with_an_identifier_of_the_stimulator_ends_a_run(frame: Frame) -> None:
    line, plate, node = driven_both()
    line.send(frame)
    assert node.block.state is State.FAULT
    assert stage(plate) == 0
    (emcy,) = told(line, EMCY_STIMULATOR)[-1:]
    assert emcy[:4] == COLLISION + bytes((0x11, Watchdog.DOUBLE))


PLATES = {"TPDO": Frame(MEASUREMENT[1], bytes(8)), "heartbeat": Frame(0x721, b"\5")}


@pytest.mark.parametrize("frame", PLATES.values(), ids=PLATES)
def test_a_plate_that_is_not_alone_is_at_0_v_and_barred(frame: Frame) -> None:
    line, plate = driven_plate()
    assert line.send(frame) == [Frame(EMCY_PLATE, COLLISION + bytes((0x11, 0, 0, 0, 0, 0)))]
    for volts in (20, 0, 20):
        assert cycle(line, plate, volts) == 0


def test_3_s_after_the_last_such_frame_0_v_frees_the_plate() -> None:
    line, plate = driven_plate()
    line.send(PLATES["heartbeat"])
    for _ in range(GONE_MS - 1):
        # The last 0 V has freed it, but for the other.
        assert cycle(line, plate, 20) == 0
        line.send(drive(0, 99))
    assert emergencies(line)[-1] == 0x8150, "it is not taken back before"
    assert cycle(line, plate, 0) == 0
    assert emergencies(line)[-1] == 0
    assert cycle(line, plate, 20) == 20


@pytest.mark.parametrize("reset", [RESET, RESET_COMMUNICATION])
def test_reset_forgets_the_double_reported_by_the_plate(reset: int) -> None:
    line, node = stimulator_alone()
    line.nmt(START)
    line.send(Frame(EMCY_PLATE, COLLISION + bytes((0x11, 0, 0, 0, 0, 0))))
    assert node.od["Diagnosis.Present"].value & DOUBLE
    line.nmt(reset)
    assert not node.od["Diagnosis.Present"].value & DOUBLE


def test_two_stimulators_of_one_node_id_cannot_drive() -> None:
    line, plate, node = driven_both()
    second = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, lockstep=True, deadline_ms=3)
    line.bus.attach(second)
    line.nmt(START)
    for _ in range(100):
        line.sync()
        assert stage(plate) == 0
    for each in (node, second):
        assert each.od["Diagnosis.Present"].value & DOUBLE


def test_two_stimulators_at_one_plate_cannot_drive() -> None:
    line, plate, node = driven_both()
    second = StimulatorNode(stimulator_od(40), plate_node_id=PLATE_ID, lockstep=True, deadline_ms=3)
    line.bus.attach(second)
    line.nmt(START)
    line.sync()
    assert stage(plate) == 0
    assert node.block.state is State.FAULT


def test_level_of_doubles_rises_with_surplus_measurements() -> None:
    line, _, node = driven_both()
    while node.levels()[COUNTED.index(Watchdog.DOUBLE)]:
        line.sync()
    levels = []
    for _ in range(3):
        stranger(line, 100)
        levels.append(node.levels()[COUNTED.index(Watchdog.DOUBLE)])
    assert levels == pytest.approx([0.0, 1 / 3, 2 / 3]), "one answer may be ahead of its SYNC"
