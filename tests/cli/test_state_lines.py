"""What a node says of its states, in this process."""

from smarttac_can.bench.simulation import plate_od
from smarttac_can.cli.state_lines import StateLines
from smarttac_can.device.frame import Frame
from smarttac_can.nodes.plate_node import PlateNode


def test_a_line_names_the_double_and_another_its_end() -> None:
    said: list[str] = []
    node = StateLines("plate", "here", PlateNode(plate_od()), said.append)
    node.start()
    said.clear()
    for _ in range(3):
        node.receive(Frame(0x721, b"\5"))
    assert said == ["plate 33 another node sends with an identifier of this one, 721h"]
    node.advance(3_000_000)
    assert said[1:] == ["plate 33 alone again with its identifiers"]
