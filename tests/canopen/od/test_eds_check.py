"""Each rule finds the fault that is put into an EDS without fault, and nothing else."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich_eds import RICH, RICH_EDS, changed, without

from smarttac_can.canopen.od.eds_check import check_eds

OWN = sorted((Path(__file__).parents[3] / "eds").glob("*.eds"))


def lines(text: str) -> list[str]:
    return [str(finding) for finding in check_eds(text, "rich.eds")]


@pytest.mark.parametrize("path", [RICH_EDS, *OWN])
def test_files_without_fault(path: Path) -> None:
    assert check_eds(path.read_text(), path.name) == []


@pytest.mark.parametrize(
    ("section", "edits", "expected"),
    [
        ("FileInfo", ["FileVersion"], "[FileInfo] FileVersion is missing"),
        ("FileInfo", ["EDSVersion"], "[FileInfo] warning: EDSVersion is missing"),
        ("FileInfo", ["CreationTime=13:00PM"], "CreationTime=13:00PM is not in the form"),
        ("FileInfo", ["CreationDate=2026-01-01"], "CreationDate=2026-01-01 is not in the form"),
        ("FileInfo", ["FileName=x.eds"], "warning: FileName=x.eds, but it is rich.eds"),
        ("DeviceInfo", ["BaudRate_125=2"], "BaudRate_125=2 is not in the form"),
        ("DeviceInfo", ["Granularity=65"], "Granularity is above 64"),
        ("DeviceInfo", ["NrOfRXPDO=3"], "NrOfRXPDO=3, but 4 are described"),
        ("DeviceInfo", ["NrOfTXPDO=0"], "NrOfTXPDO=0, but 6 are described"),
        ("DeviceInfo", ["ProductNumber=8"], "ProductNumber 0x8 is not the 0x7 of [1018sub2]"),
        ("DummyUsage", ["Dummy0002=yes"], "[DummyUsage] Dummy0002=yes is not in the form"),
        ("Comments", ["Lines=1"], "[Comments] Lines=1, but there are 0"),
        ("OptionalObjects", ["²=0x1003"], "[OptionalObjects] ²=0x1003 is listed twice"),
        ("OptionalObjects", [f"{'9' * 5000}=0x1003"], "=0x1003 is listed twice"),
        ("MandatoryObjects", ["SupportedObjects=2"], "SupportedObjects=2, but 3 are listed"),
        ("MandatoryObjects", ["3=0x1001"], "3=0x1001 is listed twice"),
        ("MandatoryObjects", ["3=x"], "[MandatoryObjects] 3=x is no index"),
        ("ManufacturerObjects", ["1=0x3000"], "1=0x3000 is not described"),
        ("OptionalObjects", ["1=0x2000"], "1=0x2000 is not one of the optional objects"),
        ("1000", ["ParameterName"], "[1000] ParameterName is missing"),
        ("1000", ["Nonsense=1"], "[1000] warning: nonsense is not known"),
        ("1000", ["ObjectType=0x1"], "[1000] ObjectType=0x1 is no object type"),
        ("1000", ["SubNumber=2"], "[1000] is a VAR, but has sub-indices"),
        ("1000", ["ObjFlags=4"], "[1000] ObjFlags=4 is outside 0..3"),
        ("2000", ["DataType"], "[2000] DataType is missing"),
        ("2000", ["DataType=0x0099"], "[2000] DataType=0x0099 is no data type"),
        ("2000", ["AccessType"], "AccessType is missing: it is none of ro, wo,"),
        ("2000", ["AccessType=r"], "AccessType=r is none of ro, wo, rw, rwr, rww, const"),
        ("2000", ["PDOMapping=2"], "PDOMapping=2 is neither 0 nor 1"),
        ("1019", ["LowLimit=300"], "[1019] LowLimit=300 is outside UNSIGNED8"),
        ("1019", ["LowLimit=241"], "[1019] LowLimit 241 is above HighLimit 240"),
        ("1019", ["DefaultValue=241"], "[1019] DefaultValue 241 is above HighLimit 240"),
        ("2100sub2", ["DefaultValue=1"], "[2100sub2] DefaultValue 1 is below LowLimit 4000000"),
        ("2100sub2", ["DefaultValue=x"], "[2100sub2] DefaultValue=x is no integer"),
        ("1006", ["DataType=0x0006"], "[1006] is UNSIGNED16, not the UNSIGNED32 of CiA 301"),
        ("1400sub2", ["DataType=0x0006"], "is UNSIGNED16, not the UNSIGNED8 of CiA 301"),
        ("1008", ["DefaultValue"], "[1008] warning: is const without DefaultValue"),
        ("1008", ["LowLimit=1"], "warning: LowLimit of a VISIBLE_STRING means nothing"),
        (
            "1800sub1",
            ["DefaultValue=0x180+$NODEID"],
            "[1800sub1] warning: DefaultValue=0x180+$NODEID: a formula begins with $NODEID",
        ),
        ("1019", ["DefaultValue=$NODEID+120"], "DefaultValue 247 is above HighLimit 240"),
        ("2100", ["SubNumber=5"], "[2100] SubNumber=5, but 4 are described"),
        ("2100", ["SubNumber"], "[2100] SubNumber of this RECORD is missing"),
        ("2100sub0", ["DefaultValue=4"], "DefaultValue 4, but the highest sub-index is 3"),
        ("2100sub0", ["DefaultValue"], "DefaultValue of sub-index 0 is missing"),
        ("2100sub0", ["DataType=0x0006"], "[2100sub0] sub-index 0 is not UNSIGNED8"),
        ("2200sub2", ["DataType=0x0002"], "[2200] is an ARRAY of members that differ in DataType"),
        ("2210", ["CompactSubObj=255"], "[2210] CompactSubObj=255 is outside 1..254"),
        ("2210Name", ["NrOfEntries=2"], "NrOfEntries is not the 3 that are there"),
        ("2210Value", ["4=1", "NrOfEntries=2"], "4 is outside 1..3"),
        ("1400sub2", ["DefaultValue=250"], "transmission type 250 of this RPDO is reserved"),
        ("1800sub1", ["DefaultValue=0x40000601"], "CAN-ID 601h is restricted"),
        ("1801sub1", ["DefaultValue=$NODEID+0x180"], "CAN-ID 181h is also that of [1800]"),
        ("1A00sub1", ["DefaultValue=0x2F990010"], "maps 2F99h sub-index 0, which is not there"),
        ("1A00sub1", ["DefaultValue=0x22000908"], "maps 2200h sub-index 9, which is not there"),
        ("1A00sub1", ["DefaultValue=0x22000108"], "maps 8 bit of 2200h sub-index 1, a INTEGER16"),
        ("1A00sub1", ["DefaultValue=0x10170010"], "1017h sub-index 0, which has PDOMapping=0"),
        ("1A00sub1", ["DefaultValue=0x21000110"], "into this TPDO, but it is rww"),
        ("1A00sub1", ["DefaultValue=0x00060010"], "maps the dummy 0006h into this TPDO"),
        ("1A00sub4", ["DefaultValue=0x21110020"], "[1A00] maps 80 bit, more than 64"),
        ("1A00sub0", ["HighLimit=99", "DefaultValue=9"], "but the highest sub-index is 8"),
        ("DummyUsage", ["Dummy0005=0"], "dummy 0005h, which DummyUsage does not allow"),
    ],
)
def test_a_fault_is_found(section: str, edits: list[str], expected: str) -> None:
    found = lines(changed(section, *edits))
    assert any(expected in line for line in found), found


@pytest.mark.parametrize(
    ("section", "expected"),
    [
        ("DeviceInfo", "[DeviceInfo] is missing"),
        ("Comments", None),
        ("OptionalObjects", "[OptionalObjects] is missing"),
        ("1001", "[MandatoryObjects] 1001h is missing"),
        ("1006", "0x1006 is not described"),
        ("2100sub0", "[2100] sub-index 0 of this RECORD is missing"),
        ("2100sub1", "[2100] SubNumber=4, but 3 are described"),
        ("2100", "[2100sub1] belongs to no object"),
        ("1A00", "[1A00sub1] belongs to no object"),
        ("1005", "a PDO is synchronous, but there is no SYNC 1005h"),
        ("1014", "[1003] warning: is an error history without EMCY 1014h"),
    ],
)
def test_a_missing_section_is_found(section: str, expected: str | None) -> None:
    found = lines(without(section))
    assert any(expected in line for line in found) if expected else not found, found


def test_the_text_itself() -> None:
    assert lines(RICH.replace("Setpoint", "Sollwért", 1))[0].endswith("'é' is not ASCII")
    long = lines(changed("Comments", "Lines=1", "Line1=" + 250 * "x"))
    assert [line.partition(" is ")[2] for line in long] == ["longer than 255 characters"]
    assert any("is no key of a section" in line for line in lines(RICH + "nonsense\n"))
    assert any("is both" in line for line in lines(RICH + "[1000]\nDataType=0x0006\n"))
    assert "[nonsense] warning: is no section of an EDS" in lines(RICH + "\n[Nonsense]\n")


@settings(max_examples=60)
@given(st.text(alphabet=st.sampled_from("[]=\n10x2AsubParameterName$NODEID+;. "), max_size=80))
def test_no_text_makes_it_fail(text: str) -> None:
    assert check_eds(text, "x.eds")
    check_eds(RICH + "\n" + text, "rich.eds")


@settings(max_examples=60)
@given(st.integers(0, RICH.count("\n") - 1), st.text(max_size=6))
def test_no_damaged_line_makes_it_fail(number: int, text: str) -> None:
    broken = RICH.split("\n")
    broken[number] = broken[number].partition("=")[0] + "=" + text
    check_eds("\n".join(broken), "rich.eds")
