import pytest
from one_device import download, play, started
from read_once import read_once
from rich_eds import RICH

from smarttac_can.canopen.device.device import Device

MODE, VOLTAGE, COUNTER = 0x21100008, 0x21000110, 0x21200020
ABORT_STATE, NO_MAP, LENGTH, ACCESS = 0x08000022, 0x06040041, 0x06040042, 0x06010000


def opened(device: Device, n: int = 1, kind: int = 0x1800) -> int:
    """Disable a PDO and set its number of objects to 0; return the index of the mapping."""
    record = kind + n - 1
    assert download(device, record, 1, device.od.entry(record, 1).value | 1 << 31, 4) == 0
    assert download(device, record + 0x200, 0, 0, 1) == 0
    return record + 0x200


def test_remapped_rpdo() -> None:
    device = started()
    mapping = opened(device, kind=0x1400)
    for subindex, value in enumerate((MODE, 0x00050008, 0x20070020), 1):
        assert download(device, mapping, subindex, value, 4) == 0
    assert download(device, mapping, 0, 3, 1) == 0
    assert download(device, 0x1400, 1, 0x220, 4) == 0
    play(device, "> 220 02 EE 00 00 C0 3F")
    assert (device.od["Mode"].value, device.od["REAL32"].value) == (2, 1.5)
    play(device, "> 220 03 EE 00 00 C0 7F\n< 0A0 00 82 11 01 00 07 20 00   # not a number")
    assert device.od["Mode"].value == 2


@pytest.mark.parametrize("kind", [0x1400, 0x1800])
def test_an_object_is_written_only_while_their_number_is_0(kind: int) -> None:
    """Also the object that is there, and one beyond the number."""
    device = started()
    mapping = kind + 0x200
    same, beyond = (device.od.entry(mapping, n).value for n in (1, 8))
    for valid in (True, False):
        if valid:
            assert download(device, mapping, 0, 0, 1) == ABORT_STATE
        assert download(device, mapping, 1, same, 4) == ACCESS
        assert download(device, mapping, 8, beyond, 4) == ACCESS
        assert download(device, mapping, 0, device.od.number(mapping), 1) == 0, "is written back"
        if valid:
            download(device, kind, 1, device.od.entry(kind, 1).value | 1 << 31, 4)
    assert download(device, mapping, 0, 0, 1) == 0
    assert download(device, mapping, 1, same, 4) == 0
    assert download(device, mapping, 8, beyond, 4) == 0


@pytest.mark.parametrize(
    ("value", "tpdo", "rpdo"),
    [
        (0x5FFF0008, 0x06020000, 0x06020000),
        (0x21100108, 0x06090011, 0x06090011),
        (0x21130010, NO_MAP, NO_MAP),  # const
        (0x21100010, NO_MAP, NO_MAP),  # length is not that of the entry
        (0x20000001, NO_MAP, NO_MAP),  # single bits
        (0x20000008, NO_MAP, NO_MAP),
        (0x23010020, NO_MAP, NO_MAP),  # of variable length
        (0x00050010, NO_MAP, NO_MAP),  # a dummy, but longer
        (0x00010001, 0x06020000, 0x06020000),  # DummyUsage says no
        (0x00050108, 0x06020000, 0x06020000),
        (0x00000000, 0, 0),  # clears the place
    ],
)
def test_pdo_mapping_takes_mappable_objects_only(value: int, tpdo: int, rpdo: int) -> None:
    device = started()
    for kind, code in ((0x1800, tpdo), (0x1400, rpdo)):
        mapping = opened(device, kind=kind)
        before = device.od.entry(mapping, 1).value
        assert download(device, mapping, 1, value, 4) == code
        assert device.od.entry(mapping, 1).value == (before if code else value)


def test_number_covers_only_places_that_are_filled() -> None:
    device = started()
    mapping = opened(device)
    assert download(device, mapping, 2, 0, 4) == 0
    assert download(device, mapping, 0, 3, 1) == 0x06020000
    assert download(device, mapping, 0, 9, 1) == 0x06090031
    assert download(device, mapping, 0, 1, 1) == 0


def test_pdo_of_nothing_is_neither_sent_nor_heard() -> None:
    device = started()
    opened(device)
    opened(device, kind=0x1400)
    assert download(device, 0x1800, 1, 0x400001A0, 4) == 0
    assert download(device, 0x1400, 1, 0x220, 4) == 0
    play(device, "! 1\n> 220\n> 220 01")


def test_unresolvable_default_mapping_disables_the_pdo() -> None:
    text = RICH.replace("0x21200020", "0x29990020", 1)
    device = Device(read_once(text, 0x20))
    device.start()
    assert device.od.entry(0x1801, 1).value == 0xC00002A0
    assert download(device, 0x1801, 1, 0x400002A0, 4) == 0x06020000
    play(device, "> 000 01 20\n> 080\n> 080\n> 080\n> 080")


def test_remapping_does_not_touch_the_other_pdos() -> None:
    device = started()
    play(device, "> 080\n> 080")
    opened(device)
    play(device, "> 080\n< 2A0 ..")
