"""The faults of a simulated plate as objects: on a plate node, and with the plate inside."""

import pytest
from line import START, Line, both_nodes, drive, plate_inside, ready_plate

from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.faults import FaultKind

Node = PlateNode | StimulatorNode


def break_it(line: Line, node: Node, kind: int, sensor: int, value: int, delay: int = 0) -> int:
    for name, raw in (("Sensor", sensor), ("Value", value), ("Delay in cycles", delay)):
        assert line.write(node, f"Fault.{name}", raw) == 0
    return line.write(node, "Fault.Kind", kind)


@pytest.fixture
def running() -> tuple[Line, PlateNode]:
    line, plate = ready_plate()
    line.sync(19)
    return line, plate


def gauge(plate: PlateNode, number: int) -> int:
    return int(plate.od[f"Gauge.S{number}"].value)


def test_fault_waits_for_its_delay(running: tuple[Line, PlateNode]) -> None:
    line, plate = running
    before = gauge(plate, 1)
    assert break_it(line, plate, FaultKind.DEAD, 1, 0, delay=3) == 0
    line.sync(3)
    assert gauge(plate, 1) == pytest.approx(before, abs=300) and gauge(plate, 1) != 0
    line.sync()
    assert gauge(plate, 1) == 0


@pytest.mark.parametrize("way", ["kind 0", "start run"])
def test_fault_is_cleared(running: tuple[Line, PlateNode], way: str) -> None:
    line, plate = running
    break_it(line, plate, FaultKind.SATURATED, 2, 0)
    line.sync()
    assert plate.od["Vibration.Saturation"].value == 2
    if way == "kind 0":
        line.write(plate, "Fault.Kind", 0)
    else:
        line.write(plate, "Simulation.Start run", 1)
        assert line.read(plate, "Fault.Kind") == 0
    line.sync()
    assert plate.od["Vibration.Saturation"].value == 0


def test_start_run_forgets_a_fault_that_waits(running: tuple[Line, PlateNode]) -> None:
    line, plate = running
    break_it(line, plate, FaultKind.DEAD, 1, 0, delay=5)
    line.write(plate, "Simulation.Start run", 1)
    line.sync(10)
    assert gauge(plate, 1) != 0


def test_value_that_makes_no_sense_for_the_kind_is_refused(
    running: tuple[Line, PlateNode],
) -> None:
    line, plate = running
    assert break_it(line, plate, FaultKind.QUALITY, 1, 0) == 0x0609_0030
    assert line.read(plate, "Fault.Kind") == 0


def test_plate_inside_breaks_the_same_way() -> None:
    line, node = plate_inside()
    line.nmt(START)
    line.advance(10)
    assert break_it(line, node, FaultKind.SATURATED, 5, 0) == 0
    line.advance(1)
    assert node.od["Plate input.Saturation"].value == 1 << 4
    line.write(node, "Simulation.Start run", 1)
    assert line.read(node, "Fault.Kind") == 0
    line.advance(1)
    assert node.od["Plate input.Saturation"].value == 0


def test_stimulator_without_the_plate_inside_refuses() -> None:
    line, _, stimulator = both_nodes()
    assert line.write(stimulator, "Fault.Kind", FaultKind.DEAD) == 0x0800_0022


def asked(plate: PlateNode, voltage: int) -> int:
    """What the stage puts out when the controller asks for a voltage in this tick."""
    plate.receive(drive(voltage, plate.od["Vibration.Tick"].value))
    return int(plate.od["Stage.Voltage"].read())


def test_stage_that_does_not_obey_is_barred_until_0_v(running: tuple[Line, PlateNode]) -> None:
    line, plate = running
    assert asked(plate, 2000) == 2000
    break_it(line, plate, FaultKind.STAGE_STUCK, 1, 0)
    line.sync()
    assert asked(plate, 2050) == 2000, "within the tolerance it cannot be told from a sound one"
    line.sync()
    assert asked(plate, 500) == 0
    assert line.read(plate, "Stage.Voltage") == 0
    assert plate.od.entry(0x1003, 1).value & 0xFFFF == 0x3311
    line.sync()
    assert asked(plate, 2000) == 0
    line.write(plate, "Fault.Kind", 0)
    line.sync()
    assert asked(plate, 0) == 0
    line.sync()
    assert asked(plate, 700) == 700


def test_stage_gets_stuck_at_another_voltage(running: tuple[Line, PlateNode]) -> None:
    line, plate = running
    assert asked(plate, 2000) == 2000
    break_it(line, plate, FaultKind.STAGE_STUCK, 1, 6000)
    line.sync()
    assert plate.od["Stage.Voltage"].read() == 6000
