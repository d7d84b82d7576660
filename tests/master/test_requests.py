"""What a master sends, to the byte, and what it understands of the answers."""

from __future__ import annotations

from typing import Any

import pytest

from smarttac_can.device.frame import Frame
from smarttac_can.master import requests
from smarttac_can.od.cia import Abort, DataType, NMTCommand
from smarttac_can.od.entry import Entry

BYTE = Entry(0x2001, 0x02, "Byte", DataType.UNSIGNED8, "rw")
SIGNED = Entry(0x2003, 0x00, "Signed", DataType.INTEGER16, "rw")
LONG = Entry(0x1006, 0x00, "Long", DataType.UNSIGNED32, "rw")
REAL = Entry(0x2004, 0x01, "Real", DataType.REAL32, "rw")


def frame(text: str) -> Frame:
    can_id, *data = text.split()
    return Frame(int(can_id, 16), bytes.fromhex("".join(data)))


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
