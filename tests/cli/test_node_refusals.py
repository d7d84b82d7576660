"""What ``smarttac node`` and ``smarttac plate`` refuse: one line on stderr and no traceback."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from smarttac_can.cli import main
from smarttac_can.host.files import read_eds

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
