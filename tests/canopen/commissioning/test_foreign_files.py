"""DBC, DCF and check of files that are not ours: MPDOs, formulas, missing bit rates, XDD."""

from datetime import datetime
from pathlib import Path

import cantools
import pytest
from commands import refusal, run
from small_eds import NODE_ID, entry, record, small_eds, written

from smarttac_can.canopen.commissioning.dbc import make_dbc
from smarttac_can.canopen.commissioning.dcf import make_dcf
from smarttac_can.canopen.od.eds import EDSError, load_eds
from smarttac_can.canopen.od.eds_check import check_eds

STATUS = entry("2000", 6, "ro", "0", "PDOMapping=1")
RATES = "\n".join(f"BaudRate_{rate}=1" for rate in (125, 250, 500, 800, 1000))


def tpdo(count: str, content: str, number: int = 0) -> str:
    communication, mapping = f"{0x1800 + number:04X}", f"{0x1A00 + number:04X}"
    return record(
        communication,
        entry(f"{communication}sub0", 5, "const", "2"),
        entry(f"{communication}sub1", 7, "rw", f"$NODEID+0x{0x180 + 0x100 * number:X}"),
        entry(f"{communication}sub2", 5, "rw", "254"),
    ) + record(
        mapping, entry(f"{mapping}sub0", 5, "rw", count), entry(f"{mapping}sub1", 7, "rw", content)
    )


def dcf(text: str, node_id: int = NODE_ID, **values: str) -> str:
    return make_dcf(
        text, node_id=node_id, bit_rate=500_000, values=values,
        eds_name="a.eds", dcf_name="a.dcf", now=datetime(2026, 1, 1),
    )  # fmt: skip


@pytest.mark.parametrize("count", ["0xFE", "254", "0xFF"])
def test_an_mpdo_is_a_message_and_no_error_of_the_file(count: str) -> None:
    text = small_eds(STATUS + tpdo("1", "0x20000010") + tpdo(count, "0", 1), tx=2)
    database = cantools.database.load_string(make_dbc(load_eds(text, NODE_ID)), "dbc")
    carried = database.decode_message("Small_9_TPDO2", bytes.fromhex("8A00600101000000"))
    assert carried == {
        "Node": 10, "To_destination": 1, "Index": 0x6000, "Subindex": 1, "Data": 1
    }  # fmt: skip
    assert database.decode_message("Small_9_TPDO1", b"\x05\x00") == {"Entry_2000": 5}
    (finding,) = check_eds(text, "small.eds")
    assert str(finding).startswith("[1A01sub0] warning: maps F")
    assert "multiplexed PDO" in str(finding)


@pytest.mark.parametrize(
    ("objects", "index", "subindex", "value"),
    [
        (entry("2010", 7, "rw", "0", "ParameterValue=$NODEID+0x100"), 0x2010, 0, 0x109),
        (entry("2010", 7, "rw", "$NODEID+1", "ParameterValue=$NODEID+2"), 0x2010, 0, 11),
        ("[2011]\nParameterName=List\nObjectType=8\nDataType=7\nAccessType=rw\nCompactSubObj=2\n"
         "[2011Value]\nNrOfEntries=1\n2=$NODEID+0x200\n", 0x2011, 2, 0x209),
    ],
)  # fmt: skip
def test_a_formula_of_a_value_is_resolved(
    objects: str, index: int, subindex: int, value: int
) -> None:
    made = dcf(small_eds(objects))
    assert load_eds(made, NODE_ID).number(index, subindex) == value
    assert "$NODEID" not in [line.partition("=")[2] for line in made.splitlines()]
    assert not [line for line in made.splitlines() if line.startswith(("ParameterValue=$", "2=$"))]


@pytest.mark.parametrize(
    "rates", [RATES.replace("=1", "=0"), RATES.replace("=1", "="), ""], ids=["0", "empty", "none"]
)
def test_a_file_without_bit_rates_becomes_a_dcf(rates: str, tmp_path: Path) -> None:
    text = small_eds().replace(RATES, rates)
    assert text != small_eds()
    eds, made = written(tmp_path, text), tmp_path / "a.dcf"
    options = ("--node-id", "9", "--output", made)
    result = run("eds", "dcf", eds, *options, "--bitrate", "500000")
    assert result.exit_code == 0
    assert result.stderr == f"{eds}: it lists no bit rate, so 500000 bit/s is not checked\n"
    assert "Baudrate=500" in made.read_text()
    result = run("eds", "dcf", eds, *options, "--bitrate", "500001", "--force")
    assert "bit rate 500001 is none of the device's" in result.stderr


def test_values_of_a_compact_pdo_are_in_force() -> None:
    made = dcf(small_eds(info="CompactPDO=0x3F\n", rx=1), **{"1400sub2": "1", "1600sub1": "5"})
    od = load_eds(made, NODE_ID)
    assert (od.number(0x1400, 2), od.number(0x1600, 1), od.number(0x1400, 1)) == (1, 5, 0x209)


XDD = '<?xml version="1.0" encoding="utf-8"?>\n<ISO15745ProfileContainer/>\n'


def test_an_xdd_is_called_an_xdd(tmp_path: Path) -> None:
    for text in (XDD, "\ufeff\n" + XDD, XDD.partition("\n")[2]):
        with pytest.raises(EDSError, match="it is XML, as an XDD of CiA 311, and no EDS: export"):
            load_eds(text, 1)
        assert [str(f)[:9] for f in check_eds(text, "a.xdd")] == ["it is XML"]
    line = refusal("eds", "doc", written(tmp_path, XDD, "a.xdd"))
    assert "a.xdd: it is XML, as an XDD" in line


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        ("AccessType=rw read", "AccessType=rw read"),
        ("DataType=0x99", "DataType=0x99"),
        ("CompactSubObj=x", "CompactSubObj=x"),
    ],
)
def test_dcf_value_that_cannot_be_loaded_is_named_by_its_line(wrong: str, line: str) -> None:
    key = wrong.partition("=")[0]
    body = [f"[{0x2010:X}]", "ParameterName=X", "ObjectType=8", "DataType=7", "AccessType=rw"]
    body = [wrong if item.startswith(f"{key}=") else item for item in body]
    body += [] if wrong in body else [wrong]
    if key != "CompactSubObj":
        body[2] = "ObjectType=7"
    text = small_eds("\n".join((*body, "")))
    number = text.splitlines().index(line) + 1
    with pytest.raises(EDSError, match=rf"(?i)^line {number}: \[2010\] {key}"):
        load_eds(text, NODE_ID)
