"""The commands conform and device: once as processes on a real bus, then conform by itself."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner, Result
from nodes_on_a_bus import NodeProcess, multicast_options
from read_once import read_once
from rich_eds import RICH, RICH_EDS, changed

from smarttac_can.canopen.device.device import Device
from smarttac_can.cli import main
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.host.runner import node_in_thread
from smarttac_can.instrument.nodes.device_node import DeviceNode

NODE = ("--eds", str(RICH_EDS), "--node-id", "9")


def test_device_on_a_bus_is_judged(multicast: dict[str, Any], tmp_path: Path) -> None:
    bus = multicast_options(multicast)
    report, results = tmp_path / "report.md", tmp_path / "results.json"
    command = [
        *("conform", *NODE, *bus, "--timeout", "3", "--report", str(report)),
        *("--json", str(results), "--case", "sdo-01", "--case", "HB-01"),
    ]
    node = NodeProcess("device", *NODE, *bus)
    try:
        node.wait_for(f"device 9 ready on udp_multicast:{multicast['channel']}")
        result = CliRunner().invoke(main, command)
    finally:
        ended = node.end()
    assert ended == (0, ["device 9 stopped"], "")
    assert (result.exit_code, result.output.splitlines()) == (
        0,
        [
            "pass  SDO-01    Expedited upload",
            "pass  HB-01     Boot-up",
            "2 pass, 0 fail, 0 not applicable",
        ],
    )
    assert "| SDO-01 | Expedited upload |" in report.read_text()
    data = json.loads(results.read_text())
    assert data["counts"] == {"pass": 2}
    assert [case["id"] for case in data["cases"]] == ["SDO-01", "HB-01"]


Conform = Callable[..., Result]


@pytest.fixture
def conform(virtual: dict[str, Any]) -> Conform:
    """How the command ends, with arguments of one's own."""
    bus = ("--interface", virtual["interface"], "--channel", virtual["channel"])
    return lambda *arguments: CliRunner().invoke(main, ["conform", *NODE, *bus, *arguments])


@pytest.fixture
def device(virtual: dict[str, Any]) -> Iterator[None]:
    node = DeviceNode(Device(read_once(RICH, 9)))
    with node_in_thread(node, PythonCanBus(**virtual)):
        yield


@pytest.mark.usefixtures("device")
def test_the_sheet_of_another_device_is_named(conform: Conform, tmp_path: Path) -> None:
    other = tmp_path / "other.eds"
    other.write_text(changed("1018sub2", "DefaultValue=0x0000ABCD"))
    result = conform("--eds", str(other), "--timeout", "1", "--case", "HB-01")
    said = (
        "other.eds may describe another device than node 9: product code is 00000007h, "
        "not 0000ABCDh"
    )
    assert (result.exit_code, result.output.splitlines()[0]) == (0, said)


@pytest.mark.usefixtures("device")
def test_results_on_stdout_are_alone_there(conform: Conform) -> None:
    result = conform("--timeout", "1", "--case", "SDO-01", "--json", "-")
    assert json.loads(result.stdout)["counts"] == {"pass": 1}
    assert result.stderr.splitlines()[0] == "pass  SDO-01    Expedited upload"


def test_conform_refuses_an_unwritable_report_before_the_bus(
    conform: Conform, tmp_path: Path
) -> None:
    report = tmp_path / "no" / "report.md"
    result = conform("--interface", "none-such", "--report", str(report))
    assert (result.exit_code, result.output) == (
        1,
        f"Error: {report}: the folder {report.parent} does not exist\n",
    )


def test_no_device_ends_after_one_probe(conform: Conform, virtual: dict[str, Any]) -> None:
    result = conform("--timeout", "0.01")
    where = f"virtual:{virtual['channel']}"
    late = "no SDO response (589h) within 0.01 s (--timeout 0.01)"
    said = f"node 9 does not answer on {where}: {late}"
    assert (result.exit_code, result.output) == (1, f"Error: {said}\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--case", "SDO-99"), "'SDO-99' is neither a case nor a group of cases; groups are "),
        (("--timeout", "0"), "0.0 is not in the range"),
        (("--timeout", "nan"), "nan is not a finite number"),
    ],
)
def test_wrong_options_are_refused(conform: Conform, arguments: tuple[str, ...], said: str) -> None:
    result = conform(*arguments)
    assert result.exit_code == 2
    assert said in result.output


CHOSEN = ("--timeout", "1", "--case", "OTHER-03", "--case", "HB-01")
KNOWN = 'OTHER-03 = "this firmware has no name"\n'


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(
    ("known", "named", "code", "said", "marks"),
    [
        ("", False, 1, "OTHER-03 fails, and is no known deviation", {"OTHER-03": "failure"}),
        (KNOWN, False, 0, "", {"OTHER-03": "skipped"}),
        (KNOWN, True, 1, "OTHER-03 passes: remove it from", {"OTHER-03": "failure"}),
    ],
    ids=["unknown", "known", "gone"],
)
def test_known_deviation_decides_exit_code_and_junit(
    known: str,
    named: bool,
    code: int,
    said: str,
    marks: dict[str, str],
    conform: Conform,
    tmp_path: Path,
) -> None:
    eds, file, xml = (tmp_path / name for name in ("other.eds", "known.toml", "conform.xml"))
    eds.write_text(RICH if named else changed("1008", "DefaultValue=Something <else>"))
    file.write_text(known)
    result = conform("--eds", str(eds), *CHOSEN, "--known", str(file), "--junit", str(xml))
    assert result.exit_code == code, result.output
    assert said in result.stderr
    suite = ElementTree.parse(xml).getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == (
        "2",
        str(code),
        str(1 - code),
    )
    found = {str(case.get("name")).partition(" ")[0]: mark.tag for case in suite for mark in case}
    assert found == marks
    if not code:
        assert "this firmware has no name" in xml.read_text()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('SDO-99 = "why"', "'SDO-99' is no case"),
        ('SDO-01 = ""', "SDO-01 has no reason"),
        ("SDO-01", "known.toml: "),
    ],
)
def test_file_of_known_deviations_is_checked(
    text: str, message: str, conform: Conform, tmp_path: Path
) -> None:
    file = tmp_path / "known.toml"
    file.write_text(text)
    result = conform("--known", str(file))
    assert result.exit_code == 1
    assert message in result.stderr
