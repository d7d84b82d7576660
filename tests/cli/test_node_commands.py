"""Commands that run a node: refusals, lines, pace, stored values, and a finger."""

from pathlib import Path

import pytest
from commands import refusal, run, succeed
from nodes_on_a_bus import NodeProcess, multicast_options
from rich_eds import RICH, RICH_EDS

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.canopen.bus.bus import QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.storage import Memory
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.cli import nodes
from smarttac_can.cli.nodes import Pace, StateLines, read_finger
from smarttac_can.cli.shared import BusChoice, load_own
from smarttac_can.host.files import read_eds
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.science.plant.finger import Stroke
from smarttac_can.vocabulary.states import State

# Refusals of ``smarttac node`` and ``smarttac plate``: one line on stderr and no traceback.


VIRTUAL = ("--interface", "virtual", "--channel", "refusals")


@pytest.mark.parametrize("command", ["node", "plate"])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--interface", "nonsense"), "cannot open the nonsense bus"),
        ((*VIRTUAL, "--finger", "missing.csv"), "'missing.csv' is neither none, stroke nor a file"),
        ((*VIRTUAL, "--bus-option", "port"), "'port' is not KEY=VALUE"),
        ((*VIRTUAL, "--bus-option", "=1"), "'=1' is not KEY=VALUE"),
        (
            (*VIRTUAL, "--bus-option", "prot=1"),
            "--bus-option: virtual has no option 'prot'; perhaps 'protocol'",
        ),
        ((*VIRTUAL, "--bus-option", "channel=x"), "has an option of its own"),
        ((*VIRTUAL, "--cpu", "0"), "--cpu needs --realtime PRIORITY"),
        ((*VIRTUAL, "--cpu", "0", "--lockstep"), "--cpu needs --realtime PRIORITY"),
        (
            (*VIRTUAL, "--realtime", "10", "--cpu", "0", "--lockstep"),
            "--realtime runs by the clock, --lockstep by SYNC",
        ),
    ],
)
def test_bad_options(
    command: str, arguments: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(nodes, "request_real_time")
    assert message in refusal(command, *arguments, code=None)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--produce-sync",), "--produce-sync needs --plate-node"),
        (("--produce-sync", "--lockstep", "--plate-node", "33"), "leave out --produce-sync"),
        (("--plate-node", "33", "--finger", "none"), "--finger is for the plate inside"),
        (("--plate-node", "33", "--subject", "1"), "--subject is for the plate inside"),
        (("--plate-node", "33", "--seed", "1"), "--seed is for the plate inside"),
    ],
)
def test_options_that_contradict_each_other(arguments: tuple[str, ...], message: str) -> None:
    assert message in refusal("node", *VIRTUAL, *arguments, code=2)


@pytest.mark.parametrize("command", ["node", "status", "replay"])
def test_a_plate_is_another_node_than_its_stimulator(command: str, tmp_path: Path) -> None:
    options = VIRTUAL
    if command == "replay":
        (log := tmp_path / "run.log").touch()
        options = (str(log),)
    line = refusal(command, *options, "--plate-node", "32", code=2)
    assert line == "--plate-node 32 is the --node-id of the stimulator"


def test_broken_eds(tmp_path: Path) -> None:
    path = tmp_path / "broken.eds"
    path.write_text("this is no EDS\n")
    told = f"{path}: the file has no objects"
    assert refusal("node", *VIRTUAL, "--eds", path) == told
    assert refusal("device", *VIRTUAL, "--eds", path) == told
    assert refusal("conform", *VIRTUAL, "--eds", path, "--node-id", "5") == told
    path.write_bytes(bytes(range(256)))
    refusal("node", *VIRTUAL, "--eds", path)


def test_the_eds_of_another_device(tmp_path: Path) -> None:
    path = tmp_path / "other.eds"
    path.write_text(read_eds("plate.eds"))
    assert "is not in the EDS" in refusal("node", *VIRTUAL, "--eds", path)
    path.write_text(read_eds("stimulator.eds"))
    assert "is not in the EDS" in refusal("plate", *VIRTUAL, "--eds", path)


HIGHEST = "HighLimit=20000"


@pytest.mark.parametrize("command", ["node", "node --plate-node 33", "plate"])
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (HIGHEST, "HighLimit=50000", "Voltage has the HighLimit 500000 mV, outside the hard cap"),
        ("Voltage [10 mV]", "Tension [10 mV]", "Voltage' is not in the EDS"),
    ],
)
def test_an_eds_beyond_the_hard_caps(
    command: str, old: str, new: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "beyond.eds"
    text = read_eds("plate.eds" if command == "plate" else "stimulator.eds")
    assert old in text
    path.write_text(text.replace(old, new))
    # Above it may stand warnings of the file.
    said = run(*command.split(), *VIRTUAL, "--eds", path).stderr.splitlines()[-1]
    assert said.startswith(f"Error: {path} does not suit the device: ")
    assert message in said


def test_an_eds_whose_loop_carries_something_else(tmp_path: Path) -> None:
    path = tmp_path / "permuted.eds"
    text = read_eds("stimulator.eds")
    first, second = "DefaultValue=0x21000610", "DefaultValue=0x21000710"
    assert text.count(first) == text.count(second) == 1
    path.write_text(text.replace(first, "@").replace(second, first).replace("@", second))
    said = refusal("node", *VIRTUAL, "--eds", path)
    assert "Gauge.S1 and Plate input.S2 are mapped at the same place" in said
    head, section, tail = text.partition("[1606sub0]\n")
    path.write_text(head + section + tail.replace("DefaultValue=5", "DefaultValue=4", 1))
    said = refusal("node", *VIRTUAL, "--eds", path)
    assert "the PDOs of the loop carry different numbers of objects" in said


def test_an_eds_whose_defaults_contradict_each_other(tmp_path: Path) -> None:
    path = tmp_path / "contradiction.eds"
    text = read_eds("stimulator.eds")
    assert text.count("DefaultValue=4400000") == 1
    path.write_text(text.replace("DefaultValue=4400000", "DefaultValue=4260000"))
    assert "06090030" in refusal("node", *VIRTUAL, "--eds", path)


# Values stored by 1010h, and the options of the finger at the next start.


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
def test_stored_value_wins_over_option_default_not_over_option(
    command: str, made: list[Node], tmp_path: Path
) -> None:
    def started(*options: str) -> tuple[Node, list[int]]:
        succeed(command, "--interface", "virtual", "--storage", tmp_path / "kept", *options)
        node = made.pop()
        node.start()
        return node, [node.od[name].value for name in NAMES]

    node, values = started()
    assert values == [1, 500, 1, 1]
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


def test_node_options_set_id_and_recorded_finger(made: list[Node], tmp_path: Path) -> None:
    finger = tmp_path / "finger.csv"
    finger.write_text("t_s,x_mm,Fn_N\n0,0,0\n5,0,0.9\n")
    succeed("node", "--interface", "virtual", "--node-id", "7", "--finger", finger)
    (node,) = made
    node.start()
    assert (node.device.node_id, moves(node)) == (7, False)
    assert node.block._inside.plate.plate._finger.at(2.5) == (0.0, 0.45)  # type: ignore[union-attr]


# A device that was never given a node-ID, from the command line to its life with one.


@pytest.mark.parametrize("command", [("node",), ("plate",), ("device", "--eds", str(RICH_EDS))])
def test_unconfigured_and_a_node_id_contradict_each_other(command):
    line = refusal(*command, "--unconfigured", "--node-id", "5", code=2)
    assert "--unconfigured has no --node-id, but 5 is given" in line


def test_a_dcf_is_no_device_without_a_node_id(tmp_path: Path) -> None:
    file = tmp_path / "rich-12.dcf"
    made = ("--node-id", "12", "--bitrate", "500000", "--output", file)
    succeed("eds", "dcf", RICH_EDS, *made)
    told = f"{file} is the DCF of node 12: give its EDS"
    assert told in refusal("device", *VIRTUAL, "--unconfigured", "--eds", file, code=2)


def test_a_device_of_a_dcf_is_its_node(multicast, tmp_path):
    """Not the one that LSS has stored, as the values of the DCF are for its node."""
    file = tmp_path / "rich-12.dcf"
    made = ("--node-id", "12", "--bitrate", "500000", "--output", file)
    succeed("eds", "dcf", RICH_EDS, *made)
    for node_id in (None, 12):
        assert load_own(file, node_id, unconfigured=False)[1] == 12
    device = NodeProcess("device", "--eds", str(file), *multicast_options(multicast))
    try:
        device.wait_for(f"device 12 ready on udp_multicast:{multicast['channel']}")
    finally:
        device.end()


ANSWERS = """
def low(od):
    return 2 * od["Setpoint.Voltage"].value + 0.4

ANSWERS = {"%s": low}
"""


def test_python_file_answers_a_read_only_object(made: list[Node], tmp_path: Path) -> None:
    od = load_eds(RICH, 1)
    name = next(e.name for e in od if e.index > 0x1FFF and e.access == "ro" and e.size == 2)
    file = tmp_path / "answers.py"
    file.write_text(ANSWERS % name)
    succeed("device", *VIRTUAL, "--eds", RICH_EDS, "--answers", file)
    (node,) = made
    node.start()
    answered, setpoint = node.device.od[name], node.device.od["Setpoint.Voltage"]
    for value, expected in ((100, 200), (7, 14), (10**6, int(answered.high))):
        setpoint.value = value
        (answer,) = node.receive(requests.upload(1, answered))
        assert int.from_bytes(answer.data[4:6], "little") == expected
    for text, message in (
        (ANSWERS % "Setpoint.Voltage", "is writable"),
        (ANSWERS % "No such", "is not in the EDS"),
        ("", "it has no ANSWERS"),
    ):
        file.write_text(text)
        told = refusal("device", *VIRTUAL, "--eds", RICH_EDS, "--answers", file)
        assert message in told


def test_lss_gives_the_node_id_and_storage_keeps_it(multicast, tmp_path):
    bus = multicast_options(multicast)
    where = f"udp_multicast:{multicast['channel']}"
    kept = str(tmp_path / "kept")
    command = ["device", "--eds", str(RICH_EDS), "--unconfigured", "--storage", kept]
    first = NodeProcess(*command, *bus)
    try:
        first.wait_for(f"device without node-ID ready on {where}")
        succeed("lss", "9", "--store", *bus)
        first.wait_for("device 9 pre-operational")
    finally:
        status, said, _ = first.end()
    assert (status, said[-1]) == (0, "device 9 stopped")
    second = NodeProcess(*command, *bus)
    try:
        second.wait_for(f"device 9 ready on {where}")
    finally:
        second.end()


# Recorded fingers as a person or a spreadsheet writes them.


FINGER_HEADER = "t_s,x_mm,Fn_N\n"


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "finger.csv"
    path.write_text(f"{FINGER_HEADER}0.5,-38,10\r\n1.5,38,0\r\n", encoding="utf-8-sig")
    assert read_finger(path).at(1.0) == pytest.approx((0.0, 5.0))


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        ("0,0,0\n1,0\n", "line 3: 2 fields are not the 3 of the header"),
        ("0,0,0\n1,0,0,0\n", "line 3: 4 fields are not the 3 of the header"),
        ("0,-100,0\n1,0,0\n", "line 2: x_mm -100 is outside -38..38"),
        ("0,0,0\n1,0,10.5\n", "line 3: Fn_N 10.5 is outside -0.01..10"),
        ("0,0,0\n1,nan,0\n", "line 3: x_mm nan is outside -38..38"),
        ("-1,0,0\n1,0,0\n", "line 2: t_s -1 is outside 0..1e+09"),
        ("0.5,0,0\n1,0,0\n1,0,0\n", "line 4: t_s 1 is not after 1"),
        ("0,0,zero\n", "line 2: Fn_N 'zero' is not a number"),
        ("0,0,0\n", "1 samples of a trajectory are fewer than 2"),
        ("", "0 samples of a trajectory are fewer than 2"),
    ],
)
def test_recorded_finger_error_names_line_and_unit_of_the_file(
    rows: str, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "finger.csv"
    path.write_text(FINGER_HEADER + rows)
    assert refusal("node", *VIRTUAL, "--finger", path) == f"{path}: {reason}"


def test_a_file_with_another_header_is_no_finger(tmp_path: Path) -> None:
    path = tmp_path / "finger.csv"
    path.write_text("time,x\n")
    line = refusal("node", *VIRTUAL, "--finger", path)
    assert line == f"{path}: line 1: the header is not t_s,x_mm,Fn_N"


# The pace of a node's process: options that are refused, and the effect of a refusal.


CURES = ["real time: one thing is refused", "real time: another is refused"]
SLEEPY = "real time: processors sleep"


@pytest.mark.parametrize("refused", [[], CURES[:1], CURES])
@pytest.mark.parametrize("command", ["node --plate-node 33", "plate"])
@pytest.mark.parametrize("sleepy", [[], [SLEEPY]])
def test_refused_realtime_is_reported_and_keeps_the_eds_deadline(
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

    def run_in_process(name: str, node: object, *_: object) -> None:
        entries = node.block.deadline._entries if name == "stimulator" else [node._deadline]
        deadlines.append([entry.value for entry in entries])

    monkeypatch.setattr(nodes, "request_real_time", request)
    monkeypatch.setattr(nodes, "keep_processors_awake", keep_awake)
    monkeypatch.setattr(nodes, "SHORT_DEADLINE_MS", 7)
    monkeypatch.setattr(nodes, "run_in_process", run_in_process)
    for options in ("", "--realtime 42", "--realtime 42 --cpu 1", "--lockstep"):
        result = run(*command.split(), *VIRTUAL, *options.split())
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
    monkeypatch.delattr(nodes, "request_real_time")
    monkeypatch.delattr(nodes, "keep_processors_awake")
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
def test_bus_name_in_messages_has_interface_and_channel(
    interface: str | None, channel: str | None, where: str
) -> None:
    assert BusChoice(interface, channel, None, {}).where == where


# State lines of a node, in this process.


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


def test_a_bit_rate_by_lss_is_left_to_whoever_runs_the_bus() -> None:
    said: list[str] = []
    node = Spoken("plate", PlateNode(plate_od()), said)
    said.clear()
    for command in ("04 01", "13 00 02", "15 00 00"):
        node.receive(Frame(cia.LSS_MASTER_ID, bytes.fromhex(command).ljust(8, b"\0")))
    assert said == [
        "plate 33 500 kbit/s by LSS: the bus here stays as it is, set its bit rate and restart"
    ]


def test_a_full_queue_is_a_line() -> None:
    """Its effect is tested in ``tests/host/test_outbox.py``, and by a row of the fault matrix."""
    said: list[str] = []
    node = PlateNode(plate_od())
    StateLines("plate", "here", node, said.append).full(QueueFullError("queue full"))
    assert said == ["plate 33 queue full"]


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


def test_node_lines_say_why_arming_is_refused_and_runs_end() -> None:
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
        "stimulator 32 not armed: the commander is not supervised: enter your heartbeat in "
        "Consumer heartbeat time and send it, or set Drive unwatched to 1"
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


def test_double_sender_seen_after_its_effect_is_named() -> None:
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
        "plate: two have one node-ID; clear 3 s "
        "after the last such frame"
    ]
