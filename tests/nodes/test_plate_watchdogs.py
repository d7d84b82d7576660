"""The plate by itself: 0 V in time, whatever its controller does."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from line import DRIVE, PREOP, RESET_COMMUNICATION, START, Line, drive, ready_plate

from smarttac_can.device.frame import Frame
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.od.cia import EmergencyCode
from smarttac_can.vocabulary.faults import FaultCode


def driven_plate() -> tuple[Line, PlateNode]:
    line, plate = ready_plate()
    line.send(drive(2000, 0))
    assert plate.od["Stage.Voltage"].read() == 2000
    return line, plate


def tick_of(plate: PlateNode) -> int:
    return int(plate.od["Vibration.Tick"].value)


def emergencies(line: Line) -> list[int]:
    return [
        int.from_bytes(frame.data[:2], "little") for frame in line.frames if frame.can_id == 0xA1
    ]


def assert_barred_until_0_v(line: Line, plate: PlateNode) -> None:
    for _ in range(5):
        line.sync()
        line.send(drive(2000, tick_of(plate)))
        assert plate.od["Stage.Voltage"].read() == 0
    line.send(drive(0, tick_of(plate)))
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    assert plate.od["Stage.Voltage"].read() == 2000
    assert emergencies(line)[-1] == 0


def test_plate_without_drives() -> None:
    line, plate = driven_plate()
    line.sync(3)
    assert plate.od["Stage.Voltage"].read() == 0
    assert emergencies(line) == [EmergencyCode.RPDO_TIME_OUT, FaultCode.DRIVE_LOST]
    assert_barred_until_0_v(line, plate)


def test_plate_without_drives_and_without_sync() -> None:
    line, plate = driven_plate()
    line.advance(3)
    assert plate.od["Stage.Voltage"].read() == 0


def test_plate_whose_measurements_are_not_answered_in_time() -> None:
    line, plate = driven_plate()
    for count in range(3):
        line.sync()
        assert (plate.od["Stage.Voltage"].read() == 0) == (count == 2)
        line.send(drive(2000, tick_of(plate) - 1 & 0xFF))
    assert emergencies(line) == [FaultCode.DRIVE_LOST]
    assert_barred_until_0_v(line, plate)


def test_plate_asked_for_more_than_its_limit() -> None:
    line, plate = driven_plate()
    line.sync()
    line.send(drive(15_000, 1))
    assert plate.od["Stage.Voltage"].read() == 15_000
    line.sync()
    line.send(drive(15_001, 2))
    assert plate.od["Stage.Voltage"].read() == 0
    assert emergencies(line) == [FaultCode.VOLTAGE]
    assert plate.od["Error register"].value & 4
    assert_barred_until_0_v(line, plate)


def test_a_plate_that_was_reset_says_again_that_it_waits_for_0_v() -> None:
    line, plate = driven_plate()
    line.sync()
    line.send(drive(15_001, tick_of(plate)))
    line.nmt(RESET_COMMUNICATION)
    line.nmt(START)
    line.sync()
    assert emergencies(line) == [FaultCode.VOLTAGE, FaultCode.DRIVE_LOST]


def test_plate_too_hot() -> None:
    line, plate = driven_plate()
    assert line.write(plate, "Limit.Temperature", 1500) == 0
    line.sync()
    assert plate.od["Stage.Voltage"].read() == 0
    for _ in range(5):
        line.sync()
        # 0 V of any tick frees it, but for the heat.
        line.send(drive(0, 99), drive(2000, tick_of(plate)))
        assert plate.od["Stage.Voltage"].read() == 0
    assert emergencies(line) == [FaultCode.TEMPERATURE], "once"
    assert line.write(plate, "Limit.Temperature", 7000) == 0
    line.sync()
    line.send(drive(0, tick_of(plate)))
    assert_barred_after_reset(line, plate)


def assert_barred_after_reset(line: Line, plate: PlateNode) -> None:
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    assert plate.od["Stage.Voltage"].read() == 2000
    assert emergencies(line)[-1] == 0


def test_plate_that_left_operational_waits_for_0_v() -> None:
    line, plate = driven_plate()
    line.nmt(PREOP)
    assert plate.od["Stage.Voltage"].read() == 0
    line.nmt(START)
    line.sync()
    line.send(drive(2000, tick_of(plate), session=1))
    assert plate.od["Stage.Voltage"].read() == 0


@pytest.mark.parametrize(("name", "cap"), [("Voltage", 20_000), ("Temperature", 8000)])
def test_no_write_passes_a_hard_cap_of_the_plate(name: str, cap: int) -> None:
    line, plate = driven_plate()
    assert line.write(plate, f"Limit.{name}", cap + 1) == 0x06090031


def test_plate_keeps_its_deadline() -> None:
    line, plate = driven_plate()
    deadline = plate.od.entry(0x1400, 5)
    assert line.write_entry(plate, deadline, 101) == 0x06090031
    assert deadline.value == 3
    assert line.write_entry(plate, deadline, 0) == 0
    plate.advance(1000)
    assert plate.od["Stage.Voltage"].read() == 0, "no deadline is no drive"


def test_a_first_drive_above_the_limit_bars_as_well() -> None:
    line, plate = ready_plate()
    line.send(drive(15_001, tick_of(plate)))
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    assert plate.od["Stage.Voltage"].read() == 0
    assert_barred_until_0_v(line, plate)


@pytest.mark.parametrize(
    ("begun", "meanwhile", "after", "codes"),
    [
        (ready_plate, 2000, 0, [FaultCode.TEMPERATURE]),
        (driven_plate, 2000, 0, [FaultCode.TEMPERATURE]),
        (driven_plate, 0, 2000, [FaultCode.TEMPERATURE, 0]),
    ],
)
def test_a_plate_that_cools_down_waits_for_0_v_which_may_come_while_it_is_hot(
    begun: Callable[[], tuple[Line, PlateNode]], meanwhile: int, after: int, codes: list[int]
) -> None:
    line, plate = begun()
    line.write(plate, "Limit.Temperature", 1500)
    line.sync()
    line.send(drive(meanwhile, tick_of(plate)))
    line.write(plate, "Limit.Temperature", 7000)
    line.sync()
    line.send(drive(2000, tick_of(plate)))
    assert plate.od["Stage.Voltage"].read() == after
    assert emergencies(line) == codes


@pytest.mark.parametrize("kind", ["corrupt", "out of range", "of an old tick"])
def test_plate_without_sync_is_not_fed_by_drives_that_do_not_count(kind: str) -> None:
    line, plate = driven_plate()
    frame = {
        "corrupt": Frame(DRIVE, bytes(8)),
        "out of range": Frame(DRIVE, b"\xff" * 8),
        "of an old tick": drive(2000, tick_of(plate) - 1 & 0xFF),
    }[kind]
    for _ in range(3):
        plate.advance(1000)
        line.send(frame)
    assert plate.od["Stage.Voltage"].read() == 0
