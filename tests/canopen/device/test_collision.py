import pytest
from one_device import download, make_device, play, started

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.service import Application


class Listener(Application):
    def __init__(self) -> None:
        self.told: list[bool] = []

    def on_collision(self, heard: bool) -> None:
        self.told.append(heard)


@pytest.fixture
def listener() -> Listener:
    return Listener()


def hears(device: Device, can_id: int, data: bytes = bytes(8), *, rtr: bool = False) -> bool:
    device.receive(Frame(can_id, data, rtr))
    return device.collision == can_id


@pytest.mark.parametrize("can_id", [0x0A0, 0x1A0, 0x5A0, 0x720])
def test_an_identifier_of_its_own_is_heard_in_every_state(can_id: int) -> None:
    for command in (0x01, 0x02, 0x80):
        device = started(operational=False)
        device.receive(Frame(0, bytes((command, 0x20))))
        assert can_id in device.ids.heard
        assert hears(device, can_id)


def test_it_is_told_once_and_once_when_it_is_gone(listener: Listener) -> None:
    device = started(listener)
    for _ in range(3):
        device.receive(Frame(0x720, b"\5"))
        device.receive(Frame(0x5A0, bytes(8)))
        device.advance(2_999_999)
        assert (listener.told, device.collision) == ([True], 0x720)
    device.advance(1)
    assert (listener.told, device.collision) == ([True, False], 0)
    device.receive(Frame(0x0A0, bytes(8)))
    assert listener.told == [True, False, True]


def test_remote_frames_ask_for_one_of_its_own() -> None:
    device = started()
    for can_id in (0x1A0, 0x720):
        assert not hears(device, can_id, b"", rtr=True)


@pytest.mark.parametrize("can_id", [0x080, 0x200, 0x620, 0x7E4, 0x1A1, 0x721])
def test_others_are_not_its_own(can_id: int) -> None:
    assert not hears(started(), can_id)


def test_a_pdo_that_is_off_has_no_identifier() -> None:
    device = started()
    assert download(device, 0x1800, 1, 0x800001A0, 4) == 0
    assert not hears(device, 0x1A0)
    assert download(device, 0x1800, 1, 0x000001B1, 4) == 0
    assert not hears(device, 0x1A0)
    assert hears(device, 0x1B1)


def test_sync_is_the_producers() -> None:
    device = started()
    assert download(device, 0x1005, 0, 0x40000080, 4) == 0
    assert not hears(device, 0x080, b""), "without a period it produces none"
    assert download(device, 0x1006, 0, 1000, 4) == 0
    assert hears(device, 0x080, b"")


def test_a_reset_forgets_it_and_is_obeyed(listener: Listener) -> None:
    device = make_device(listener)
    play(
        device,
        """
        power
        < 720 00
        > 720 05
        > 000 82 20
        < 720 00
        > 000 01 20
        """,
    )
    assert device.collision == 0
    device.advance(4_000_000)
    assert listener.told == [True]


def test_collision_alone_sends_no_frame() -> None:
    play(started(), "> 720 05\n> 720 00\n> 0A0 00 00 00 00 00 00 00 00\n3x + 1000ms")
