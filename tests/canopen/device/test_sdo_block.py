from binascii import crc_hqx

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from one_device import fewer_bytes, play, receive, started

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame

DOMAIN = 0x2300
TEXT = bytes(k * 37 & 0xFF for k in range(2000))


def ask(device: Device, request: bytes) -> list[bytes]:
    return [f.data for f in receive(device, Frame(0x620, request.ljust(8, b"\0")))]


def address(index: int) -> bytes:
    return index.to_bytes(2, "little") + b"\0"


def write_block(
    device: Device,
    data: bytes,
    *,
    index: int = DOMAIN,
    size: int | None = None,
    crc: int | None = None,
    lost: frozenset[int] = frozenset(),
) -> int:
    """Write; the nth segments sent that are in `lost` do not arrive. Return the abort code."""
    stated = (len(data) if size is None else size).to_bytes(4, "little")
    (answer,) = ask(device, b"\xc6" + address(index) + stated)
    if answer[0] == 0x80:
        return int.from_bytes(answer[4:], "little")
    assert answer == b"\xa4" + address(index) + bytes((127, 0, 0, 0))
    total = max(1, -(-len(data) // 7))
    done = sent = 0
    while done < total:
        count = min(127, total - done)
        answers: list[bytes] = []
        for k in range(1, count + 1):
            last = (done + k == total) << 7
            part = data[7 * (done + k - 1) : 7 * (done + k)]
            if sent not in lost or k == 1:
                assert not answers, "answered within the sub-block"
                answers += ask(device, bytes((last | k,)) + part)
            sent += 1
        if not answers:
            answers = [f.data for f in device.advance(500_000)]
        ((command, confirmed, block_size, *_),) = answers
        if command == 0x80:
            return int.from_bytes(answers[0][4:], "little")
        assert (command, block_size) == (0xA2, 127)
        done += confirmed
    crc = crc_hqx(data, 0) if crc is None else crc
    unused = 7 * total - len(data)
    (answer,) = ask(device, bytes((0xC1 | unused << 2,)) + crc.to_bytes(2, "little"))
    assert answer == b"\xa1" + bytes(7) or answer[0] == 0x80
    return 0 if answer[0] == 0xA1 else int.from_bytes(answer[4:], "little")


def read_block(device: Device, block_size: int, lost: frozenset[int] = frozenset()) -> bytes:
    """Read; the nth segments sent that are in `lost` do not arrive."""
    (answer,) = ask(device, b"\xa4" + address(DOMAIN) + bytes((block_size, 0)))
    assert answer[:4] == b"\xc6" + address(DOMAIN)
    data, sent, confirmed = b"", 0, 0
    answers = ask(device, b"\xa3")
    while answers[0][0] not in range(0xC1, 0xE0):
        confirmed = 0
        for k, segment in enumerate(answers, 1):
            assert segment[0] & 0x7F == k <= block_size
            if sent not in lost and confirmed == k - 1:
                confirmed = k
                data += segment[1:]
            sent += 1
        answers = ask(device, bytes((0xA2, confirmed, block_size)))
    ((command, low, high, *rest),) = answers
    data = data[: len(data) - (command >> 2 & 7)]
    assert rest == [0] * 5
    assert crc_hqx(data, 0) == low | high << 8
    assert len(data) == int.from_bytes(answer[4:], "little")
    assert ask(device, b"\xa1") == []
    assert device.advance(2_000_000) == []
    return data


def test_download_with_neither_checksum_nor_size() -> None:
    device = started()
    play(
        device,
        """
        > 620 C0 10 21 00 00 00 00 00
        < 5A0 A4 10 21 00 7F 00 00 00
        > 620 81 03 00 00 00 00 00 00
        < 5A0 A2 01 7F 00 00 00 00 00
        > 620 D9 AA AA 00 00 00 00 00
        < 5A0 A1 00 00 00 00 00 00 00
        """,
    )
    assert device.od["Mode"].value == 3


@pytest.mark.parametrize("size", [0, 1, 4, 7, 8, 127 * 7 - 1, 127 * 7, 127 * 7 + 1, 2000])
@pytest.mark.parametrize("block_size", [1, 2, 127])
def test_any_length(size: int, block_size: int) -> None:
    device = started()
    data = (TEXT * 2)[:size]
    assert write_block(device, data) == 0
    assert device.od["Texture"].value == data
    assert read_block(device, block_size) == data


@pytest.mark.sources
def test_the_most_bytes_and_not_a_byte_more(monkeypatch: pytest.MonkeyPatch) -> None:
    device, most = started(), fewer_bytes(monkeypatch)
    data = TEXT * 2
    assert write_block(device, data[:most]) == 0
    assert read_block(device, 127) == data[:most]
    assert write_block(device, data[: most + 1]) == 0x06070012
    assert device.od["Texture"].value == data[:most]


@given(
    st.integers(1, 1800),
    st.frozensets(st.integers(0, 300), max_size=12),
    st.frozensets(st.integers(0, 300), max_size=12),
    st.integers(1, 127),
)
@settings(max_examples=60)
def test_lost_segments_are_sent_again(
    size: int, down: frozenset[int], up: frozenset[int], block_size: int
) -> None:
    device = started()
    assert write_block(device, TEXT[:size], lost=down) == 0
    assert read_block(device, block_size, lost=up) == TEXT[:size]


@pytest.mark.parametrize("block_size", [1, 127])
def test_sdo_block_upload_aborts_after_repeated_zero_ackseq(block_size: int) -> None:
    device = started()
    assert write_block(device, TEXT[:1000]) == 0

    def request(*data: int) -> list[Frame]:
        return receive(device, Frame(0x620, bytes(data).ljust(8, b"\0")))

    def begin() -> None:
        assert request(0xA0, 0x00, 0x23, 0, block_size)[0].data[0] == 0xC6
        assert len(request(0xA3)) == block_size

    begin()
    for _ in range(15):
        assert len(request(0xA2, 0, block_size)) == block_size
    (answer,) = request(0xA2, 0, block_size)
    assert answer.data == bytes.fromhex("80 00 23 00 00 00 04 05")
    begin()
    for heard in (0, 1, 0) * 9:
        assert request(0xA2, heard, block_size)[0].data[0] != 0x80, "nothing in two of three"


def test_no_frame_has_more_than_a_sub_block_summed_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """The checksum of 1 MiB takes longer than a cycle of the loop."""
    summed: list[int] = []

    def spy(data: bytes, crc: int) -> int:
        summed.append(len(data))
        return crc_hqx(data, crc)

    monkeypatch.setattr("smarttac_can.canopen.device.sdo.crc_hqx", spy)
    device = started()
    data = TEXT * 10
    assert write_block(device, data, lost=frozenset({5, 300, 1000})) == 0
    assert sum(summed) == len(data)
    assert read_block(device, 100, lost=frozenset({5, 300, 1000})) == data
    assert sum(summed) == 2 * len(data)
    assert max(summed) <= 127 * 7


def test_wrong_checksum_and_length_change_nothing() -> None:
    device = started()
    assert write_block(device, b"123456789", crc=0x31C2) == 0x05040004
    assert write_block(device, b"123456789", size=10) == 0x06070013
    assert write_block(device, b"123456789", size=8) == 0x06070012
    assert write_block(device, TEXT, size=8) == 0x06070012
    assert write_block(device, b"\x07", index=0x2110) == 0x06090031
    assert write_block(device, b"\x01\x02", index=0x2110) == 0x06070012
    assert write_block(device, b"\x01", index=0x2111) == 0x06010002
    assert device.od["Texture"].value == b""
    assert write_block(device, b"123456789") == 0


def test_a_sub_block_too_long_is_swallowed_before_it_is_refused() -> None:
    """Late segments of the client would else be taken for requests, such as 23h."""
    device = started()
    ask(device, b"\xc0" + address(0x2110))
    for k in range(1, 127):
        assert ask(device, bytes((k,)) + b"\x10\x21\x00\x02\0\0\0") == []
    (answer,) = ask(device, b"\x7f")
    assert answer == b"\x80" + address(0x2110) + bytes.fromhex("12000706")
    assert device.od["Mode"].value == 0


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("A4 08 10 00 7F 10", "C6 08 10 00 11"),
        ("A4 08 10 00 7F 11", "41 08 10 00 11"),
        ("A4 08 10 00 7F FF", "41 08 10 00 11"),
        ("A4 17 10 00 7F 04", "4B 17 10 00 00"),
    ],
)
def test_protocol_switch_threshold(request_: str, answer: str) -> None:
    play(started(), f"> 620 {request_} 00 00\n< 5A0 {answer} 00 00 00")


def test_no_data_is_one_segment_that_can_be_lost() -> None:
    play(
        started(),
        """
        > 620 A4 00 23 00 7F 00 00 00
        < 5A0 C6 00 23 00 00 00 00 00
        > 620 A3 00 00 00 00 00 00 00
        < 5A0 81 00 00 00 00 00 00 00
        > 620 A2 00 7F 00 00 00 00 00
        < 5A0 81 00 00 00 00 00 00 00
        > 620 A2 01 7F 00 00 00 00 00
        < 5A0 DD 00 00 00 00 00 00 00
        """,
    )


def test_steps_out_of_order() -> None:
    device = started()
    for step in (b"\xa1", b"\xa2\x01\x7f"):
        ask(device, b"\xa4\x08\x10\x00\x7f")
        assert ask(device, step) == [bytes.fromhex("8008100001000405")]
    ask(device, b"\xa4\x08\x10\x00\x7f")
    ask(device, b"\xa3")
    assert ask(device, b"\xa3") == [bytes.fromhex("8008100001000405")]


def test_abandoned_transfers_are_freed_by_the_time_out() -> None:
    abort = "< 5A0 80 00 23 00 00 00 04 05\n+ 3000ms"
    device = started()
    play(device, "> 620 C0 00 23 00 00 00 00 00\n< 5A0 ..\n+ 999ms\n+ 1ms\n" + abort)
    play(
        device,
        "> 620 C0 00 23 00 00 00 00 00\n< 5A0 ..\n> 620 01 00 00 00 00 00 00 00\n+ 499ms\n+ 1ms\n"
        "< 5A0 A2 01 7F 00 00 00 00 00       # perhaps the last segment was lost\n+ 499ms\n+ 1ms\n"
        + abort,
    )
    for last in ("7F", "FF"):
        segments = "".join(f"> 620 {k:02X} 00 00 00 00 00 00 00\n" for k in range(1, 127))
        play(
            device,
            f"> 620 C0 00 23 00 00 00 00 00\n< 5A0 ..\n{segments}> 620 {last}{' 00' * 7}\n"
            "< 5A0 A2 7F 7F 00 00 00 00 00       # nothing of the next sub-block, or no end\n"
            "+ 999ms\n+ 1ms\n" + abort,
        )
    play(device, "> 620 A0 00 23 00 7F 00 00 00\n< 5A0 ..\n+ 999ms\n+ 1ms\n" + abort)


def test_the_client_may_abort_within_a_sub_block() -> None:
    device = started()
    ask(device, b"\xc0" + address(DOMAIN))
    assert ask(device, b"\x01") == []
    assert ask(device, b"\x80" + address(DOMAIN)) == []
    assert device.advance(3_000_000) == []
    assert ask(device, b"\x2f\x10\x21\x00\x02") == [b"\x60\x10\x21\x00" + bytes(4)]


def test_time_out_object() -> None:
    device = started()
    device.od["SDO server time-out"].value = 20
    play(
        device,
        "> 620 A0 00 23 00 7F 00 00 00\n< 5A0 ..\n+ 19ms\n+ 1ms\n< 5A0 80 00 23 00 00 00 04 05",
    )


def test_python_canopen_as_client() -> None:
    device = started()
    network = canopen.Network()

    def send(can_id: int, data: bytes, remote: bool = False) -> None:
        for frame in receive(device, Frame(can_id, bytes(data), remote)):
            network.notify(frame.can_id, bytearray(frame.data), 0.0)

    network.send_message = send
    node = network.add_node(0x20, canopen.ObjectDictionary())
    text = TEXT[:1500]
    with node.sdo.open(DOMAIN, 0, "wb", block_transfer=True, size=len(text)) as stream:
        stream.write(text)
    assert device.od["Texture"].value == text
    with node.sdo.open(DOMAIN, 0, "rb", block_transfer=True) as stream:
        assert stream.read() == text
