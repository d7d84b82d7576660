"""What was stored by 1010h, and the options of the finger at the next start."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from smarttac_can.cli import main, nodes
from smarttac_can.master import requests
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.plant.finger import Stroke

NAMES = ("Finger.Motion", "Finger.Speed", "Simulation.Subject", "Simulation.Seed")
SAVE = int.from_bytes(b"save", "little")
Node = PlateNode | StimulatorNode


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Node]:
    """Nodes that the command would have run."""
    nodes_made: list[Node] = []
    monkeypatch.setattr(nodes, "run_in_process", lambda name, node, *rest: nodes_made.append(node))
    return nodes_made


def moves(node: Node) -> bool:
    """Whether the plate has a finger that strokes."""
    plate = node.block if isinstance(node, PlateNode) else node.block._inside.plate
    return isinstance(plate.plate._finger, Stroke)


@pytest.mark.parametrize("command", ["node", "plate"])
def test_stored_wins_over_the_default_of_an_option_but_not_over_one_given(
    command: str, made: list[Node], tmp_path: Path
) -> None:
    def started(*options: str) -> tuple[Node, list[int]]:
        arguments = [command, "--interface", "virtual", "--storage", str(tmp_path / "kept")]
        result = CliRunner().invoke(main, [*arguments, *options])
        assert result.exit_code == 0, result.output
        node = made.pop()
        node.start()
        return node, [node.od[name].value for name in NAMES]

    node, values = started()
    assert values == [1, 200, 1, 1]
    assert moves(node)
    for name, value in zip(NAMES, (0, 700, 3, 9), strict=True):
        node.od[name].value = value
    save = requests.download(node.device.node_id, node.od.entry(0x1010, 1), SAVE)
    (answer,) = node.receive(save)
    assert answer.data[0] == 0x60
    node, values = started()
    assert values == [0, 700, 3, 9]
    assert not moves(node)
    assert started("--subject", "1", "--seed", "1")[1] == [0, 700, 1, 1]
    assert started("--finger", "stroke")[1] == [1, 700, 3, 9]
    assert started()[1] == [0, 700, 3, 9]
