"""Commands for any CANopen device, but for ``conform``."""

import json
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import can
import canopen
import cantools
import pytest
from commands import refusal, run, succeed
from nodes_on_a_bus import in_threads, multicast_options, processes
from rich_eds import RICH, RICH_EDS

from smarttac_can.canopen.bus.node import HostedNode
from smarttac_can.canopen.commissioning.node_ids import Identity
from smarttac_can.canopen.commissioning.scan import matching_eds
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.storage import Memory
from smarttac_can.canopen.od.cia import DataType
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.instrument.nodes.device_node import DeviceNode

# ``smarttac eds``: results on stdout or in a file, and one line for an error.


ROOT = Path(__file__).parents[2]
PLATE = ROOT / "eds" / "plate.eds"
COMMISSION = ("--node-id", "9", "--bitrate", "500000")


def test_a_file_without_fault_says_nothing() -> None:
    result = run("eds", "check", RICH_EDS)
    assert (result.exit_code, result.output) == (0, "")


def test_a_file_that_is_no_eds_gets_one_line(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("# Notes\n\n[Shopping]\nmilk=2\n" + "bread\n" * 50)
    result = run("eds", "check", path)
    assert result.exit_code == 1
    assert result.stdout == (
        f"{path}: it is no EDS: neither [FileInfo], [DeviceInfo] nor [MandatoryObjects]\n"
    )


@pytest.mark.parametrize("node", ["stimulator", "plate"])
def test_the_eds_of_a_node_by_its_name(
    node: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shown = succeed("eds", "show", node)
    assert shown == (ROOT / "eds" / f"{node}.eds").read_text()
    succeed("eds", "check", node)
    assert succeed("eds", "doc", node).startswith(f"# {node}.eds\n")


def test_a_file_comes_before_a_node_of_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plate").write_text(RICH)
    assert succeed("eds", "show", "plate") == RICH


def test_neither_a_file_nor_a_node(tmp_path: Path) -> None:
    line = refusal("eds", "check", "stimulus", code=2)
    assert line.endswith("'stimulus' is neither a file nor stimulator or plate")
    assert refusal("eds", "show", tmp_path, code=2).endswith("is a directory")


def test_one_line_for_each_finding(tmp_path: Path) -> None:
    path = tmp_path / "rich.eds"
    path.write_text(RICH.replace("NrOfRXPDO=4", "NrOfRXPDO=5"))
    wrong = run("eds", "check", path)
    assert wrong.exit_code == 1
    assert wrong.stdout == f"{path}: [DeviceInfo] NrOfRXPDO=5, but 4 are described\n"
    listed = json.loads(run("eds", "check", path, "--json").stdout)
    assert listed == {
        "file": str(path),
        "findings": [
            {
                "section": "DeviceInfo",
                "message": "NrOfRXPDO=5, but 4 are described",
                "error": True,
            }
        ],
    }
    path.write_text(RICH.replace("EDSVersion=4.0\n", ""))
    warned = run("eds", "check", path)
    assert warned.exit_code == 0
    assert warned.stdout == f"{path}: [FileInfo] warning: EDSVersion is missing\n"


def test_a_file_is_shown_byte_for_byte(tmp_path: Path) -> None:
    data = RICH_EDS.read_bytes().replace(b"Lines=0", b"Lines=0\r\n;5 \xb5m") + b"\n;\xfc"
    path, copy = tmp_path / "latin-1.eds", tmp_path / "copy.eds"
    path.write_bytes(data)
    assert run("eds", "show", path).stdout_bytes == data
    assert run("eds", "show", path, "--output", copy).output == ""
    assert copy.read_bytes() == data


def test_doc(tmp_path: Path) -> None:
    path = tmp_path / "rich.md"
    assert run("eds", "doc", RICH_EDS, "--output", path).output == ""
    text = path.read_text()
    assert text == succeed("eds", "doc", RICH_EDS)
    assert text.startswith("# rich.eds\n")
    row = "| 2100h:1 | Setpoint.Voltage | UNSIGNED16 | rww, PDO | 0..20000 | 0 | 10 mV |"
    assert row in text.splitlines()
    assert "| TPDO 1 | 180h + node-ID | 255 |" in text
    assert "| TPDO 4 | off (480h + node-ID) | 0 |" in text


def test_doc_has_a_row_for_neighbours_that_differ_by_name_alone(tmp_path: Path) -> None:
    doc = succeed("eds", "doc", "stimulator")
    assert "\n| 2010h:4..5 | Setpoint.COF left, .COF right | UNSIGNED16 |" in doc
    assert "\n| 2008h:1..8 | Fault memory.Fault 1..8 | VISIBLE_STRING |" in doc
    path = tmp_path / "gap.eds"
    text = PLATE.read_text()
    path.write_text(re.sub(r"\[2050sub3\][^[]*", "", text))
    assert "\n| 2050h:1..2 | Cycle.Ticks, .Lost drives | UNSIGNED32 |" in succeed(
        "eds", "doc", path
    )


def test_dbc(tmp_path: Path) -> None:
    path = tmp_path / "rich.dbc"
    assert run("eds", "dbc", RICH_EDS, "--node-id", "5", "--output", path).output == ""
    database = cantools.database.load_file(path)
    assert database.get_message_by_name("Conformance_probe_5_TPDO1").frame_id == 0x185
    assert path.read_text() == succeed("eds", "dbc", RICH_EDS, "--node-id", "5")


def test_dbc_command_without_cantools_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smarttac_can.cli.commission.find_spec", lambda name: None)
    assert "pip install 'smarttac-can[dbc]'" in refusal("eds", "dbc", RICH_EDS)


def test_dcf(tmp_path: Path) -> None:
    path = tmp_path / "node9.dcf"
    values = ("--set", "Setpoint.Voltage=100", "--set", "1017=500")
    assert run("eds", "dcf", RICH_EDS, *COMMISSION, *values, "--output", path).output == ""
    od = load_eds(path.read_text(), 9)
    assert (od["Setpoint.Voltage"].default, od.number(0x1017)) == (100, 500)
    assert "FileName=node9.dcf\n" in path.read_text()
    values = ("--set", "Setpoint.Voltage=80 V")
    text = succeed("eds", "dcf", RICH_EDS, *COMMISSION, *values)
    assert load_eds(text, 9)["Setpoint.Voltage"].default == 8000
    assert "FileName=rich.dcf\n" in succeed("eds", "dcf", RICH_EDS, *COMMISSION)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("check", RICH_EDS, "--device"), "--device needs --node-id"),
        (("doc", ROOT / "README.md"), "README.md: the file has no objects"),
        (("dbc", ROOT / "README.md"), "README.md: the file has no objects"),
        (
            ("dcf", RICH_EDS, "--node-id", "9", "--bitrate", "9600"),
            "rich.eds: bit rate 9600 is none of",
        ),
        (("dcf", RICH_EDS, *COMMISSION, "--set", "1017"), "'1017' is not NAME=VALUE"),
        (("dcf", RICH_EDS, *COMMISSION, "--set", "Mode=99"), "rich.eds: Mode 99 is outside 0..6"),
    ],
)
def test_bad_input(arguments: tuple[str | Path, ...], message: str) -> None:
    assert message in refusal("eds", *arguments, code=None)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "latin-1", "utf-8"])
def test_files_of_any_maker_are_read(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "rich.eds"
    path.write_bytes(RICH.replace("Setpoint", "Größe").encode(encoding))
    assert "Größe.Voltage" in succeed("eds", "doc", path)


# ``smarttac scan``, ``smarttac lss`` and ``eds check --device`` against devices in threads.


DOUBLED = (
    "node 9: more than one device has this node-ID, and the row may show any of them; give one of "
    "them another by LSS or --node-id\n"
)
RICH_IDENTITY = "00000123:00000007:00010000:0000002A"


@contextmanager
def running(channel: str, *nodes: HostedNode) -> Iterator[tuple[str, ...]]:
    """Run nodes; gives the options of their bus."""
    with in_threads({"interface": "virtual", "channel": channel}, *nodes, lockstep=False):
        yield "--interface", "virtual", "--channel", channel


def rich(
    node_id: int,
    storage: Memory | None = None,
    *,
    autostart: bool = False,
    serial: int = 0x2A,
) -> DeviceNode:
    od = load_eds(RICH, 5 if node_id == 255 else node_id)
    od.entry(0x1018, 4).value = serial
    return DeviceNode(Device(od, autostart=autostart, storage=storage, node_id=node_id))


def test_scan_tells_state_identity_and_eds() -> None:
    with running("scan", rich(5), rich(9), rich(255)) as bus:
        bare = run("scan", *bus)
        result = run("scan", *bus, "--eds", RICH_EDS, "--json")
    assert bare.exit_code == result.exit_code == 0, (bare.output, result.output)
    head, *lines = bare.stdout.splitlines()
    assert head.split() == [
        "node", "state", "name", "vendor", "product", "revision", "serial", "EDS",
    ]  # fmt: skip
    assert [line.split()[0] for line in lines] == ["5", "9", "-"]
    assert lines[0].split()[1] == "pre-operational"
    assert lines[0].endswith("00000123  00000007  00010000  0000002A  -")
    assert lines[2].split() == ["-", "unconfigured", "-", *RICH_IDENTITY.split(":"), "-"]
    found = json.loads(result.stdout)
    assert [device["node_id"] for device in found] == [5, 9, None]
    assert {device["eds"] for device in found} == {str(RICH_EDS)}
    assert found[0]["identity"] == {
        "vendor": 0x123, "product": 7, "revision": 0x10000, "serial": 42,
    }  # fmt: skip


def test_the_name_of_a_device_does_nothing_to_a_terminal() -> None:
    node = rich(5)
    name = node.device.od.entry(0x1008)
    name.data_type, name.default = DataType.OCTET_STRING, b"\x1b[31mred"
    with running("scan", node) as bus:
        result = run("scan", *bus)
    assert result.stdout.splitlines()[1].split()[2] == "\\x1b[31mred"


def test_two_devices_with_one_node_id_are_named() -> None:
    with running("double", rich(5), rich(9), rich(9)) as bus:
        bare = run("scan", *bus)
        result = run("scan", *bus, "--json")
    assert bare.exit_code == result.exit_code == 1, (bare.output, result.output)
    assert bare.stderr == result.stderr == DOUBLED
    assert bare.stdout.splitlines()[2].endswith("00000123  00000007  00010000  0000002A  -")
    assert [device["doubled"] for device in json.loads(result.stdout)] == [False, True]


def test_nothing_but_its_own_lines_reaches_the_terminal(multicast: dict[str, Any]) -> None:
    with processes(multicast, "plate", "plate", "node"):
        result = subprocess.run(
            [sys.executable, "-m", "smarttac_can", "scan", *multicast_options(multicast)],
            capture_output=True,
            text=True,
            check=False,
        )
    assert result.returncode == 1
    assert result.stderr == DOUBLED.replace("9", "33")
    assert [line.split()[0] for line in result.stdout.splitlines()] == ["node", "32", "33"]
    assert result.stdout.splitlines()[2].endswith("534D5402  00010001  00000001  plate.eds")


def test_scan_of_an_empty_bus_is_one_line() -> None:
    scan = ("scan", "--interface", "virtual", "--channel", "empty", "--timeout", "0.05")
    assert refusal(*scan) == refusal(*scan, "--json") == "no device answers on virtual:empty"
    assert run(*scan, "--json").stdout == "[]\n"


def test_timeout_without_end_is_refused() -> None:
    assert "nan is not a finite number" in refusal("scan", "--timeout", "nan", code=2)


@pytest.mark.parametrize("given", [["--json"], ["--json", "-"], ["--json", "{file}"]])
def test_rows_as_json_go_to_stdout_or_a_file(given: list[str], tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    with running("scan-json", rich(5)) as bus:
        result = run("scan", *bus, *(text.format(file=file) for text in given))
    assert (result.exit_code, file.exists()) == (0, "{file}" in given)
    rows = json.loads(file.read_text() if file.exists() else result.stdout)
    assert [row["node_id"] for row in rows] == [5]


def test_lss_names_an_operational_device_as_its_reason() -> None:
    with running("lss-operational", rich(5, autostart=True)) as bus:
        line = refusal("lss", "9", "--identity", RICH_IDENTITY, *bus)
    assert "one that is OPERATIONAL takes no LSS: stop it" in line


def test_an_eds_of_another_revision_comes_second() -> None:
    od = load_eds(RICH, 1)
    identity = Identity(0x123, 7, 0x20000, 1)
    assert matching_eds(identity, [("a", od)]) == "a (revision differs)"
    assert matching_eds(identity._replace(revision=0x10000), [("a", od)]) == "a"
    assert matching_eds(identity._replace(product=8), [("a", od)]) == ""


def test_lss_gives_a_node_id_to_a_device_that_has_none() -> None:
    memory = Memory()
    device = rich(255, memory)
    with running("lss", rich(5), device) as bus:
        said = succeed("lss", "12", "--store", *bus, "--timeout", "2")
    assert said == f"{RICH_IDENTITY} has node-ID 12, stored; it had none\n"
    assert device.device.node_id == 12
    again = rich(255, memory)
    again.start()
    assert again.device.node_id == 12


def test_lss_moves_a_device_by_its_identity() -> None:
    device = rich(5)
    with running("move", device) as bus:
        said = succeed("lss", "6", "--identity", RICH_IDENTITY, *bus, "--timeout", "2")
        wrong = refusal("lss", "7", "--identity", "123:7:10000:2B", *bus, "--timeout", "0.1")
        none = refusal("lss", "7", *bus, "--timeout", "0.1")
    assert said == f"{RICH_IDENTITY} has node-ID 6; it had 5\n"
    assert device.device.node_id == 6
    assert "no device with the identity 00000123:00000007:00010000:0000002B" in wrong
    assert "no device without node-ID answers fastscan" in none


class LateSlave(can.Listener):
    """An LSS slave that answers each question 0.3 s later."""

    ANSWERS: Final = {0x51: 0x4F, 0x43: 0x44, 0x5E: 0x5E}

    def __init__(self, bus: can.BusABC, late: set[int]) -> None:
        self.bus = bus
        self.late = late

    def on_message_received(self, msg: can.Message) -> None:
        answer = self.ANSWERS.get(msg.data[0]) if msg.arbitration_id == 0x7E5 else None
        if answer is not None:
            frame = can.Message(arbitration_id=0x7E4, data=[answer] + [0] * 7, is_extended_id=False)
            threading.Timer(0.3 * (msg.data[0] in self.late), self.bus.send, [frame]).start()


@pytest.mark.parametrize(
    ("late", "options", "said"),
    [
        (0x51, (), "a device without node-ID answers fastscan later than the 0.1 s that it may"),
        (0x43, ("--identity", RICH_IDENTITY), "answers later than the time-out of 0.1 s: give it"),
        (0x5E, ("--identity", RICH_IDENTITY), "was asked to tell its node-ID, and answers later"),
    ],
)
def test_lss_tells_an_answer_that_is_late_from_none(
    late: int, options: tuple[str, ...], said: str
) -> None:
    at = ("--interface", "virtual", "--channel", "lss-late", "--timeout", "0.1")
    with can.Bus(interface="virtual", channel="lss-late") as bus:
        notifier = can.Notifier(bus, [LateSlave(bus, {late})])
        line = refusal("lss", "6", *options, *at)
        notifier.stop()
    assert said in line


@pytest.fixture
def bars(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, list[float]]]:
    """Labels of the progress bars of commands, and the fractions that each has shown."""
    shown: list[tuple[str, list[float]]] = []

    @contextmanager
    def bar(label: str, _after: float) -> Iterator[Callable[[float], None]]:
        shown.append((label, []))
        yield shown[-1][1].append

    monkeypatch.setattr("smarttac_can.cli.commission.progress_bar", bar)
    return shown


def test_lss_shows_the_progress_of_fastscan(bars: list[tuple[str, list[float]]]) -> None:
    with running("lss-bar", rich(255)) as bus:
        succeed("lss", "12", *bus, "--timeout", "2")
    ((label, shares),) = bars
    assert (label, len(shares), shares[-1]) == ("fastscan", 133, 1.0)
    assert shares == sorted(shares)


def test_scan_shows_the_progress_of_fastscan(bars: list[tuple[str, list[float]]]) -> None:
    with running("scan-bar", rich(255)) as bus:
        succeed("scan", *bus)
    ((label, shares),) = bars
    assert label == "fastscan"
    assert 1.0 in shares


def test_eds_commands_show_the_progress_of_reading_and_writing(
    bars: list[tuple[str, list[float]]], tmp_path: Path
) -> None:
    with running("bars", rich(5)) as bus:
        succeed("eds", "check", RICH_EDS, "--device", "--node-id", "5", *bus)
        succeed("eds", "save", "--node-id", "5", tmp_path / "5.dcf", "--eds", RICH_EDS, *bus)
        succeed("eds", "diff", tmp_path / "5.dcf", *bus)
        succeed("eds", "load", tmp_path / "5.dcf", *bus)
    assert [label for label, _ in bars] == ["reading", "reading", "reading", "writing"]
    assert all(len(shares) > 10 and shares[-1] == 1.0 for _, shares in bars)


def test_lss_refuses_a_node_id_that_is_in_use() -> None:
    """By a device which is stopped, answers no SDO and has no heartbeat."""
    other, device = rich(6, serial=7), rich(5)
    with running("lss-in-use", other, device) as bus:
        with canopen.Network() as network:
            network.connect(interface="virtual", channel="lss-in-use")
            client = network.add_node(6, canopen.ObjectDictionary())
            client.sdo.download(0x1017, 0, bytes(2))
            network.send_message(0, [2, 6])
        line = refusal("lss", "6", "--identity", RICH_IDENTITY, *bus, "--timeout", "0.5")
        kept = device.device.node_id
        succeed("lss", "6", "--identity", RICH_IDENTITY, "--force", *bus)
    assert line == (
        "node-ID 6 is in use: a device answers with it; choose another one (a scan shows "
        "those in use), or force it"
    )
    assert kept == 5
    assert device.device.node_id == 6


def test_lss_stores_the_node_id_that_a_device_has() -> None:
    memory = Memory()
    with running("lss-same", rich(5, memory)) as bus:
        said = succeed("lss", "5", "--identity", RICH_IDENTITY, "--store", *bus, "--timeout", "5")
    assert said == f"{RICH_IDENTITY} has node-ID 5, stored; it had 5\n"


@pytest.mark.parametrize("identity", ["1:2:3", "1:2:3:x", "1:2:3:100000000", "1:2:3:-4", ""])
def test_an_identity_is_four_numbers(identity: str) -> None:
    assert "four hexadecimal numbers" in refusal("lss", "1", "--identity", identity, code=2)


def test_a_device_reads_as_its_eds_says(tmp_path: Path) -> None:
    other = tmp_path / "rich.eds"
    assert RICH.count("DefaultValue=0x00020194") == 1
    other.write_text(RICH.replace("DefaultValue=0x00020194", "DefaultValue=0x00020191"))
    with running("reads", rich(5)) as bus:
        succeed("eds", "check", RICH_EDS, "--device", "--node-id", "5", *bus)
        differs = run("eds", "check", other, "--device", "--node-id", "5", *bus)
        silent = run(
            "eds", "check", RICH_EDS, "--device", "--node-id", "6", *bus, "--timeout", "0.05"
        )
    assert differs.exit_code == 1
    assert differs.stdout == f"{other}: [1000] the device reads 131476, not 131473\n"
    assert silent.exit_code == 1
    assert silent.stdout == f"{RICH_EDS}: [1000] node 6 does not answer\n"


def test_a_dcf_is_loaded_into_its_device(tmp_path: Path) -> None:
    file = tmp_path / "rich-5.dcf"
    values = ("--set", "1017=300", "--set", "1A00sub1=0x22000210", "--output", file)
    succeed("eds", "dcf", RICH_EDS, "--node-id", "5", "--bitrate", "500000", *values)
    with running("load", rich(5)) as bus:
        before = run("eds", "check", file, "--device", "--node-id", "5", *bus)
        loaded = run("eds", "load", file, *bus)
        after = run("eds", "check", file, "--device", "--node-id", "5", *bus)
        again = json.loads(succeed("eds", "load", file, "--json", *bus))
    assert before.exit_code == 1
    assert "[1017] the device reads" in before.stdout
    assert (loaded.exit_code, loaded.stderr) == (0, "")
    assert re.fullmatch(r"node 5: \d+ values, 0 refused or different\n", loaded.stdout)
    assert (after.exit_code, after.stdout) == (0, "")
    assert (again["node_id"], again["findings"]) == (5, [])


def test_eds_load_names_each_value_a_device_refuses(tmp_path: Path) -> None:
    file = tmp_path / "rich-5.dcf"
    values = ("--set", "1017=300", "--set", "1A00sub1=0x77770008", "--output", file)
    run("eds", "dcf", RICH_EDS, "--node-id", "5", "--bitrate", "500000", *values)
    with running("refused", rich(5)) as bus:
        loaded = run("eds", "load", file, *bus)
    assert loaded.exit_code == 1
    first, *_, last = loaded.stdout.splitlines()
    assert first.startswith(f"{file}: [1A00sub1] the device refuses {0x77770008}: ")
    assert " values, " in last
    assert "[1017]" not in loaded.stdout


def test_an_eds_is_no_dcf() -> None:
    bus = ("--interface", "virtual", "--channel", "none")
    assert "has no node-ID: give --node-id" in refusal("eds", "load", RICH_EDS, *bus, code=2)
    assert "it is an EDS, not a DCF" in refusal("eds", "load", PLATE, "--node-id", "5", *bus)


# A DCF is that of one node.


def dcf_of(node_id: int, folder: Path, *, section: str = "DeviceComissioning") -> Path:
    """DCF of the rich device, with the section of its node-ID in one of its spellings."""
    file = folder / f"rich-{node_id}.dcf"
    options = ("--node-id", str(node_id), "--bitrate", "500000", "--force")
    succeed("eds", "dcf", RICH_EDS, *options, "--set", "1017=300", "--output", file)
    file.write_text(file.read_text().replace("[DeviceComissioning]", f"[{section}]"))
    return file


NO_BUS = ("--interface", "virtual", "--channel", "nobody")
OF_ANOTHER = (
    "the DCF is of node 12, not of 9: leave the node-ID out, or make a DCF of node 9 by "
    "'smarttac eds dcf'"
)


@pytest.mark.parametrize("section", ["DeviceComissioning", "DeviceCommissioning"])
@pytest.mark.parametrize(
    "command",
    [
        ("device", "--node-id", "9", *NO_BUS, "--eds"),
        ("conform", "--node-id", "9", *NO_BUS, "--eds"),
        ("eds", "load", "--node-id", "9", *NO_BUS),
        ("eds", "check", "--device", "--node-id", "9", *NO_BUS),
        ("eds", "dbc", "--node-id", "9"),
    ],
)
def test_a_dcf_is_refused_for_another_node(
    command: tuple[str, ...], section: str, tmp_path: Path
) -> None:
    file = dcf_of(12, tmp_path, section=section)
    assert refusal(*command, file) == f"{file}: {OF_ANOTHER}"


def test_a_log_refuses_the_dcf_of_another_node(tmp_path: Path) -> None:
    file, log = dcf_of(12, tmp_path), tmp_path / "run.log"
    log.write_text("(0.000000) can0 70C#05\n")
    assert refusal("log", log, "--eds", f"9={file}") == f"{file}: {OF_ANOTHER}"
    assert "rich-12 12 heartbeat" in succeed("log", log, "--eds", f"12={file}")


def test_a_dcf_is_made_anew_for_another_node(tmp_path: Path) -> None:
    file, other = dcf_of(12, tmp_path, section="DeviceCommissioning"), tmp_path / "other.dcf"
    succeed("eds", "dcf", file, "--node-id", "9", "--bitrate", "500000", "--output", other)
    text = other.read_text()
    assert text.lower().count("commissioning]") == 1
    od = load_eds(text, 9)
    assert (od.number(0x1200, 1), od.number(0x1800, 1) & 0x7FF) == (0x609, 0x189)


@pytest.mark.parametrize("stated", ["0", "0xFF", ""])
def test_a_dcf_without_a_node_id_is_for_any_node(stated: str, tmp_path: Path) -> None:
    file = dcf_of(12, tmp_path)
    file.write_text(file.read_text().replace("NodeID=12", f"NodeID={stated}"))
    assert "BO_ 1801 " in succeed("eds", "dbc", file, "--node-id", "9"), "heartbeat of node 9"


def test_the_node_id_of_a_dcf_is_bounded(tmp_path: Path) -> None:
    file = dcf_of(12, tmp_path)
    file.write_text(file.read_text().replace("NodeID=12", "NodeID=200"))
    assert refusal("eds", "dbc", file).endswith("nodeid 200 is outside 1..127")
