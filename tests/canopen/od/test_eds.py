import contextlib
import io
import logging
from typing import Any

import pytest
from canopen.objectdictionary.eds import import_eds
from hypothesis import given, settings
from hypothesis import strategies as st
from rich_eds import RICH

from smarttac_can.canopen.od import eds as module
from smarttac_can.canopen.od.cia import DataType, ObjectType
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.eds import EDSError, load_eds
from smarttac_can.canopen.od.units import ONE


def eds(*lines: str) -> str:
    return "\n".join(["[OptionalObjects]", "SupportedObjects=1", "1=0x2000", *lines])


def var(*lines: str, data_type: str = "0x0007", access: str = "rw") -> str:
    body = ["ParameterName=X", f"DataType={data_type}", f"AccessType={access}", *lines]
    return eds("[2000]", *body)


def default(text: str, data_type: str, node_id: int = 5) -> object:
    return load_eds(var(f"DefaultValue={text}", data_type=data_type), node_id)["X"].value


def test_rich_eds_is_clean_and_complete() -> None:
    od = load_eds(RICH, 0x20)
    assert od.warnings == []
    assert od.node_id == 0x20
    assert od.dummies == {2, 3, 4, 5, 6, 7}
    assert od.info["productname"] == "Conformance probe"
    assert {entry.data_type for entry in od} == set(DataType)
    assert {item.object_type for item in od.objects.values()} == {2, 7, 8, 9}


def test_rich_eds_agrees_with_python_canopen() -> None:
    logging.disable(logging.CRITICAL)
    with contextlib.closing(io.StringIO(RICH)) as file:
        other = import_eds(file, 0x20)
    logging.disable(logging.NOTSET)
    # Where it does not sign-extend: python-canopen knows only 8, 16, 32 and 64 bits.
    odd = {DataType.INTEGER24, DataType.INTEGER40, DataType.INTEGER48, DataType.INTEGER56}
    compared = 0
    for entry in load_eds(RICH, 0x20):
        theirs = other.get_variable(entry.index, entry.subindex)
        assert theirs is not None, entry
        if theirs.default is None or entry.index == 0x2210:
            continue
        if entry.data_type in SIGNED_BY_HEX and entry.value < 0 and theirs.default > 0:
            assert theirs.default == entry.value + (1 << 8 * entry.size)
        else:
            assert theirs.default == entry.value, entry
        assert theirs.access_type == entry.access
        assert theirs.pdo_mappable == entry.pdo
        compared += entry.data_type not in odd
    assert compared > 150


SIGNED_BY_HEX = {
    DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER24, DataType.INTEGER32,
    DataType.INTEGER40, DataType.INTEGER48, DataType.INTEGER56, DataType.INTEGER64,
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "data_type", "value"),
    [
        ("0x10", "0x0007", 16),
        ("017", "0x0007", 15),
        ("-5", "0x0002", -5),
        ("0xFE", "0x0002", -2),
        ("0xFFFFFE", "0x0010", -2),
        ("0x7FFFFF", "0x0010", 0x7FFFFF),
        ("$NODEID+0x180", "0x0007", 0x185),
        ("0x180+$NODEID", "0x0007", 0x185),
        ("0x180 + $nodeid", "0x0007", 0x185),
        ("$NODEID", "0x0005", 5),
        ("1.5", "0x0008", 1.5),
        ("0x3FC00000", "0x0008", 1.5),
        ("0xC002000000000000", "0x0011", -2.25),
        ("01 02 ff", "0x000A", b"\x01\x02\xff"),
        ("0", "0x000C", bytes(6)),
        ("a b", "0x0009", "a b"),
        ("", "0x0009", ""),
        ("", "0x0004", 0),
        ("1", "0x0001", 1),
        ("5 ; a comment", "0x0005", 5),
    ],
)
def test_default(text: str, data_type: str, value: object) -> None:
    assert default(text, data_type) == value


@pytest.mark.parametrize(
    ("text", "data_type", "message"),
    [
        ("300", "0x0005", "is outside UNSIGNED8"),
        ("0x1FF", "0x0002", "is outside INTEGER8"),
        ("-1", "0x0007", "is outside UNSIGNED32"),
        ("abc", "0x0007", "is no integer"),
        ("09", "0x0007", "is no octal number"),
        ("x", "0x0008", "is no REAL32"),
        ("1e39", "0x0008", "is outside REAL32"),
        ("nan", "0x0011", "is outside REAL64"),
        ("0x1FFFFFFFF", "0x0008", "is no REAL32"),
        ("xyz", "0x000A", "is no hexadecimal string"),
        ("0102", "0x000C", "is not 6 bytes long"),
        ("1", "0x0040", "datatype 0x40 is not supported"),
    ],
)
def test_default_that_cannot_be_interpreted(text: str, data_type: str, message: str) -> None:
    with pytest.raises(EDSError, match=message) as refusal:
        default(text, data_type)
    assert "[2000]" in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("text", "taken"),
    [("5 µm", "5 ?m"), ("a\tµ", "a\t?"), ("Prüfstand", "Pr?fstand")],
)
def test_eds_replaces_characters_beyond_visible_string(text: str, taken: str) -> None:
    od = load_eds(var(f"DefaultValue={text}", data_type="0x0009"), 1)
    assert f"[2000] value {text!r} is no VISIBLE_STRING, {taken!r} is taken instead" in od.warnings
    assert od["X"].value == od["X"].default == taken
    unicode = load_eds(var(f"DefaultValue={text}", data_type="0x000B"), 1)
    assert unicode["X"].value == text
    assert not [warning for warning in unicode.warnings if "STRING" in warning]


def test_all_lines_with_other_characters_are_counted() -> None:
    text = var("DefaultValue=1", "Denotation=ä", "Denotation=ä")
    assert load_eds(text, 1).warnings == ["line 9 and of 1 more: not all characters are ASCII"]


def test_limits() -> None:
    od = load_eds(var("LowLimit=0x80", "HighLimit=5", "DefaultValue=-3", data_type="0x0002"), 1)
    assert (od["X"].low, od["X"].high, od["X"].default) == (-128, 5, -3)
    assert od.warnings == []
    od = load_eds(var("LowLimit=7"), 1)
    assert od["X"].value == 7, "without a default the value still keeps its limits"


@pytest.mark.parametrize(
    ("lines", "warning"),
    [
        (["LowLimit=9", "HighLimit=3"], "LowLimit 9 is above HighLimit 3, both ignored"),
        (["HighLimit=3", "DefaultValue=4"], "default 4 is outside its limits None..3"),
        (["what is this"], "line 8: 'what is this' is no key of a section, ignored"),
        (
            ["[2000]", "Denotation=5 µm"],
            "line 9: not all characters are ASCII",
        ),
        (["[Gibberish]"], "section [gibberish] is not known, ignored"),
        (["[2001sub1]"], "[2001sub1] belongs to no object, ignored"),
        (["[2000sub1]", "ParameterName=Y"], "[2000] says SubNumber"),
        (["[2000]", "PDOMapping=1"], "line 8: section [2000] comes again, merged"),
        (["[2001]", "DataType=5", "AccessType=ro"], "[2001] has no ParameterName"),
        (
            ["[2001]", "ObjectType=5", "ParameterName=D"],
            "[2001] is of object type DEFTYPE, ignored",
        ),
        (["[ManufacturerObjects]", "1=0x2001"], "[2001] is listed but not described"),
    ],
)
def test_odd_but_unambiguous_gives_a_warning(lines: list[str], warning: str) -> None:
    text = var(*lines)
    if "SubNumber" in warning:
        text = text.replace("[2000]", "[2000]\nObjectType=9\nSubNumber=4")
        text += "\nDataType=5\nAccessType=ro"
    assert any(warning in line for line in load_eds(text, 1).warnings)


def test_unlisted_object_gives_a_warning() -> None:
    text = var() + "\n[2001]\nParameterName=Y\nDataType=5\nAccessType=ro"
    assert load_eds(text, 1).warnings == ["[2001] is described but not listed"]


def test_unknown_unit_gives_a_warning_and_stays_in_the_name() -> None:
    od = load_eds(var().replace("=X", "=Word [low byte]"), 1)
    assert od["Word [low byte]"].unit == ONE
    assert "unit 'low byte' is not known" in od.warnings[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file has no objects"),
        (var("DataType=5"), "datatype is both 0x0007 and 5"),
        (var(access="xx"), r"\[2000\] AccessType 'xx' is none of ro, wo"),
        (var().replace("AccessType", "Access"), "AccessType '' is none of"),
        (var("[2000sub1]", "[2000sub01]"), "are the same sub-index"),
        (var("ObjectType=9"), r"\[2000\] has no sub-indices"),
        (var("ObjectType=0x77"), "objecttype 0x77 is not supported"),
    ],
)
def test_eds_refuses_values_without_a_meaning(text: str, message: str) -> None:
    with pytest.raises(EDSError, match=message):
        load_eds(text, 1)


@pytest.mark.parametrize("node_id", [0, 128, 10**400, "32", 32.0, None])
def test_node_id_out_of_range(node_id: Any) -> None:
    with pytest.raises(ValueError, match=rf"^node_id {node_id!r} is no integer of 1\.\.127$"):
        load_eds(RICH, node_id)


def test_units_and_names() -> None:
    od = load_eds(RICH, 1)
    entry = od["Setpoint.Voltage"]
    assert (entry.index, entry.subindex, entry.si) == (0x2100, 1, 0.01)
    assert str(entry.unit) == "10 mV"
    assert (entry.low, entry.high, entry.access, entry.pdo) == (0, 20000, "rww", True)
    assert od["Mode"].index == 0x2110


def test_compact_array() -> None:
    od = load_eds(RICH, 1)
    assert [e.value for e in od.objects[0x2210].entries.values()] == [3, 10, 10, -7]
    assert od["Gain.Direct"].si == 1e-4
    assert od["Gain.Quadrature"].subindex == 2


def test_compact_array_with_some_names() -> None:
    text = var("ObjectType=8", "CompactSubObj=2", "[2000Name]", "NrOfEntries=1", "2=Second")
    od = load_eds(text, 1)
    assert od.warnings == []
    assert (od["X.X1"].subindex, od["X.Second"].subindex, od["X.NrOfObjects"].value) == (1, 2, 2)


def test_parameter_value_of_a_dcf_stands_for_the_default() -> None:
    assert load_eds(var("DefaultValue=1", "ParameterValue=2"), 1)["X"].default == 2


def test_missing_object_type_is_a_var_or_a_record() -> None:
    text = var().replace("DataType=0x0007\nAccessType=rw", "")
    text += "\n[2000sub0]\nParameterName=N\nDataType=5\nAccessType=const"
    assert load_eds(text, 1).objects[0x2000].object_type == ObjectType.RECORD
    assert load_eds(var(), 1).objects[0x2000].object_type == ObjectType.VAR


def test_bom_and_spelling_do_not_matter() -> None:
    text = "\ufeff" + var("DefaultValue=3").upper().replace("RW", "Rw")
    assert load_eds(text, 1)["X"].value == 3


@given(st.text(alphabet="[]=0129AFSub$NODEID+x;\n -.\\", max_size=80), st.integers(0, 900))
@settings(max_examples=150)
def test_any_damage_gives_a_dictionary_or_one_line(noise: str, line: int) -> None:
    lines = RICH.splitlines()[60:160]
    at = line % len(lines)
    try:
        od = load_eds("\n".join([*lines[:at], noise, *lines[at + 1 :]]), 1)
    except EDSError as error:
        assert "\n" not in str(error)
    else:
        assert isinstance(od, ObjectDictionary)


def test_a_file_has_an_end() -> None:
    load_eds(var(*[";"] * 39_992, "PDOMapping=0"), 1)
    with pytest.raises(EDSError, match="there are more than 40000 lines"):
        load_eds(var(*[";"] * 39_993, "PDOMapping=0"), 1)


def test_a_file_with_more_than_1000_odd_lines_is_none() -> None:
    assert len(load_eds(var(*["odd"] * 1000, "PDOMapping=0"), 1).warnings) >= 1000
    with pytest.raises(EDSError, match="more than 1000 lines before it are odd"):
        load_eds(var(*["odd"] * 1001, "PDOMapping=0"), 1)


def test_the_sub_indices_of_a_device_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """CompactSubObj makes 254 of them in a line, beside the one that counts them."""
    assert module.MAX_ENTRIES == 32_768, "which take seconds"
    monkeypatch.setattr(module, "MAX_ENTRIES", 513)
    array = ("ParameterName=X", "ObjectType=8", "DataType=5", "AccessType=ro")
    lines = [f"[{0x3000 + i:X}]\n" + "\n".join((*array, "CompactSubObj=254")) for i in range(2)]
    lines += ["[4000]", *array]
    assert sum(1 for _ in load_eds(eds(*lines, "CompactSubObj=2"), 1)) == 513
    with pytest.raises(EDSError, match="there are more than 513 sub-indices"):
        load_eds(eds(*lines, "CompactSubObj=3"), 1)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (
            [
                "ObjectType=8",
                "SubNumber=0x" + "F" * 5000,
                "[2000sub0]",
                "DataType=5",
                "AccessType=ro",
            ],
            r"\[2000\] subnumber is no integer",
        ),
        (["ObjectType=8", "CompactSubObj=" + "9" * 5000], r"\[2000\] compactsubobj is no integer"),
        (["DefaultValue=" + "9" * 5000], "is no integer"),
        (["ParameterName=" + "n" * 242], "ParameterName is longer than 241 characters"),
        (
            ["ObjectType=8", "CompactSubObj=1", "[2000Name]", "1=" + "n" * 242],
            r"\[2000sub1\] ParameterName is longer than 241 characters",
        ),
        (["DefaultValue=\x1b"], r"line 8: '\\x1b' is a control character"),
        (["[20\x9b]"], r"line 8: '\\x9b' is a control character"),
    ],
)
def test_eds_refuses_entries_beyond_any_device(lines: list[str], message: str) -> None:
    body = ["ParameterName=X"] if not lines[0].startswith("ParameterName") else []
    text = eds("[2000]", *body, "DataType=7", "AccessType=rw", *lines)
    with pytest.raises(EDSError, match=message) as caught:
        load_eds(text, 1)
    assert "\x1b" not in str(caught.value)


def test_a_comment_may_hold_anything() -> None:
    assert load_eds(var("; \x1b[31m", "DefaultValue=3 ;\0"), 1)["X"].value == 3
