"""The commands conform and device, as processes on a real bus."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from smarttac_can.cli import main

EDS = Path(__file__).parents[1] / "eds" / "rich.eds"
BUS = ("--interface", "udp_multicast", "--channel", "239.74.163.91", "--bus-option", "port=43591")
NODE = ("--eds", str(EDS), "--node-id", "9")


@pytest.fixture
def device() -> Iterator[None]:
    command = [sys.executable, "-u", "-m", "smarttac_can", "device", *NODE, *BUS]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "device 9 ready on udp_multicast:239.74.163.91\n"
        yield
        process.send_signal(signal.SIGTERM)
        assert process.stdout.read() == "device 9 stopped\n"
        assert process.wait(30) == 0


def conform(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(main, ["conform", *NODE, *BUS, *arguments])
    return result.exit_code, result.output


@pytest.mark.usefixtures("device")
def test_device_on_a_bus_is_judged(tmp_path: Path) -> None:
    report, results = tmp_path / "report.md", tmp_path / "results.json"
    code, output = conform(
        "--time-out", "1", "--case", "SDO-01", "--case", "od-01", "--case", "HB-01",
        "--report", str(report), "--json", str(results),
    )  # fmt: skip
    assert (code, output.splitlines()) == (
        0,
        [
            "pass  SDO-01    Expedited upload",
            "pass  OD-01     Every object exists",
            "pass  HB-01     Boot-up",
            "3 pass, 0 fail, 0 not applicable",
        ],
    )
    assert "| SDO-01 | Expedited upload |" in report.read_text()
    data = json.loads(results.read_text())
    assert data["counts"] == {"pass": 3}
    assert [case["id"] for case in data["cases"]] == ["SDO-01", "OD-01", "HB-01"]


def test_no_device_is_a_failed_case() -> None:
    code, output = conform("--time-out", "0.01", "--case", "HB-01")
    assert code == 1
    assert "FAIL  HB-01     Boot-up: no boot-up (709h) within 0.1 s" in output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--case", "SDO-99"), "'SDO-99' is neither a case nor a group of cases"),
        (("--time-out", "0"), "0.0 is not in the range"),
        (("--time-out", "nan"), "nan is not a finite number"),
    ],
)
def test_wrong_options_are_refused(arguments: tuple[str, ...], said: str) -> None:
    code, output = conform(*arguments)
    assert code == 2
    assert said in output
