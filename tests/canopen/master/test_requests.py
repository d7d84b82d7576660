"""Requests of a master, to the byte, and its reading of the answers."""

from __future__ import annotations

from typing import Any

import pytest
from transcript import frame

from smarttac_can.canopen.device import sdo
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.od.cia import Abort, DataType, NMTCommand
from smarttac_can.canopen.od.entry import Entry

BYTE = Entry(0x2001, 0x02, "Byte", DataType.UNSIGNED8, "rw")
SIGNED = Entry(0x2003, 0x00, "Signed", DataType.INTEGER16, "rw")
LONG = Entry(0x1006, 0x00, "Long", DataType.UNSIGNED32, "rw")
REAL = Entry(0x2004, 0x01, "Real", DataType.REAL32, "rw")


@pytest.mark.parametrize(
    ("sent", "text"),
    [
        (requests.nmt(NMTCommand.START), "000 01 00"),
        (requests.nmt(NMTCommand.RESET_COMMUNICATION, 0x21), "000 82 21"),
        (requests.sync(), "080"),
        (requests.sync(240), "080 F0"),
        (requests.heartbeat(1), "701 05"),
        (requests.upload(0x20, BYTE), "620 40 01 20 02 00 00 00 00"),
        (requests.download(0x20, BYTE, 0xA5), "620 2F 01 20 02 A5 00 00 00"),
        (requests.download(0x21, SIGNED, -2), "621 2B 03 20 00 FE FF 00 00"),
        (requests.download(0x21, LONG, 1000), "621 23 06 10 00 E8 03 00 00"),
        (requests.download(0x21, REAL, 1.0), "621 23 04 20 01 00 00 80 3F"),
    ],
)
def test_frames_of_a_master(sent: Frame, text: str) -> None:
    assert sent == frame(text)


@pytest.mark.parametrize(
    ("entry", "text", "raw"),
    [
        (BYTE, "5A0 4F 01 20 02 A5 00 00 00", 0xA5),
        (SIGNED, "5A0 4B 03 20 00 FE FF 00 00", -2),
        (LONG, "5A0 43 06 10 00 E8 03 00 00", 1000),
        (REAL, "5A0 43 04 20 01 00 00 80 3F", 1.0),
        (LONG, "5A0 60 06 10 00 00 00 00 00", None),
    ],
)
def test_values_in_answers(entry: Entry, text: str, raw: Any) -> None:
    assert requests.value(frame(text), entry) == raw


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("5A0 80 01 20 02 22 00 00 08", 0x08000022),
        ("5A0 4B 01 20 02 01 00 00 00", 0x06070012),
    ],
    ids=["refusal", "longer than the entry"],
)
def test_answers_without_a_value(text: str, code: int) -> None:
    with pytest.raises(Abort) as refused:
        requests.value(frame(text), BYTE)
    assert refused.value.code == code


WRITE = "620 2F 01 20 02 00 00 00 00"
READ = "620 40 01 20 02 00 00 00 00"
SEGMENT = "620 60 00 00 00 00 00 00 00"


@pytest.mark.parametrize(
    ("request_text", "text", "right"),
    [
        (READ, "5A0 4F 01 20 02 A5 00 00 00", True),
        (WRITE, "5A0 60 01 20 02 00 00 00 00", True),
        (READ, "5A0 80 01 20 02 22 00 00 08", True),
        (SEGMENT, "5A0 00 61 62 63 64 65 66 67", True),
        (READ, "5A1 4F 01 20 02 A5 00 00 00", False),
        (READ, "5A0 4F 01 20 03 A5 00 00 00", False),
        (READ, "5A0 80 02 20 02 22 00 00 08", False),
        (READ, "5A0 60 01 20 02 00 00 00 00", False),
        (WRITE, "5A0 4F 01 20 02 A5 00 00 00", False),
        ("620 80 01 20 02 00 00 00 08", "5A0 80 01 20 02 00 00 00 08", False),
        (READ, "080", False),
    ],
)
def test_an_answer_is_that_to_the_request(request_text: str, text: str, right: bool) -> None:
    assert requests.answers(frame(text), frame(request_text)) == right


@pytest.mark.parametrize("size", range(8))
def test_a_frame_of_less_than_8_bytes_answers_nothing(size: int) -> None:
    request = Frame(0x620, bytes.fromhex("40 00 10 00 00 00 00 00"))
    answer = Frame(0x5A0, bytes.fromhex("43 00 10 00 01 02 03 04"))
    assert requests.answers(answer, request)
    assert not requests.answers(Frame(0x5A0, answer.data[:size]), request)


TABLE = Entry(0x2061, 0x01, "Table", DataType.DOMAIN, "rw")
LONG_DATA = bytes(range(256)) * 5


def block_frames(data: bytes, losses: frozenset[int] = frozenset()) -> list[Frame]:
    """Frames of a block download of python-canopen's kind.

    The node does not get the segments of these numbers in the first sub-block, and has the rest
    of it again.
    """
    to, back = 0x620, 0x5A0
    frames = [
        Frame(to, bytes((0xC6, 0x61, 0x20, 1)) + len(data).to_bytes(4, "little")),
        frame("5A0 A4 61 20 01 7F 00 00 00"),
    ]
    position, lost = 0, losses
    while position < len(data):
        count = min(127, -(-(len(data) - position) // 7))
        parts = [data[position + 7 * n : position + 7 * n + 7] for n in range(count)]
        for number, part in enumerate(parts, 1):
            last = 0x80 if position + 7 * number >= len(data) else 0
            frames.append(Frame(to, bytes((number | last,)) + part.ljust(7, b"\0")))
        taken = min(lost, default=count + 1) - 1
        lost = frozenset()
        frames.append(Frame(back, bytes((0xA2, taken, 0x7F, *bytes(5)))))
        position += 7 * taken
    unused = -len(data) % 7
    frames += [
        Frame(to, bytes((0xC1 | unused << 2, *bytes(7)))),
        frame("5A0 A1 00 00 00 00 00 00 00"),
    ]
    return frames


def heard(frames: list[Frame]) -> list[requests.Written]:
    downloads = requests.Downloads(0x20)
    return [taken for one in frames if (taken := downloads.hear(one)) is not None]


@pytest.mark.parametrize("data", [b"", b"a", b"1234567", b"12345678", LONG_DATA])
def test_a_segmented_download_is_heard(data: bytes) -> None:
    frames = list(requests.downloading(0x20, TABLE, data))
    assert heard(frames) == [((0x2061, 1), data)]
    assert heard(frames[:-1]) == []


@pytest.mark.parametrize("data", [b"a", b"1234567", LONG_DATA])
@pytest.mark.parametrize("losses", [frozenset(), frozenset({1})])
def test_a_block_download_is_heard(data: bytes, losses: frozenset[int]) -> None:
    frames = block_frames(data, losses)
    assert heard(frames) == [((0x2061, 1), data)]
    assert heard(frames[:-1]) == []


def test_a_block_whose_middle_was_sent_again() -> None:
    assert heard(block_frames(LONG_DATA, frozenset({5, 90}))) == [((0x2061, 1), LONG_DATA)]


def test_a_short_download_beside_a_long_one() -> None:
    long = list(requests.downloading(0x20, TABLE, b"0123456789"))
    short = [requests.download(0x20, BYTE, 7), requests.downloaded(0x20, BYTE)]
    assert heard([*short, *long, *short]) == [
        ((0x2001, 2), b"\x07"),
        ((0x2061, 1), b"0123456789"),
        ((0x2001, 2), b"\x07"),
    ]
    # Two clients ask before either has its answer.
    other = [requests.download(0x20, SIGNED, -2), requests.downloaded(0x20, SIGNED)]
    assert heard([short[0], other[0], short[1], other[1]]) == [
        ((0x2001, 2), b"\x07"),
        ((0x2003, 0), b"\xfe\xff"),
    ]


@pytest.mark.parametrize("end", ["620 80 61 20 01 00 00 00 08", "5A0 80 61 20 01 30 00 09 06"])
@pytest.mark.parametrize("after", [1, 2, 3, 60, -1])
def test_aborted_download_is_not_heard_as_written(end: str, after: int) -> None:
    for frames in (block_frames(LONG_DATA), list(requests.downloading(0x20, TABLE, LONG_DATA))):
        assert heard([*frames[:after], frame(end), *frames[after:][-1:]]) == []
        assert heard([*frames[:after], frame(end), *frames]) == [((0x2061, 1), LONG_DATA)]


def test_an_abort_of_something_else_ends_nothing() -> None:
    frames = list(requests.downloading(0x20, TABLE, LONG_DATA))
    other = frame("5A0 80 17 10 00 00 00 02 06")
    assert heard([*frames[:5], other, *frames[5:]]) == [((0x2061, 1), LONG_DATA)]


def test_a_refused_value_was_not_taken() -> None:
    refused = [requests.download(0x20, BYTE, 7), frame("5A0 80 01 20 02 30 00 09 06")]
    assert heard([*refused, requests.downloaded(0x20, BYTE)]) == []


def test_frames_of_other_nodes_are_not_heard() -> None:
    frames = list(requests.downloading(0x21, TABLE, LONG_DATA))
    assert heard(frames) == []
    assert heard([Frame(0x620, b"\x23"), Frame(0x5A0, b"")]) == []


def test_an_upload_beside_a_block_download_is_none_and_leaves_it() -> None:
    upload = [frame(f"{text} 01 20 02 00 00 00 00") for text in ("620 40", "5A0 41")]
    upload += [frame(f"{text} 00 00 00 00 00 00 00") for text in ("620 70", "5A0 20")]
    assert heard(upload) == []
    frames = block_frames(LONG_DATA)
    answers = [one for one in upload if one.can_id == 0x5A0]
    (taken,) = heard([*frames[:6], *answers, *frames[6:]])
    assert taken == ((0x2061, 1), LONG_DATA)


def test_lost_segment_is_missing_in_a_heard_download() -> None:
    frames = block_frames(LONG_DATA)
    (taken,) = heard([*frames[:8], *frames[9:]])
    assert taken == ((0x2061, 1), LONG_DATA[:42] + LONG_DATA[49:])


def test_a_transfer_without_an_end_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "MAX_BYTES", 3000)
    downloads = requests.Downloads(0x20)
    for one in block_frames(b"0123456789")[:2]:
        downloads.hear(one)
    for _ in range(4):
        for number in range(1, 128):
            downloads.hear(Frame(0x620, bytes((number, *bytes(7)))))
        downloads.hear(frame("5A0 A2 7F 7F 00 00 00 00 00"))
    assert downloads._transfer is None


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("620 40 01 20 02 00 00 00 00", (0x2001, 0x02)),
        ("620 2F 01 20 02 A5 00 00 00", None),
        ("621 40 01 20 02 00 00 00 00", None),
        ("620 40 01 20", None),
    ],
)
def test_upload_request_names_its_object(text: str, address: tuple[int, int] | None) -> None:
    assert requests.asked(frame(text), 0x20) == address


TEXT = Entry(0x2070, 0x00, "Text", DataType.VISIBLE_STRING, "ro")
INITIATED = frame("5A0 41 70 20 00 00 00 00 00")


@pytest.mark.parametrize("text", ["a", "1234567", "12345678", "a text of three segments"])
def test_a_segmented_upload_is_read(text: str) -> None:
    reading, server = requests.Upload(0x20, TEXT), sdo.Upload(text.encode())
    assert not reading.take(INITIATED)
    while not reading.take(Frame(0x5A0, server.segment(reading.request.data)[0])):
        assert reading.raw is None
    assert reading.raw == text


@pytest.mark.parametrize(
    ("answer", "code"),
    [("5A0 10 61 62 63 64 65 66 67", 0x05030000), ("5A0 80 70 20 00 00 00 04 05", 0x05040000)],
    ids=["toggle bit", "abort"],
)
def test_a_segmented_upload_that_fails(answer: str, code: int) -> None:
    reading = requests.Upload(0x20, TEXT)
    reading.take(INITIATED)
    with pytest.raises(Abort) as refused:
        reading.take(frame(answer))
    assert refused.value.code == code
