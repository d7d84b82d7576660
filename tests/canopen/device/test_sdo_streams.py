"""Segments of block uploads: made as the bus takes them, and none of a transfer that is over."""

from binascii import crc_hqx

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from one_device import download, play, started

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame

START = """
    > 620 A4 00 23 00 04 00 00 00
    < 5A0 C6 00 23 00 2D 00 00 00
    > 620 A3 00 00 00 00 00 00 00
"""
FIRST_TWO = """
    ? 2
    < 5A0 01 00 01 02 03 04 05 06
    < 5A0 02 07 08 09 0A 0B 0C 0D
"""


def texture(size: int = 45, *, operational: bool = True) -> Device:
    device = started(operational=operational)
    device.od["Texture"].value = bytes(k & 0xFF for k in range(size))
    return device


@pytest.mark.parametrize(
    "end",
    [
        "> 620 80 00 23 00 00 00 04 05",
        "> 620 A2 02 80 00 00 00 00 00\n< 5A0 80 00 23 00 02 00 04 05",
        "> 620 60 00 00 00 00 00 00 00\n< 5A0 80 00 23 00 01 00 04 05",
        "> 620 E0 00 00 00 00 00 00 00\n< 5A0 80 00 23 00 01 00 04 05",
        "> 620 40 10 21 00 00 00 00 00\n< 5A0 4F 10 21 00 00 00 00 00",
        "> 620 2F 10 21 00 02 00 00 00\n< 5A0 60 10 21 00 00 00 00 00",
        "> 620 40 08 10 00 00 00 00 00\n< 5A0 41 08 10 00 11 00 00 00",
        "> 620 21 00 23 00 05 00 00 00\n< 5A0 60 00 23 00 00 00 00 00",
        "> 620 A4 08 10 00 7F 00 00 00\n< 5A0 C6 08 10 00 11 00 00 00",
        "> 620 C4 00 23 00 00 00 00 00\n< 5A0 A4 00 23 00 7F 00 00 00",
        "> 620 40 FF 5F 00 00 00 00 00\n< 5A0 80 FF 5F 00 00 00 02 06",
        "> 000 02 20\n> 000 80 20",
        "> 000 81 20\n< 720 00",
        "> 000 82 20\n< 720 00",
        "power\n< 720 00",
        "+ 999ms\n+ 1ms\n< 5A0 80 00 23 00 00 00 04 05",
    ],
)
def test_sdo_segments_end_with_the_transfer(end: str) -> None:
    play(texture(), START + FIRST_TWO + end + "\n? 200\n? 200", at_once=False)


def test_a_server_switched_off_has_nothing_more_to_send() -> None:
    device = texture()
    assert download(device, 0x1201, 1, 0x6C0, 4) == 0
    assert download(device, 0x1201, 2, 0x6C1, 4) == 0
    play(device, START.replace("620", "6C0").replace("5A0", "6C1"), at_once=False)
    assert download(device, 0x1201, 2, 0x800006C1, 4) == 0
    play(device, "? 200\n+ 3000ms", at_once=False)


def test_sdo_time_out_restarts_with_each_segment_taken() -> None:
    play(
        texture(),
        START
        + """
        + 900ms
        ? 1
        < 5A0 ..
        + 900ms
        ? 3
        < 5A0 ..
        < 5A0 ..
        < 5A0 ..
        + 900ms
        ? 1                                # there is none
        + 99ms
        > 620 A2 04 04 00 00 00 00 00
        + 999ms
        + 1ms
        < 5A0 80 00 23 00 00 00 04 05
        + 3000ms
        """,
        at_once=False,
    )


def test_other_frames_do_not_wait_for_segments() -> None:
    device = texture()
    play(device, START, at_once=False)
    sent = device.receive(Frame(0x080))
    assert 0x5A0 not in [frame.can_id for frame in sent]
    play(device, FIRST_TWO, at_once=False)


def test_servers_take_turns() -> None:
    device = texture()
    assert download(device, 0x1201, 1, 0x6C0, 4) == 0
    assert download(device, 0x1201, 2, 0x6C1, 4) == 0
    play(device, START, at_once=False)
    play(device, START.replace("620", "6C0").replace("5A0", "6C1"), at_once=False)
    play(
        device,
        """
        ? 3
        < 5A0 01 ..
        < 6C1 01 ..
        < 5A0 02 ..
        > 620 A2 00 02 00 00 00 00 00      # again, which does not change whose turn it is
        ? 200
        < 6C1 02 ..
        < 5A0 01 ..
        < 6C1 03 ..
        < 5A0 02 ..
        < 6C1 04 ..
        """,
        at_once=False,
    )


class Uploading(RuleBasedStateMachine):
    """A client that reads by blocks over a bus of any speed, loses frames, and changes its mind."""

    @initialize(size=st.integers(0, 4000))
    def power_on(self, size: int) -> None:
        self.device = texture(size)
        self.content = self.device.od["Texture"].value
        self.give_up()

    def give_up(self) -> None:
        self.reading = False
        self.data = b""
        self.seen = self.in_order = 0
        self.quiet_ms = 0

    def ask(self, request: bytes) -> list[bytes]:
        self.quiet_ms = 0
        return [f.data for f in self.device.receive(Frame(0x620, request.ljust(8, b"\0")))]

    @rule(block_size=st.integers(1, 127))
    def begin(self, block_size: int) -> None:
        self.give_up()
        size = len(self.content).to_bytes(4, "little")
        assert self.ask(bytes((0xA4, 0x00, 0x23, 0, block_size))) == [b"\xc6\0\x23\0" + size]
        assert self.ask(b"\xa3") == []
        self.reading = True
        self.block_size = block_size

    @rule(most=st.integers(1, 200), lost=st.frozensets(st.integers(1, 127), max_size=3))
    def take(self, most: int, lost: frozenset[int]) -> None:
        frames = self.device.segments(most)
        assert len(frames) <= most
        assert self.reading or not frames
        for can_id, data, _ in frames:
            self.quiet_ms = 0
            self.seen += 1
            assert can_id == 0x5A0
            assert data[0] & 0x7F == self.seen <= self.block_size
            assert data[0] >> 7 == (self.left() <= 7 * self.seen)
            if self.seen not in lost and self.in_order == self.seen - 1:
                self.in_order = self.seen
                self.data += data[1:]

    def left(self) -> int:
        return len(self.content) - (len(self.data) - 7 * self.in_order)

    @precondition(lambda self: getattr(self, "reading", False))
    @rule(block_size=st.integers(1, 127))
    def confirm(self, block_size: int) -> None:
        """At the end of a sub-block or early."""
        complete = self.in_order and self.left() <= 7 * self.in_order
        answers = self.ask(bytes((0xA2, self.in_order, block_size)))
        self.seen = self.in_order = 0
        self.block_size = block_size
        if not complete:
            assert answers == []
            return
        ((command, low, high, *_),) = answers
        assert command & 0xE3 == 0xC1
        data = self.data[: len(self.data) - (command >> 2 & 7)]
        assert data == self.content
        assert crc_hqx(data, 0) == low | high << 8
        assert self.ask(b"\xa1") == []
        self.give_up()

    @precondition(lambda self: getattr(self, "reading", False))
    @rule(more=st.integers(1, 127))
    def confirm_too_much(self, more: int) -> None:
        number = min(self.seen + more, 255)
        ((command, *_),) = self.ask(bytes((0xA2, number, 127)))
        assert command == 0x80
        self.give_up()

    @rule()
    def abort(self) -> None:
        assert self.ask(b"\x80\0\x23\0") == []
        self.give_up()

    @rule(segmented=st.booleans())
    def read_something_else(self, segmented: bool) -> None:
        command, index = (0x41, 0x08) if segmented else (0x43, 0x00)
        ((answer, *_),) = self.ask(bytes((0x40, index, 0x10, 0)))
        assert answer == command
        self.give_up()
        assert self.ask(b"\x80") == []

    @rule(reset=st.sampled_from([0x81, 0x82]))
    def reset(self, reset: int) -> None:
        self.device.receive(Frame(0, bytes((reset, 0x20))))
        self.device.od["Texture"].value = self.content
        self.give_up()

    @rule(milliseconds=st.integers(1, 700))
    def wait(self, milliseconds: int) -> None:
        self.quiet_ms += milliseconds
        sent = [f.data for f in self.device.advance(1000 * milliseconds)]
        if self.reading and self.quiet_ms >= 1000:
            assert sent == [b"\x80\0\x23\0\0\0\x04\x05"]
            self.give_up()
        else:
            assert sent == []

    @invariant()
    def nothing_is_sent_unasked(self) -> None:
        if hasattr(self, "device"):
            assert self.device.take() == []


TestUploading = Uploading.TestCase
TestUploading.settings = settings(deadline=None, max_examples=80, stateful_step_count=40)
