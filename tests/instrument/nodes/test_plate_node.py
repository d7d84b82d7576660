"""The plate node: drives, states and the objects of the simulation."""

import struct

import pytest
from line import (
    EMCY_PLATE,
    MEASUREMENT,
    PREOP,
    RESET,
    RESET_COMMUNICATION,
    START,
    STOP,
    cycle,
    drive,
    driven_plate,
    ids,
    plate_alone,
    ready_plate,
    stage,
)

from smarttac_can.bench.simulation import PLATE_ID
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.instrument.nodes.plate_block import SimulatedPlate
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.science.plant.finger import Trajectory
from smarttac_can.vocabulary.watchdogs import PLATE_COUNTED

STATE = 0x08000022


def test_stage_is_told_with_each_sync_once_it_is_asked_for() -> None:
    line, plate = ready_plate()
    told = 0x480 + PLATE_ID
    assert told not in ids(line.sync(3))
    assert line.write_entry(plate, plate.od.entry(0x1803, 1), told) == 0
    line.send(drive(2000, 3, 4_339_001))
    assert ids(frames := line.sync(2)) == [*MEASUREMENT, told] * 2
    assert frames[3] == Frame(told, struct.pack("<HI", 2000, 4_339_001))
    assert line.write_entry(plate, plate.od.entry(0x1803, 1), told | 1 << 31) == 0
    assert told not in ids(line.sync(2))


def test_stage_that_is_not_asked_for_has_nothing_to_do_at_a_sync() -> None:
    _, plate = ready_plate()
    assert [tpdo.can_id for tpdo in plate.device._pdos._sampling] == [*MEASUREMENT]


@pytest.mark.parametrize("command", [STOP, PREOP, RESET, RESET_COMMUNICATION])
def test_leaving_operational_is_0_v_until_told_0_v(command: int) -> None:
    line, plate = driven_plate()
    line.sync()
    line.nmt(command)
    assert stage(plate) == 0
    line.nmt(START)
    for _ in range(20):
        assert cycle(line, plate, 20) == 0
    # At 0 V the vibration has died down: noise of the pick-up is left.
    assert abs(plate.od["Vibration.W_d"].value) < 100
    assert [cycle(line, plate, volts) for volts in (0, 20)] == [0, 20]


@pytest.mark.parametrize("begin", ["power-on", "start run"])
def test_the_first_drive_is_0_v(begin: str) -> None:
    line, plate = driven_plate()
    if begin == "power-on":
        line, plate = plate_alone()
        line.nmt(START)
    else:
        assert line.write(plate, "Simulation.Start run", 1) == 0
    for tick in range(5):
        assert EMCY_PLATE not in ids(line.sync()), "nothing was lost"
        line.send(drive(2000, tick))
        assert stage(plate) == 0
    assert [cycle(line, plate, volts) for volts in (0, 20)] == [0, 20]


def test_a_period_that_disagrees_is_0_v() -> None:
    line, plate = driven_plate()
    period = plate.od.entry(0x1006)
    assert line.write_entry(plate, period, 2000) == STATE, "not under a drive"
    period.value = 2000
    line.sync()
    assert stage(plate) == 0


@pytest.mark.parametrize("behaviour", [0, 1, 2])
def test_a_lost_heartbeat_is_0_v_whatever_the_error_behaviour(behaviour: int) -> None:
    line, plate = ready_plate()
    assert line.write_entry(plate, plate.od.entry(0x1029, 1), behaviour) == 0
    assert line.write_entry(plate, plate.od.entry(0x1016, 1), 5 << 16 | 10) == 0
    line.send(Frame(0x705, b"\x05"))
    for tick in range(10):
        line.send(drive(2000, tick))
        assert stage(plate) == 2000
        line.sync()
    line.send(drive(2000, 10))
    assert stage(plate) == 0


@pytest.mark.parametrize("instant_us", [0, 500, 999])
def test_0_v_of_the_plate_itself_waits_for_no_dead_time(instant_us: int) -> None:
    """The vibration has decayed for a whole tick by the next one: to exp(-1/tau), near a third."""
    line, plate = plate_alone()
    assert line.write(plate, "Simulation.Drive instant", instant_us) == 0
    assert line.write(plate, "Simulation.Start run", 1) == 0
    line.nmt(START)
    line.sync()
    line.send(drive(0, 0))
    for tick in range(1, 20):
        line.sync()
        line.send(drive(2000, tick))
    line.sync()
    behind = plate.block.backend
    assert isinstance(behind, SimulatedPlate)
    before = abs(behind.plate.W)
    assert before > 0.5e-6
    plate.transmit_failed()
    line.sync()
    assert 0.25 < abs(behind.plate.W) / before < 0.40


def test_shutdown_is_0_v() -> None:
    _, plate = driven_plate()
    assert plate.shutdown() == []
    assert stage(plate) == 0


def test_a_full_transmit_queue_is_0_v_until_told_0_v() -> None:
    line, plate = ready_plate()
    report = Frame(EMCY_PLATE, struct.pack("<HB5x", 0x8253, 0x11))
    for reports in ([], [report]):
        assert plate.transmit_failed() == reports, "at rest it is nothing to report"
        assert plate.transmit_failed() == []
        assert stage(plate) == 0
        assert [cycle(line, plate, volts) for volts in (20, 0, 20)] == [0, 0, 20]


@pytest.mark.parametrize("silent", [2, 100])
def test_plate_at_0_v_gets_0_v_again_after_silence(silent: int) -> None:
    line, plate = ready_plate()
    line.send(drive(0, 0))
    line.sync(silent)
    line.send(drive(2000, silent & 0xFF))
    assert stage(plate) == (2000 if silent < 3 else 0)


@pytest.mark.parametrize(
    ("instant", "after", "late"), [(540, 540, 0), (540, 541, 1), (540, 999, 1), (0, 999, 0)]
)
def test_a_drive_after_its_instant_is_counted(instant: int, after: int, late: int) -> None:
    line, plate = plate_alone()
    assert line.write(plate, "Simulation.Drive instant", instant) == 0
    assert line.write(plate, "Simulation.Start run", 1) == 0
    line.nmt(START)
    line.sync()
    line.send(drive(0, 0))
    line.sync()
    plate.advance(after)
    # The second answers a tick that was answered, and is none.
    for _ in range(2):
        line.send(drive(2000, 1))
        assert (stage(plate), plate.od["Cycle.Late drives"].value) == (2000, late)
    # One that is late by a cycle is late by any instant.
    line.sync()
    line.sync()
    line.send(drive(2001, 2))
    assert stage(plate) == 2001
    assert plate.od["Cycle.Late drives"].value == late + (instant > 0)
    assert line.write(plate, "Simulation.Start run", 1) == 0
    assert plate.od["Cycle.Late drives"].value == 0


@pytest.mark.parametrize("tick", [255, 99])
def test_before_the_first_tick_of_a_run_no_drive_is_late(tick: int) -> None:
    line, plate = plate_alone(presets={"Simulation.Drive instant": 540})
    line.nmt(START)
    plate.advance(541)
    line.send(drive(0, tick))
    assert plate.od["Cycle.Late drives"].value == 0
    line.sync()
    plate.advance(541)
    assert line.write(plate, "Simulation.Start run", 1) == 0
    line.send(drive(0, tick))
    assert plate.od["Cycle.Late drives"].value == 0


def test_the_instant_is_that_of_the_run() -> None:
    line, plate = ready_plate()
    assert line.write(plate, "Simulation.Drive instant", 100) == 0
    line.sync()
    plate.advance(900)
    line.send(drive(2000, 1))
    assert plate.od["Cycle.Late drives"].value == 0


def test_drives_outside_the_limits_are_refused() -> None:
    line, plate = ready_plate()
    protocol_error = [Frame(EMCY_PLATE, bytes.fromhex("00 82 11 01 00 00 20 01"))]
    assert line.send(drive(20_001, 0)) == protocol_error
    assert stage(plate) == 0
    assert plate.od["Drive.Voltage"].value == 0


def test_start_run_begins_anew_with_the_simulation_as_written() -> None:
    line, plate = ready_plate()
    first = [frame for frame in line.sync(20) if frame.can_id in MEASUREMENT]
    line.send(drive(2000, 20))
    assert line.write(plate, "Simulation.Start run", 1) == 0
    assert stage(plate) == 0
    assert plate.od["Cycle.Ticks"].value == 0
    line.sync()
    again = line.sync(20)
    assert [frame for frame in again if frame.can_id in MEASUREMENT] == first
    assert line.write(plate, "Simulation.Seed", 2) == 0
    assert line.write(plate, "Simulation.Start run", 1) == 0
    line.sync()
    assert line.sync(20) != first


def test_sdo_between_the_ticks_changes_nothing() -> None:
    def sent(*, disturbed: bool) -> list[Frame]:
        line, plate = ready_plate()
        measured = []
        for tick in range(60):
            line.send(drive(2000, tick))
            if disturbed:
                line.read(plate, "Vibration.W_d")
                line.write(plate, "Simulation.Seed", tick)
                line.write(plate, "Finger.Motion", 1)
            measured += line.sync()
        return measured

    assert sent(disturbed=True) == sent(disturbed=False)


def test_recorded_finger() -> None:
    finger = Trajectory([(0.0, 0.0, 0.8), (1.0, 0.0, 0.8)])
    line, plate = plate_alone(presets={"Finger.Motion": 2}, recording=finger)
    line.nmt(START)
    line.sync(100)
    pressed = sum(plate.od[f"Gauge.S{n}"].value for n in (3, 4, 5, 6))
    assert line.write(plate, "Finger.Motion", 0) == 0
    assert line.write(plate, "Simulation.Start run", 1) == 0
    line.sync(100)
    lifted = sum(plate.od[f"Gauge.S{n}"].value for n in (3, 4, 5, 6))
    assert 7000 < pressed - lifted < 9000, "0.8 N in 0.1 mN"


def test_reset_restores_defaults_and_presets() -> None:
    line, plate = plate_alone(presets={"Simulation.Seed": 9})
    line.nmt(START)
    for name, raw in (("Simulation.Seed", 5), ("Simulation.Subject", 4)):
        assert line.write(plate, name, raw) == 0
    assert ids(line.nmt(RESET)) == [0x721]
    assert plate.od["Simulation.Seed"].value == 9
    assert plate.od["Simulation.Subject"].value == 1


def levels(plate: PlateNode) -> dict[str, float]:
    return dict(zip(PLATE_COUNTED, plate.levels(), strict=True))


def test_levels_of_a_drive_without_a_deadline() -> None:
    """With 1400h sub-index 5 at 0 a drive is in force for no time at all."""
    line, plate = ready_plate()
    assert line.write_entry(plate, plate.od.entry(0x1400, 5), 0) == 0
    line.send(drive(2000, 0))
    assert levels(plate)["deadline"] == 1.0
    line.sync()
    assert stage(plate) == 0
    assert levels(plate)["deadline"] == 0.0


def test_each_level_of_the_plate_is_that_of_its_watch() -> None:
    line, plate = driven_plate()
    for name in ("Voltage", "Temperature"):
        assert line.write(plate, f"Limit.{name}", 2100) == 0
    strange = drive(2000, 0, source=40)
    assert cycle(line, plate, 20, strange, strange) == 20
    assert levels(plate) == {
        "deadline": pytest.approx(1 / 3),
        "wrong checks": pytest.approx(2 / 3),
        "temperature": pytest.approx(20 / 21, rel=0.01),
        "voltage": pytest.approx(20 / 21),
    }
    line.sync()
    assert levels(plate)["deadline"] == pytest.approx(2 / 3)
