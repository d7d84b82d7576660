"""Parameters that were stored, at the next power-on of a node."""

import pytest
from line import START, Line

from smarttac_can.bench.simulation import PLATE_ID, plate_od, stimulator_od
from smarttac_can.canopen.device.storage import Image, Memory, pack_image
from smarttac_can.canopen.master import requests
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import VibrationLaw

SAVE = int.from_bytes(b"save", "little")


def stimulator(memory: Memory, *, plate_node_id: int = 0) -> StimulatorNode:
    inside = None if plate_node_id else PlateBlock(plate_od())
    return StimulatorNode(stimulator_od(), inside, plate_node_id=plate_node_id, storage=memory)


def save(node: StimulatorNode | PlateNode, node_id: int) -> None:
    (answer,) = node.receive(requests.download(node_id, node.od.entry(0x1010, 1), SAVE))
    assert answer.data[0] == 0x60


def test_parameters_are_kept_and_in_force_and_a_setpoint_is_none() -> None:
    memory = Memory()
    node = stimulator(memory)
    node.start()
    kept = {
        "Controller.Amplitude pole": 300,
        "Controller.Vibration law": 2,
        "Model.Load": 1040,
        "Model.Temperature": 3000,
    }
    for name, raw in {**kept, "Setpoint.Amplitude": 1000}.items():
        node.od[name].value = raw
    save(node, 0x20)
    again = stimulator(memory)
    again.start()
    assert {name: again.od[name].value for name in kept} == kept
    assert again.od["Setpoint.Amplitude"].value == 0
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


def test_command_line_option_wins_over_stored_value() -> None:
    memory = Memory()
    od = plate_od()
    node = PlateNode(od, {"Simulation.Seed": 7}, storage=memory)
    node.start()
    save(node, 0x21)
    assert PlateNode(od, {"Simulation.Seed": 8}, storage=memory).start()
    assert od["Simulation.Seed"].value == 8
    assert PlateNode(od, storage=memory).start()
    assert od["Simulation.Seed"].value == 1, "the preset of another run is not stored"


def test_contradicting_stored_settings_become_defaults() -> None:
    od = stimulator_od()
    memory = Memory()
    identity = (od.number(0x1018, 1), od.number(0x1018, 2), od.number(0x1018, 3))
    crossed = {(0x2041, 3): (4_500_000), (0x2041, 4): 4_200_000}
    values = {address: raw.to_bytes(4, "little") for address, raw in crossed.items()}
    memory.write(pack_image(identity, Image(values=values)))
    node = StimulatorNode(od, plate_node_id=PLATE_ID, lockstep=True, storage=memory)
    line = Line(PlateNode(plate_od()), node)
    assert od["Limit.Lowest frequency"].value == od["Limit.Lowest frequency"].default
    sent = [frame.data[:2] for frame in line.frames if frame.can_id == 0xA0]
    assert sent == [(0x5530).to_bytes(2, "little")]
    line.nmt(START)
    line.sync(70)
    line.run(line.nodes[1], 1)
