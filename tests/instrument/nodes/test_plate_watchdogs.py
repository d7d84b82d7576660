"""The plate by itself: 0 V in time, whatever its controller does."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from line import (
    DRIVE,
    RESET_COMMUNICATION,
    START,
    Line,
    cycle,
    drive,
    driven_plate,
    emergencies,
    ready_plate,
    stage,
    tick_of,
)

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od.cia import EmergencyCode
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.vocabulary.faults import FaultCode


def assert_barred_until_0_v(line: Line, plate: PlateNode) -> None:
    asked = (20, 20, 20, 20, 20, 0, 20)
    assert [cycle(line, plate, volts) for volts in asked] == [0, 0, 0, 0, 0, 0, 20]
    assert emergencies(line)[-1] == 0


def test_plate_without_drives() -> None:
    line, plate = driven_plate()
    line.sync(3)
    assert stage(plate) == 0
    assert emergencies(line) == [EmergencyCode.RPDO_TIME_OUT, FaultCode.DRIVE_LOST]
    assert_barred_until_0_v(line, plate)


def test_plate_whose_measurements_are_not_answered_in_time() -> None:
    line, plate = driven_plate()
    for count in range(3):
        line.sync()
        assert (stage(plate) == 0) == (count == 2)
        line.send(drive(2000, tick_of(plate) - 1 & 0xFF))
    assert emergencies(line) == [FaultCode.DRIVE_LOST]
    assert_barred_until_0_v(line, plate)


def test_plate_asked_for_more_than_its_limit() -> None:
    line, plate = driven_plate()
    assert cycle(line, plate, 150) == 150
    assert cycle(line, plate, 150.01) == 0
    assert emergencies(line) == [FaultCode.VOLTAGE]
    assert plate.od["Error register"].value & 4
    assert_barred_until_0_v(line, plate)


def test_a_plate_that_was_reset_says_again_that_it_waits_for_0_v() -> None:
    line, plate = driven_plate()
    cycle(line, plate, 150.01)
    line.nmt(RESET_COMMUNICATION)
    line.nmt(START)
    line.sync()
    assert emergencies(line) == [FaultCode.VOLTAGE, FaultCode.DRIVE_LOST]


def test_plate_too_hot() -> None:
    line, plate = driven_plate()
    assert line.write(plate, "Limit.Temperature", 1500) == 0
    line.sync()
    assert stage(plate) == 0
    for _ in range(5):
        line.sync()
        # 0 V of any tick frees it, but for the heat.
        line.send(drive(0, 99), drive(2000, tick_of(plate)))
        assert stage(plate) == 0
    assert emergencies(line) == [FaultCode.TEMPERATURE], "once"
    assert line.write(plate, "Limit.Temperature", 7000) == 0
    assert [cycle(line, plate, volts) for volts in (0, 20)] == [0, 20]
    assert emergencies(line)[-1] == 0


def test_a_first_drive_above_the_limit_bars_as_well() -> None:
    line, plate = ready_plate()
    line.send(drive(15_001, tick_of(plate)))
    assert_barred_until_0_v(line, plate)


@pytest.mark.parametrize(
    ("begun", "meanwhile", "after", "codes"),
    [
        (ready_plate, 20, 0, [FaultCode.TEMPERATURE]),
        (driven_plate, 20, 0, [FaultCode.TEMPERATURE]),
        (driven_plate, 0, 20, [FaultCode.TEMPERATURE, 0]),
    ],
)
def test_plate_cooling_down_waits_for_0_v_taken_even_while_hot(
    begun: Callable[[], tuple[Line, PlateNode]], meanwhile: int, after: int, codes: list[int]
) -> None:
    line, plate = begun()
    line.write(plate, "Limit.Temperature", 1500)
    cycle(line, plate, meanwhile)
    line.write(plate, "Limit.Temperature", 7000)
    assert cycle(line, plate, 20) == after
    assert emergencies(line) == codes


@pytest.mark.parametrize("kind", ["corrupt", "out of range", "of an old tick"])
def test_plate_without_sync_takes_no_drive_as_a_sign_of_life(kind: str) -> None:
    line, plate = driven_plate()
    frame = {
        "corrupt": Frame(DRIVE, bytes(8)),
        "out of range": Frame(DRIVE, b"\xff" * 8),
        "of an old tick": drive(2000, tick_of(plate) - 1 & 0xFF),
    }[kind]
    for _ in range(3):
        plate.advance(1000)
        line.send(frame)
    assert stage(plate) == 0
