"""Commands that run a node: what they refuse, what is stored, and a recorded finger."""

from pathlib import Path

import pytest
from click.testing import CliRunner
from nodes_on_a_bus import NodeProcess, multicast_options

from smarttac_can.cli import main, nodes
from smarttac_can.cli.nodes import read_finger
from smarttac_can.host.files import read_eds
from smarttac_can.master import requests
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.plant.finger import Stroke

# What ``smarttac node`` and ``smarttac plate`` refuse: one line on stderr and no traceback.


VIRTUAL = ("--interface", "virtual", "--channel", "refusals")


def refusal(*arguments: str) -> str:
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code not in (0, None)
    assert isinstance(result.exception, SystemExit), result.exception
    assert result.stdout == ""
    lines = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    assert len(lines) == 1
    assert result.stderr.endswith(lines[0] + "\n")
    return lines[0].removeprefix("Error: ")


@pytest.mark.parametrize("command", ["node", "plate"])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--interface", "nonsense"), "cannot open the nonsense bus"),
        (("--interface", "socketcan", "--channel", "no_such_can"), "cannot open the socketcan bus"),
        ((*VIRTUAL, "--node-id", "0"), "0 is not in the range 1<=x<=127"),
        ((*VIRTUAL, "--node-id", "128"), "128 is not in the range 1<=x<=127"),
        ((*VIRTUAL, "--node-id", "x"), "'x' is not a valid integer"),
        ((*VIRTUAL, "--subject", "10"), "10 is not in the range 1<=x<=9"),
        ((*VIRTUAL, "--seed", "-1"), "-1 is not in the range"),
        ((*VIRTUAL, "--bitrate", "0"), "0 is not in the range"),
        ((*VIRTUAL, "--finger", "missing.csv"), "'missing.csv' is neither none, stroke nor a file"),
        ((*VIRTUAL, "--eds", "missing.eds"), "'missing.eds' does not exist"),
        ((*VIRTUAL, "--bus-option", "port"), "'port' is not KEY=VALUE"),
        ((*VIRTUAL, "--bus-option", "=1"), "'=1' is not KEY=VALUE"),
        (
            (*VIRTUAL, "--bus-option", "prot=1"),
            "--bus-option: virtual has no option 'prot'; perhaps 'protocol'",
        ),
        ((*VIRTUAL, "--bus-option", "channel=x"), "has an option of its own"),
        ((*VIRTUAL, "--nonsense"), "--nonsense"),
    ],
)
def test_bad_options(command: str, arguments: tuple[str, ...], message: str) -> None:
    assert message in refusal(command, *arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--produce-sync",), "--produce-sync is the tick of a --plate-node"),
        (("--produce-sync", "--lockstep", "--plate-node", "33"), "leave out --produce-sync"),
        (("--plate-node", "32"), "--plate-node 32 is the --node-id of the stimulator"),
        (("--plate-node", "33", "--finger", "none"), "--finger is for the plate inside"),
        (("--plate-node", "33", "--subject", "1"), "--subject is for the plate inside"),
        (("--plate-node", "33", "--seed", "1"), "--seed is for the plate inside"),
        (("--plate-node", "200"), "200 is not in the range 1<=x<=127"),
    ],
)
def test_options_that_contradict_each_other(arguments: tuple[str, ...], message: str) -> None:
    assert message in refusal("node", *VIRTUAL, *arguments)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,x\n", "line 1: the header is not t_s,x_mm,Fn_N"),
        ("t_s,x_mm,Fn_N\n0,0,a\n", "line 2: could not convert"),
        ("t_s,x_mm,Fn_N\n", "finger.csv: "),
    ],
)
def test_broken_finger(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "finger.csv"
    path.write_text(text)
    assert message in refusal("node", *VIRTUAL, "--finger", str(path))


def test_broken_eds(tmp_path: Path) -> None:
    path = tmp_path / "broken.eds"
    path.write_text("this is no EDS\n")
    told = f"{path}: the file has no objects"
    assert refusal("node", *VIRTUAL, "--eds", str(path)) == told
    assert refusal("device", *VIRTUAL, "--eds", str(path)) == told
    assert refusal("conform", *VIRTUAL, "--eds", str(path), "--node-id", "5") == told
    path.write_bytes(bytes(range(256)))
    refusal("node", *VIRTUAL, "--eds", str(path))


def test_the_eds_of_another_device(tmp_path: Path) -> None:
    path = tmp_path / "other.eds"
    path.write_text(read_eds("plate.eds"))
    assert "is not in the EDS" in refusal("node", *VIRTUAL, "--eds", str(path))
    path.write_text(read_eds("stimulator.eds"))
    assert "is not in the EDS" in refusal("plate", *VIRTUAL, "--eds", str(path))


HIGHEST = "HighLimit=20000"


@pytest.mark.parametrize("command", ["node", "node --plate-node 33", "plate"])
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (HIGHEST, "HighLimit=50000", "Voltage has the HighLimit 500000 mV, outside the hard cap"),
        (HIGHEST, "", "Voltage has the HighLimit 655350 mV, outside the hard cap 0..200000 mV"),
        ("DefaultValue=15000", "DefaultValue=20001", "has the DefaultValue 200010 mV"),
        ("HighLimit=8000", "HighLimit=8001", "Temperature has the HighLimit 80.01 degC"),
        ("Voltage [10 mV]", "Voltage [0.1 V]", "has the unit [0.1 V], not [10 mV]"),
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
    said = refusal(*command.split(), *VIRTUAL, "--eds", str(path))
    assert said.startswith(f"{path} does not suit the device: ")
    assert message in said


def test_an_eds_whose_loop_carries_something_else(tmp_path: Path) -> None:
    path = tmp_path / "permuted.eds"
    text = read_eds("stimulator.eds")
    first, second = "DefaultValue=0x21000610", "DefaultValue=0x21000710"
    assert text.count(first) == text.count(second) == 1
    path.write_text(text.replace(first, "@").replace(second, first).replace("@", second))
    said = refusal("node", *VIRTUAL, "--eds", str(path))
    assert "Gauge.S1 and Plate input.S2 are mapped at the same place" in said


def test_an_eds_whose_defaults_contradict_each_other(tmp_path: Path) -> None:
    path = tmp_path / "contradiction.eds"
    text = read_eds("stimulator.eds")
    assert text.count("DefaultValue=4400000") == 1
    path.write_text(text.replace("DefaultValue=4400000", "DefaultValue=4260000"))
    assert "06090030" in refusal("node", *VIRTUAL, "--eds", str(path))


# What was stored by 1010h, and the options of the finger at the next start.


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


# A device that was never given a node-ID, from the command line to its life with one.


EDS = Path(__file__).parents[1] / "eds" / "rich.eds"


@pytest.mark.parametrize("command", [("node",), ("plate",), ("device", "--eds", str(EDS))])
def test_unconfigured_and_a_node_id_contradict_each_other(command):
    result = CliRunner().invoke(main, [*command, "--unconfigured", "--node-id", "5"])
    assert result.exit_code == 2
    assert "--unconfigured has no --node-id, but 5 is given" in result.stderr


def test_lss_gives_the_node_id_and_storage_keeps_it(multicast, tmp_path):
    bus = multicast_options(multicast)
    where = f"udp_multicast:{multicast['channel']}"
    command = ["device", "--eds", str(EDS), "--unconfigured", "--storage", str(tmp_path / "kept")]
    first = NodeProcess(*command, *bus)
    try:
        first.wait_for(f"device without node-ID ready on {where}")
        given = CliRunner().invoke(main, ["lss", "9", "--store", *bus])
        assert given.exit_code == 0, given.stderr
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
        ("0,0,0\n1,0,10.5\n", "line 3: Fn_N 10.5 is outside 0..10"),
        ("0,0,0\n1,nan,0\n", "line 3: x_mm nan is outside -38..38"),
        ("-1,0,0\n1,0,0\n", "line 2: t_s -1 is outside 0..1e+09"),
        ("0.5,0,0\n1,0,0\n1,0,0\n", "line 4: t_s 1 is not after the 1 before it"),
        ("0,0,zero\n", "line 2: could not convert string to float: 'zero'"),
        ("0,0,0\n", "1 samples of a trajectory are fewer than 2"),
    ],
)
def test_what_is_wrong_is_named_by_line_in_the_units_of_the_file(
    rows: str, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "finger.csv"
    path.write_text(FINGER_HEADER + rows)
    with pytest.raises(ValueError) as caught:
        read_finger(path)
    assert str(caught.value) == f"{path}: {reason}"
