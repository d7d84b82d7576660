import pytest
from one_device import download, play, started, upload

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState


def history(device: Device) -> list[int]:
    return [device.od.entry(0x1003, k).value for k in range(5)]


def test_error_comes_and_goes() -> None:
    device = started()
    device.emergency(0x4210, 0x08, b"\x01\x02\x03\x04\x05")
    assert device.take() == [Frame(0x0A0, bytes.fromhex("10 42 09 01 02 03 04 05"))]
    assert device.od.entry(0x1001).value == 0x09
    device.emergency(0x4210, 0x08)
    assert device.take() == [], "known already"
    device.clear_emergency(0x4210)
    assert device.take() == [Frame(0x0A0, bytes(8))]
    assert device.od.entry(0x1001).value == 0
    device.clear_emergency(0x4210)
    assert device.take() == []


def test_register_keeps_the_bits_of_the_other_errors() -> None:
    device = started()
    device.emergency(0x4210, 0x08)
    device.emergency(0x2310, 0x02)
    device.take()
    device.clear_emergency(0x4210)
    assert device.take() == [Frame(0x0A0, bytes.fromhex("00 00 03 00 00 00 00 00"))]
    assert device.od.entry(0x1001).value == 0x03


def test_history_has_the_newest_first_and_no_resets() -> None:
    device = started()
    assert upload(device, 0x1003, 0) == b"\0"
    assert upload(device, 0x1003, 1) == 0x08000024
    for k in range(1, 7):
        device.emergency(0xFF00 + k, 0x80, bytes((k, 0xAA, 0xBB)))
        device.clear_emergency(0xFF00 + k)
        assert history(device)[:2] == [min(k, 4), 0xAA00FF00 + k * 0x10001]
    assert [h & 0xFFFF for h in history(device)[1:]] == [0xFF06, 0xFF05, 0xFF04, 0xFF03]
    assert len(device.take()) == 12
    assert upload(device, 0x1003, 4) == bytes.fromhex("03 FF 03 AA")


def test_inhibit_time() -> None:
    device = started()
    assert download(device, 0x1015, 0, 30, 2) == 0
    for code in (0xFF01, 0xFF02, 0xFF03):
        device.emergency(code, 0x80)
    play(
        device,
        """
        + 0us
        < 0A0 01 FF 81 00 00 00 00 00
        + 2999us
        + 1us
        < 0A0 02 FF 81 00 00 00 00 00
        + 3ms
        < 0A0 03 FF 81 00 00 00 00 00
        + 10ms
        """,
    )


def test_emcy_after_stopped_is_the_latest_and_history_has_all() -> None:
    device = started()
    play(device, "> 000 02 20")
    device.emergency(0xFF01, 0x80)
    device.emergency(0xFF02, 0x80)
    play(device, "+ 1ms\n> 000 80 20\n< 0A0 02 FF 81 00 00 00 00 00\n+ 1ms")
    assert history(device)[0] == 2


@pytest.mark.parametrize("command", ["81", "82"])
def test_reset_forgets_errors(command: str) -> None:
    device = started()
    device.emergency(0xFF01, 0x80)
    device.take()
    play(device, f"> 000 {command} 20\n< 720 00")
    assert history(device) == [0] * 5
    assert device.od.entry(0x1001).value == 0
    device.emergency(0xFF01, 0x80)
    assert len(device.take()) == 1


def test_cob_id() -> None:
    device = started()
    assert download(device, 0x1014, 0, 0xA1, 4) == 0x08000022
    assert download(device, 0x1014, 0, 0x800000A0, 4) == 0
    device.emergency(0xFF01, 0x80)
    assert device.take() == []
    assert history(device)[0] == 1
    assert download(device, 0x1014, 0, 0x7F, 4) == 0x06090030
    assert download(device, 0x1014, 0, 0xA1, 4) == 0
    device.clear_emergency(0xFF01)
    assert device.take() == [Frame(0x0A1, bytes(8))]


def test_a_flood_is_bounded() -> None:
    device = started()
    assert download(device, 0x1015, 0, 10, 2) == 0
    for code in range(1, 100):
        device.emergency(code, 0)
    sent = [f for _ in range(200) for f in device.advance(1000)]
    assert len(sent) == 1 + 16
    assert sent[-1].data[0] == 99


@pytest.mark.parametrize(
    ("code", "register", "vendor", "message"),
    [
        (0, 0, b"", "code 0 is outside 1..65535"),
        (0x10000, 0, b"", "code 65536 is outside"),
        (1, 256, b"", r"register 256 is outside 0\.\.255"),
        (1, 0, bytes(6), r"vendor of 6 bytes is outside 0\.\.5"),
    ],
)
def test_emcy_refuses_fields_beyond_a_frame(
    code: int, register: int, vendor: bytes, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        started().emergency(code, register, vendor)


STATES = {0: NMTState.PRE_OPERATIONAL, 1: NMTState.OPERATIONAL, 2: NMTState.STOPPED}


@pytest.mark.parametrize("behaviour", STATES)
def test_communication_error_behaviour_1029h_sets_the_nmt_state(behaviour: int) -> None:
    device = started()
    assert download(device, 0x1029, 1, behaviour, 1) == 0
    device.bus_off()
    assert device.nmt_state is STATES[behaviour]


def test_bus_off() -> None:
    device = started()
    assert device.bus_off() == []
    assert device.nmt_state is NMTState.PRE_OPERATIONAL
    sent = device.bus_recovered()
    assert [f.data.hex(" ") for f in sent] == ["40 81 11 00 00 00 00 00", "00 00 00 00 00 00 00 00"]
    play(device, "> 620 40 03 10 01 00 00 00 00\n< 5A0 43 03 10 01 40 81 00 00")


def test_stopped_stays_stopped() -> None:
    device = started()
    play(device, "> 000 02 20")
    device.bus_off()
    assert device.nmt_state is NMTState.STOPPED
