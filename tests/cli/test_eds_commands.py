"""``smarttac eds``: results on stdout or in a file, and one line for what is wrong."""

import json
from pathlib import Path

import cantools
import pytest
from click.testing import CliRunner, Result

from smarttac_can.cli import main
from smarttac_can.od.eds import load_eds

ROOT = Path(__file__).parents[2]
RICH = ROOT / "tests" / "eds" / "rich.eds"
COMMISSION = ("--node-id", "9", "--bitrate", "500000")


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, ["eds", *(str(argument) for argument in arguments)])


def refusal(*arguments: str | Path) -> str:
    result = run(*arguments)
    assert result.exit_code in (1, 2)
    assert isinstance(result.exception, SystemExit), result.exception
    last = result.stderr.splitlines()[-1]
    assert last.startswith("Error: ")
    return last


def test_a_file_without_fault_says_nothing() -> None:
    result = run("check", RICH)
    assert (result.exit_code, result.output) == (0, "")


def test_a_file_that_is_no_eds_gets_one_line(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("# Notes\n\n[Shopping]\nmilk=2\n" + "bread\n" * 50)
    result = run("check", path)
    assert result.exit_code == 1
    assert result.stdout == (
        f"{path}: it is no EDS: neither [FileInfo], [DeviceInfo] nor [MandatoryObjects]\n"
    )


@pytest.mark.parametrize("node", ["stimulator", "plate"])
def test_the_eds_of_a_node_by_its_name(
    node: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shown = run("show", node)
    assert shown.exit_code == 0
    assert shown.stdout == (ROOT / "eds" / f"{node}.eds").read_text()
    assert run("check", node).exit_code == 0
    assert run("doc", node).stdout.startswith(f"# {node}.eds\n")


def test_a_file_comes_before_a_node_of_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plate").write_text(RICH.read_text())
    assert run("show", "plate").stdout == RICH.read_text()


def test_neither_a_file_nor_a_node(tmp_path: Path) -> None:
    assert refusal("check", "stimulus").endswith(
        "'stimulus' is neither a file nor stimulator or plate"
    )
    assert refusal("show", tmp_path).endswith("is a directory")


def test_one_line_for_each_finding(tmp_path: Path) -> None:
    path = tmp_path / "rich.eds"
    text = RICH.read_text()
    path.write_text(text.replace("NrOfRXPDO=4", "NrOfRXPDO=5"))
    wrong = run("check", path)
    assert wrong.exit_code == 1
    assert wrong.stdout == f"{path}: [DeviceInfo] NrOfRXPDO=5, but 4 are described\n"
    listed = json.loads(run("check", path, "--json").stdout)
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
    path.write_text(text.replace("EDSVersion=4.0\n", ""))
    warned = run("check", path)
    assert warned.exit_code == 0
    assert warned.stdout == f"{path}: [FileInfo] warning: EDSVersion is missing\n"


def test_a_file_is_shown_byte_for_byte(tmp_path: Path) -> None:
    data = RICH.read_bytes().replace(b"Lines=0", b"Lines=0\r\n;5 \xb5m") + b"\n;\xfc"
    path, copy = tmp_path / "latin-1.eds", tmp_path / "copy.eds"
    path.write_bytes(data)
    assert run("show", path).stdout_bytes == data
    assert run("show", path, "--output", copy).output == ""
    assert copy.read_bytes() == data


def test_doc(tmp_path: Path) -> None:
    path = tmp_path / "rich.md"
    assert run("doc", RICH, "--output", path).output == ""
    text = path.read_text()
    assert text == run("doc", RICH).stdout
    assert text.startswith("# rich.eds\n")
    row = "| 2100h | 1 | Setpoint.Voltage | UNSIGNED16 | rww | yes | 0..20000 | 0 | 10 mV |"
    assert row in text.splitlines()
    assert "| TPDO 1 | 180h + node-ID | 255 |" in text
    assert "| TPDO 4 | off (480h + node-ID) | 0 |" in text


def test_dbc(tmp_path: Path) -> None:
    path = tmp_path / "rich.dbc"
    assert run("dbc", RICH, "--node-id", "5", "--output", path).output == ""
    database = cantools.database.load_file(path)
    assert database.get_message_by_name("Conformance_probe_5_TPDO1").frame_id == 0x185
    assert path.read_text() == run("dbc", RICH, "--node-id", "5").stdout


def test_dbc_of_our_nodes_alone_has_names_of_states_and_emergencies() -> None:
    ours = run("dbc", "stimulator", "--node-id", "32").stdout
    assert '3 "running"' in ours
    assert '"measurement lost"' in ours
    assert "measurement lost" not in run("dbc", RICH, "--node-id", "5").stdout


def test_dbc_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smarttac_can.cli.commission.find_spec", lambda name: None)
    assert "pip install 'smarttac-can[dbc]'" in refusal("dbc", RICH)


def test_dcf(tmp_path: Path) -> None:
    path = tmp_path / "node9.dcf"
    values = ("--set", "Setpoint.Voltage=100", "--set", "1017=500")
    assert run("dcf", RICH, *COMMISSION, *values, "--output", path).output == ""
    od = load_eds(path.read_text(), 9)
    assert (od["Setpoint.Voltage"].default, od.number(0x1017)) == (100, 500)
    assert "FileName=node9.dcf\n" in path.read_text()
    values = ("--set", "Setpoint.Voltage=80 V")
    text = run("dcf", RICH, *COMMISSION, *values).stdout
    assert load_eds(text, 9)["Setpoint.Voltage"].default == 8000
    assert "FileName=rich.dcf\n" in run("dcf", RICH, *COMMISSION).stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("check", "missing.eds"), "'missing.eds' is neither a file nor stimulator or plate"),
        (("check", RICH, "--device"), "--device needs --node-id"),
        (("check", RICH, "--timeout", "0"), "0.0 is not in the range"),
        (("doc", ROOT / "README.md"), "README.md: the file has no objects"),
        (
            ("doc", RICH, "--output", "no/such/folder/x.md"),
            "no/such/folder/x.md: the folder no does not exist",
        ),
        (("dbc", ROOT / "README.md"), "README.md: the file has no objects"),
        (("dbc", RICH, "--node-id", "128"), "128 is not in the range"),
        (("dcf", RICH, "--bitrate", "500000"), "Missing option '--node-id'"),
        (("dcf", RICH, "--node-id", "9"), "Missing option '--bitrate'"),
        (
            ("dcf", RICH, "--node-id", "9", "--bitrate", "9600"),
            "rich.eds: bit rate 9600 is none of",
        ),
        (("dcf", RICH, *COMMISSION, "--set", "1017"), "'1017' is not NAME=VALUE"),
        (("dcf", RICH, *COMMISSION, "--set", "=1"), "'=1' is not NAME=VALUE"),
        (("dcf", RICH, *COMMISSION, "--set", "X=1"), "rich.eds: 'X' is not in the EDS"),
        (("dcf", RICH, *COMMISSION, "--set", "Mode=99"), "rich.eds: Mode 99 is outside 0..6"),
    ],
)
def test_bad_input(arguments: tuple[str | Path, ...], message: str) -> None:
    assert message in refusal(*arguments)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "latin-1", "utf-8"])
def test_files_of_any_maker_are_read(encoding: str, tmp_path: Path) -> None:
    path = tmp_path / "rich.eds"
    path.write_bytes(RICH.read_text().replace("Setpoint", "Größe").encode(encoding))
    assert "Größe.Voltage" in run("doc", path).stdout
