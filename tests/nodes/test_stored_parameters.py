from pathlib import Path

import pytest
from click.testing import CliRunner

from smarttac_can.cli import main
from smarttac_can.device.storage import Memory
from smarttac_can.host.files import read_eds
from smarttac_can.master import requests
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.eds import load_eds
from smarttac_can.vocabulary.states import VibrationLaw

SAVE = int.from_bytes(b"save", "little")


def stimulator(memory: Memory, *, plate_node_id: int = 0) -> StimulatorNode:
    od = load_eds(read_eds("stimulator.eds"), 0x20)
    inside = None if plate_node_id else PlateBlock(load_eds(read_eds("plate.eds"), 0x21))
    return StimulatorNode(od, inside, plate_node_id=plate_node_id, storage=memory)


def save(node: StimulatorNode | PlateNode, node_id: int) -> None:
    (answer,) = node.receive(requests.download(node_id, node.od.entry(0x1010, 1), SAVE))
    assert answer.data[0] == 0x60


def test_controller_parameters_are_kept() -> None:
    memory = Memory()
    node = stimulator(memory)
    node.start()
    node.od["Controller.Amplitude pole"].value = 300
    node.od["Setpoint.Amplitude"].value = 1000
    save(node, 0x20)
    again = stimulator(memory)
    again.start()
    assert again.od["Controller.Amplitude pole"].value == 300
    assert again.od["Setpoint.Amplitude"].value == 0, "a set-point is no parameter"


def test_the_law_of_the_vibration_and_the_load_are_kept() -> None:
    memory = Memory()
    node = stimulator(memory)
    node.start()
    node.od["Controller.Vibration law"].value = 2
    node.od["Model.Load"].value = 1040
    node.od["Model.Temperature"].value = 3000
    save(node, 0x20)
    again = stimulator(memory)
    again.start()
    assert again.block.cascade.parameters.vibration_law is VibrationLaw.PREDICTIVE
    assert again.block.cascade.model.load == pytest.approx(1.04)
    assert again.block.cascade.model.temperature == pytest.approx(30.0)


def test_links_to_a_plate_node_end_with_the_plate_node() -> None:
    memory = Memory()
    linked = stimulator(memory, plate_node_id=0x21)
    linked.start()
    save(linked, 0x20)
    alone, fresh = stimulator(memory), stimulator(Memory())
    assert alone.start() == fresh.start()
    assert [e.read() for e in alone.od] == [e.read() for e in fresh.od]


def test_command_line_wins_over_what_is_stored() -> None:
    memory = Memory()
    od = load_eds(read_eds("plate.eds"), 0x21)
    node = PlateNode(od, {"Simulation.Seed": 7}, storage=memory)
    node.start()
    save(node, 0x21)
    assert PlateNode(od, {"Simulation.Seed": 8}, storage=memory).start()
    assert od["Simulation.Seed"].value == 8
    assert PlateNode(od, storage=memory).start()
    assert od["Simulation.Seed"].value == 1, "the preset of another run is not stored"


def test_storage_in_a_place_that_is_not_there(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["plate", "--storage", str(tmp_path / "no" / "file")])
    assert result.exit_code == 2
    assert "is no directory" in result.output


def test_a_master_may_write_back_the_simulation_of_a_plate_that_is_elsewhere() -> None:
    node = stimulator(Memory(), plate_node_id=0x21)
    node.start()
    speed = node.od["Finger.Speed"]
    for raw, command in ((speed.value, 0x60), (speed.value + 1, 0x80)):
        (answer,) = node.receive(requests.download(0x20, speed, raw))
        assert answer.data[0] == command
