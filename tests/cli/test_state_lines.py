"""What a node says of its states, in this process."""

import pytest

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.cli.process import StateLines
from smarttac_can.device.frame import Frame
from smarttac_can.device.storage import Memory
from smarttac_can.master import requests
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import State


class Spoken:
    """A node whose state is followed after each frame and each step of time."""

    def __init__(self, name: str, node: PlateNode | StimulatorNode, said: list[str]) -> None:
        self._node = node
        self._lines = StateLines(name, "here", node, said.append)
        node.start()
        self._lines.started()

    def receive(self, frame: Frame) -> None:
        self._node.receive(frame)
        self._lines.follow()

    def advance(self, microseconds: int) -> None:
        self._node.advance(microseconds)
        self._lines.follow()


def test_a_line_names_the_double_and_another_its_end() -> None:
    said: list[str] = []
    node = Spoken("plate", PlateNode(plate_od()), said)
    said.clear()
    for _ in range(3):
        node.receive(Frame(0x721, b"\5"))
    assert said == ["plate 33 another node sends with an identifier of this one, 721h"]
    node.advance(3_000_000)
    assert said[1:] == ["plate 33 alone again with its identifiers"]


def test_of_two_producers_of_sync_one_is_enough() -> None:
    said: list[str] = []
    stimulator = StimulatorNode(stimulator_od(), plate_node_id=33, produce_sync=True)
    node = Spoken("node", stimulator, said)
    said.clear()
    node.receive(Frame(0x080))
    assert said[0].endswith(" this one, 080h: one producer of SYNC is enough")


@pytest.mark.parametrize(
    ("stored", "said"),
    [
        (b"garbage", ["plate 33 has its defaults: the --storage is torn, or of another device"]),
        (None, []),
    ],
)
def test_a_storage_that_is_none_is_named(stored: bytes | None, said: list[str]) -> None:
    storage = Memory()
    if stored is not None:
        storage.write(stored)
    lines: list[str] = []
    Spoken("plate", PlateNode(plate_od(), storage=storage), lines)
    assert lines == [*said, "plate 33 ready on here"]


def test_lines_say_why_nothing_arms_and_what_ended_a_run() -> None:
    said: list[str] = []
    stimulator = StimulatorNode(stimulator_od(), PlateBlock(plate_od()))
    node = Spoken("stimulator", stimulator, said)
    node.receive(Frame(0, b"\1\0"))
    for _ in range(80):
        node.advance(1000)
    controlword = stimulator.od["Controlword"]
    said.clear()
    for word in (0, 1):
        node.receive(requests.download(0x20, controlword, word))
    assert said == [
        "stimulator 32 not armed, as nobody would be missed: enter your heartbeat in Consumer "
        "heartbeat time and send it, or set Drive unwatched to 1"
    ]
    stimulator.od["Drive unwatched"].value = 1
    for word in (0, 1):
        node.receive(requests.download(0x20, controlword, word))
    assert stimulator.block.state is State.ARMED
    assert stimulator.od["Message"].value == ""
    supervisor = stimulator.block.supervisor
    supervisor.plan = supervisor.plan._replace(temperature_max=0.0)
    node.advance(1000)
    assert said[1:] == ["stimulator 32 fault 4210h: the plate is too hot"]


def test_a_double_that_is_noticed_after_what_it_has_led_to_is_named() -> None:
    said: list[str] = []
    stimulator = StimulatorNode(
        stimulator_od(), plate_node_id=33, lockstep=True, presets={"Tare at power-on": 0}
    )
    node = Spoken("stimulator", stimulator, said)
    node.receive(Frame(0, b"\1\0"))
    supervisor = stimulator.block.supervisor
    supervisor.machine.state = State.RUNNING
    said.clear()
    node.receive(Frame(0xA1, bytes((0x53, 0x82, 0x11, 0, 0, 0, 0, 0))))
    assert said == [
        "stimulator 32 fault 8253h: the plate went to 0 V by itself: its drives were late"
    ]
    node.receive(Frame(0xA1, bytes((0x50, 0x81, 0x11, 0, 0, 0, 0, 0))))
    assert said[1:] == [
        "stimulator 32 fault 8150h: another node sends with an identifier of this one or of its "
        "plate: two have one node-ID, give one of them another by LSS or --node-id; clear 3 s "
        "after the last such frame"
    ]
