"""A DCF is read alike by others: python-canopen, lely's dcfchk, and our own."""

import io
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pytest
from canopen.objectdictionary.eds import import_eds
from rich_eds import RICH

from smarttac_can.canopen.commissioning.dcf import make_dcf
from smarttac_can.canopen.od.eds import EDSError, load_eds
from smarttac_can.canopen.od.eds_check import check_eds
from smarttac_can.host.files import read_eds


def dcf(text: str, node_id: int = 9, bit_rate: int = 500_000, **values: str) -> str:
    return make_dcf(
        text,
        node_id=node_id,
        bit_rate=bit_rate,
        values={name.replace("__", "."): value for name, value in values.items()},
        eds_name="device.eds",
        dcf_name="device.dcf",
        now=datetime(2026, 3, 4, 15, 6),
    )


@pytest.mark.parametrize("name", ["stimulator.eds", "plate.eds"])
def test_others_read_it(name: str, tmp_path: Path) -> None:
    text = dcf(read_eds(name), 9, 1_000_000, **{"1017": "250"})
    od = import_eds(io.StringIO(text), None)
    assert (od.node_id, od.bitrate) == (9, 1_000_000)
    assert od[0x1017].value == 250
    assert od[0x1800][1].value & 0x7FF == 0x189
    path = tmp_path / "device.dcf"
    path.write_text(text)
    done = subprocess.run(
        [Path(sys.executable).with_name("dcfchk"), "-n", "9", path],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert check_eds(text, "device.dcf") == []


def test_the_values_are_in_force() -> None:
    text = dcf(RICH, Setpoint__Voltage="0x64", **{"2100sub2": "4400000"})
    od = load_eds(text, 9)
    assert od["Setpoint.Voltage"].default == 100
    assert od["Setpoint.Frequency"].default == 4_400_000
    for line in (
        "FileName=device.dcf", "LastEDS=device.eds", "ModificationTime=03:06PM",
        "ModificationDate=03-04-2026", "NodeID=9", "Baudrate=500", "LSS_SerialNumber=42",
    ):  # fmt: skip
        assert text.count(f"\n{line}\n") == 1, line
    # Nothing else has changed.
    same = load_eds(RICH, 9)
    changed = [
        entry.name
        for entry in od
        if entry.default != same.entry(entry.index, entry.subindex).default
    ]
    assert changed == ["Setpoint.Voltage", "Setpoint.Frequency"]


@pytest.mark.parametrize(
    ("given", "raw"), [("80 V", 8000), ("0.08 kV", 8000), ("55 mV", 6), ("80", 80), ("0x50", 80)]
)
def test_dcf_value_with_unit_equals_that_of_the_bench(given: str, raw: int) -> None:
    assert load_eds(dcf(RICH, Setpoint__Voltage=given), 9)["Setpoint.Voltage"].default == raw


def test_a_member_of_a_compact_array() -> None:
    od = load_eds(dcf(RICH, **{"2210sub1": "33"}), 9)
    values = [od.entry(0x2210, subindex).default for subindex in (1, 2, 3)]
    assert values == [33, 10, -7]
    assert check_eds(dcf(RICH, **{"2210sub1": "33"}), "device.dcf") == []


def test_a_dcf_becomes_that_of_another_node() -> None:
    first = dcf(RICH, 9, **{"1801sub1": "0x40000199"})
    od = load_eds(dcf(first, 10), 10)
    assert od.number(0x1800, 1) == 0x4000018A
    assert od.number(0x1801, 1) == 0x40000199


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("Nonsense", "1", "'Nonsense' is not in the EDS"),
        ("3000", "1", "3000 is not in the EDS"),
        ("2100sub9", "1", "2100sub9 is not in the EDS"),
        ("1018sub1", "1", "is ro: it takes no value"),
        ("Setpoint.Volage", "1", "or stands for several objects; perhaps Setpoint.Voltage"),
        (
            "2100sub1",
            "20001",
            "Setpoint.Voltage 20001 is outside the raw values 0..20000, 0..200000 mV;"
            " perhaps '20001 mV'$",
        ),
        ("2100sub1", "300000", "outside the raw values 0..20000, 0..200000 mV$"),
        ("2100sub1", "-1", "Setpoint.Voltage -1 is outside the raw values 0..20000"),
        ("2100sub1", "", "Setpoint.Voltage is given no value"),
        ("2100sub1", "x", "'x' is neither a raw integer nor a number with a unit like mV$"),
        ("2100sub1", "80,5 V", "'80,5 V' is neither a raw .* like mV; perhaps '80.5 V'$"),
        ("2100sub1", "80 v", "perhaps '80 V'$"),
        ("2100sub1", "80 MV", "Setpoint.Voltage 80 MV is outside 0..200000 mV$"),
        ("2100sub1", "80 nV", "Voltage 80 nV would become 0: it goes in steps of 10 mV$"),
        ("2100sub1", "-1 nV", "Voltage -1 nV is below 0 nV, its lowest value$"),
        ("2100sub1", "80.5", "'80.5' is neither"),
        ("2100sub1", "0xFFFFFF", "0xFFFFFF is outside the raw values 0..20000, 0..200000 mV$"),
        ("1017", "$NODEID+99999", "is outside UNSIGNED16$"),
        ("1017", "65536", "65536 is outside the raw values 0..65535"),
        ("2100sub1", "200.01 V", r"Setpoint.Voltage 200.01 V is outside 0..200000 mV"),
        ("2100sub1", "1 um", "'1 um' is neither a raw integer nor a number with a unit like mV$"),
        ("1005", "50 %", r"'50 %' is no raw integer, "),
        ("2100sub1", "300 v", "'300 v' is neither a raw .* like mV$"),
        ("2100sub1", "1 volt", "'1 volt' is neither"),
    ],
)
def test_dcf_refuses_unknown_objects_and_values_out_of_range(
    name: str, value: str, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        dcf(RICH, **{name: value})


def test_bit_rates_are_those_of_the_device() -> None:
    for bit_rate in (125_000, 123):
        with pytest.raises(ValueError, match=f"bit rate {bit_rate} is none"):
            dcf(read_eds("plate.eds"), 9, bit_rate)


def test_a_file_that_configparser_cannot_read() -> None:
    with pytest.raises(EDSError):
        dcf(f"nonsense\n{RICH}")
