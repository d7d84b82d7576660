from one_device import download, play, started

from smarttac_can.device.frame import Frame

DAY_US = 86_400_000_000
NOON_OF_DAY_3 = "> 100 00 2E 93 02 03 00\n"


def test_time_goes_on_by_device_time() -> None:
    device = started()
    assert device.time is None
    play(device, NOON_OF_DAY_3)
    assert device.time == 3 * DAY_US + DAY_US // 2
    device.advance(1234)
    assert device.time == 3 * DAY_US + DAY_US // 2 + 1234


def test_reserved_bits_are_ignored() -> None:
    device = started()
    play(device, "> 100 00 2E 93 F2 03 00")
    assert device.time == 3 * DAY_US + DAY_US // 2


def test_what_is_no_time() -> None:
    device = started()
    play(device, "> 100 00 2E 93 02 03\n> 100 rtr\n> 101 00 2E 93 02 03 00")
    assert device.time is None


def test_cob_id() -> None:
    device = started()
    assert download(device, 0x1012, 0, 0x80000101, 4) == 0x08000022, "in use"
    assert download(device, 0x1012, 0, 0x00000100, 4) == 0
    play(device, NOON_OF_DAY_3)
    assert device.time is None
    assert download(device, 0x1012, 0, 0x80000101, 4) == 0x06090030, "restricted"
    assert download(device, 0x1012, 0, 0xC0000100, 4) == 0x06090030, "producer"
    assert download(device, 0x1012, 0, 0xA0000100, 4) == 0x06090030, "29 bits"
    assert download(device, 0x1012, 0, 0x80000200, 4) == 0
    device.receive(Frame(0x200, bytes(6)))
    assert device.time == 0


def test_time_outlives_a_reset_and_is_not_heard_while_stopped() -> None:
    device = started()
    play(device, NOON_OF_DAY_3 + "> 000 82 20\n< 720 00\n+ 1ms\n> 000 02 20\n> 100" + " 00" * 6)
    assert device.time == 3 * DAY_US + DAY_US // 2 + 1000
