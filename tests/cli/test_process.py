"""The pace of a node's process: options that are refused, and what follows from a refusal."""

import pytest
from click.testing import CliRunner

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.cli import main, process
from smarttac_can.cli.nodes import Pace, StateLines
from smarttac_can.cli.shared import BusChoice
from smarttac_can.device.frame import Frame
from smarttac_can.device.storage import Memory
from smarttac_can.master import requests
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.states import State

VIRTUAL = ("--interface", "virtual", "--channel", "pace")
CURES = ["real time: one thing is refused", "real time: another is refused"]
SLEEPY = "real time: processors sleep"


@pytest.mark.parametrize("command", ["node", "plate"])
@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("--realtime 0", "0 is not in the range 1<=x<=99"),
        ("--realtime 100", "100 is not in the range 1<=x<=99"),
        ("--realtime x", "'x' is not a valid integer"),
        ("--cpu 0", "--cpu is for --realtime PRIORITY: none is given"),
        ("--cpu 0 --lockstep", "--cpu is for --realtime PRIORITY: none is given"),
        ("--realtime 10 --cpu -1", "-1 is not in the range x>=0"),
        ("--realtime 10 --lockstep", "--realtime follows the clock, --lockstep does not"),
        ("--realtime 10 --lockstep --cpu 0", "--realtime follows the clock, --lockstep does not"),
    ],
)
def test_usage_errors(
    command: str, options: str, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("asked for, or run")

    monkeypatch.setattr(process, "request_real_time", refuse)
    monkeypatch.setattr("smarttac_can.cli.nodes.run_in_process", refuse)
    result = CliRunner().invoke(main, [command, *VIRTUAL, *options.split()])
    assert result.exit_code == 2
    assert result.stdout == ""
    *usage, line = result.stderr.splitlines()
    assert line.startswith("Error: ")
    assert says in line
    assert [words.split()[0] for words in usage if words] == ["Usage:", "Try"]


def test_lockstep_is_the_only_pace_of_a_device_without_a_loop() -> None:
    result = CliRunner().invoke(main, ["device", *VIRTUAL, "--realtime", "10"])
    assert result.exit_code == 2
    assert "No such option" in result.stderr


@pytest.mark.parametrize("refused", [[], CURES[:1], CURES])
@pytest.mark.parametrize("command", ["node --plate-node 33", "plate"])
@pytest.mark.parametrize("sleepy", [[], [SLEEPY]])
def test_what_is_refused_is_said_and_the_deadline_stays_that_of_the_eds(
    command: str, refused: list[str], sleepy: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, int | None] | str] = []
    deadlines: list[list[int]] = []

    def request(priority: int, cpu: int | None) -> list[str]:
        asked.append((priority, cpu))
        return refused

    def keep_awake() -> list[str]:
        asked.append("awake")
        return sleepy

    def run(name: str, node: object, *_: object) -> None:
        entries = node.block.deadline._entries if name == "stimulator" else [node._deadline]
        deadlines.append([entry.value for entry in entries])

    monkeypatch.setattr(process, "request_real_time", request)
    monkeypatch.setattr(process, "keep_processors_awake", keep_awake)
    monkeypatch.setattr(process, "SHORT_DEADLINE_MS", 7)
    monkeypatch.setattr("smarttac_can.cli.nodes.run_in_process", run)
    for options in ("", "--realtime 42", "--realtime 42 --cpu 1", "--lockstep"):
        result = CliRunner().invoke(main, [*command.split(), *VIRTUAL, *options.split()])
        assert (result.exit_code, result.stdout) == (0, "")
        said = (refused or sleepy) if "--realtime" in options else []
        assert result.stderr.splitlines() == said
    awake = [] if refused else ["awake"]
    assert asked == [(42, None), *awake, (42, 1), *awake]
    ordinary, *real_time, lockstep = deadlines
    assert set(lockstep) == {7}
    assert 7 not in ordinary
    assert real_time == [ordinary if refused else lockstep] * 2


def test_pace_of_an_ordinary_process_asks_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(process, "request_real_time")
    monkeypatch.delattr(process, "keep_processors_awake")
    assert Pace().begin() is None
    assert Pace(lockstep=True).begin() == 3


@pytest.mark.parametrize(
    ("interface", "channel", "where"),
    [
        ("udp_multicast", "239.74.163.2", "udp_multicast:239.74.163.2"),
        ("udp_multicast", None, "udp_multicast"),
        (None, None, "the bus of python-can's configuration"),
    ],
)
def test_what_a_bus_is_called(interface: str | None, channel: str | None, where: str) -> None:
    assert BusChoice(interface, channel, None, {}).where == where


# What a node says of its states, in this process.


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
