import pytest

from smarttac_can.canopen.od.cia import Abort, AbortCode, DataType, ObjectType
from smarttac_can.canopen.od.dictionary import Object, ObjectDictionary
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.canopen.od.entry import MAX_BYTES, Entry


def voltage() -> Entry:
    return Entry(0x2100, 1, "Setpoint.Voltage", DataType.UNSIGNED16, "rww", default=100)


def dictionary(*entries: Entry) -> ObjectDictionary:
    objects = [Object(e.index, e.name, ObjectType.VAR, {e.subindex: e}) for e in entries]
    return ObjectDictionary(0x20, objects)


@pytest.mark.parametrize(
    ("data_type", "value", "code"),
    [
        (DataType.UNSIGNED8, 256, AbortCode.TOO_HIGH),
        (DataType.UNSIGNED8, -1, AbortCode.TOO_LOW),
        (DataType.UNSIGNED8, 1.0, AbortCode.LENGTH),
        (DataType.REAL64, float("nan"), AbortCode.VALUE),
        (DataType.REAL32, float("inf"), AbortCode.TOO_HIGH),
        (DataType.VISIBLE_STRING, b"x", AbortCode.LENGTH),
        (DataType.DOMAIN, "x", AbortCode.LENGTH),
        (DataType.DOMAIN, bytes(MAX_BYTES + 1), AbortCode.TOO_LONG),
    ],
)
def test_write_refuses_and_changes_nothing(data_type: DataType, value: object, code: int) -> None:
    entry = Entry(0x2000, 0, "X", data_type, "rw", default=0)
    with pytest.raises(Abort) as refusal:
        dictionary(entry).write("X", value, lambda *_: None)
    assert refusal.value.code == code
    assert entry.value == 0


def test_lookup() -> None:
    entry = voltage()
    od = dictionary(entry)
    assert od["Setpoint.Voltage"] is od.entry(0x2100, 1) is od.get(0x2100, 1) is entry
    assert "Setpoint.Voltage" in od
    assert list(od) == [entry]
    assert od.number(0x2100, 1) == 100
    assert od.number(0x2100, 2, 7) == 7
    with pytest.raises(KeyError, match="'Voltage' is not in the EDS"):
        od["Voltage"]
    for address, code in (((0x2101, 0), AbortCode.NO_OBJECT), ((0x2100, 2), AbortCode.NO_SUBINDEX)):
        with pytest.raises(Abort) as refusal:
            od.entry(*address)
        assert refusal.value.code == code


def test_ambiguous_name_is_an_error_only_when_looked_up() -> None:
    od = dictionary(
        Entry(0x2000, 0, "Same", DataType.UNSIGNED8, "rw"),
        Entry(0x2001, 0, "Same", DataType.UNSIGNED8, "rw"),
    )
    assert "Same" not in od
    with pytest.raises(KeyError, match="'Same' stands for several entries"):
        od["Same"]


def test_reset_touches_only_its_range() -> None:
    first, second = voltage(), Entry(0x1017, 0, "Heartbeat", DataType.UNSIGNED16, "rw", default=3)
    od = dictionary(first, second)
    first.value = second.value = 500
    od.reset(0x1000, 0x1FFF)
    assert (first.value, second.value) == (500, 3)


def test_abort_text_names_its_code() -> None:
    assert str(Abort(AbortCode.TOO_HIGH)) == "abort 06090031: value written too high"
    assert str(Abort(0x08001234)) == "abort 08001234: manufacturer specific"


@pytest.mark.parametrize(
    ("name", "address"),
    [
        ("Contact.COF", (0x2001, 1)),
        ("Contact.COF [0.0001]", (0x2001, 1)),
        ("COF [0.0001]", (0x2001, 1)),
        ("COF", (0x2001, 1)),
        ("COF [0.001]", None),
        ("Contact.COF [0.001]", None),
        ("Speed", None),  # of two records
        ("Speed [mm/s]", (0x2002, 1)),
        ("Force", None),
    ],
)
def test_an_object_is_called_with_or_without_its_unit(
    name: str, address: tuple[int, int] | None
) -> None:
    members = {
        0x2001: ("Contact", ("COF [0.0001]", "Speed [0.1 mm/s]")),
        0x2002: ("Finger", ("Speed [mm/s]",)),
    }
    text = ""
    for index, (record, names) in members.items():
        text += f"[{index:X}]\nParameterName={record}\nObjectType=9\n"
        for number, member in enumerate(names, 1):
            text += f"[{index:X}sub{number}]\nParameterName={member}\nDataType=3\nAccessType=rw\n"
    found = load_eds(text, 5).called(name)
    assert (found and (found.index, found.subindex)) == address
