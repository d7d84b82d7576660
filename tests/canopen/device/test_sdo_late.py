"""A frame under way when the server has answered already has no second answer."""

from binascii import crc_hqx
from collections import deque
from collections.abc import Generator

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule
from one_device import play, started

from smarttac_can.canopen.device.frame import Frame

DEAD_DOWNLOAD = """
    > 620 C0 00 23 00 00 00 00 00
    < 5A0 A4 00 23 00 7F 00 00 00
    + 999ms
    + 1ms
    < 5A0 80 00 23 00 00 00 04 05
"""
DEAD_UPLOAD = """
    > 620 40 08 10 00 00 00 00 00
    < 5A0 41 08 10 00 11 00 00 00
    + 999ms
    + 1ms
    < 5A0 80 08 10 00 00 00 04 05
"""
READ_MODE = """
    > 620 40 10 21 00 00 00 00 00
    < 5A0 4F 10 21 00 {mode:02X} 00 00 00
"""
BELONGS_TO_NOTHING = "< 5A0 80 00 00 00 01 00 04 05\n"


def segments(first: int, last: int) -> str:
    """Segments that would write 2 to the mode if they were requests, such as that with 2Fh."""
    return "".join(
        f"> 620 {number:02X} 10 21 00 02 00 00 00\n" for number in range(first, last + 1)
    )


def test_segments_of_an_aborted_download_are_no_requests() -> None:
    device = started()
    play(device, DEAD_DOWNLOAD + segments(1, 127) + READ_MODE.format(mode=0) + "+ 3000ms")


def test_the_abort_stops_the_client_within_a_sub_block() -> None:
    device = started()
    play(device, DEAD_DOWNLOAD + segments(1, 60) + "> 620 2F 10 21 00 03 00 00 00\n< 5A0 60 ..")
    assert device.od["Mode"].value == 3
    play(device, DEAD_DOWNLOAD + segments(1, 60) + "> 620 80 00 23 00 00 00 04 05\n")
    play(device, READ_MODE.format(mode=3))


def test_late_segments_may_take_their_time() -> None:
    slow = segments(1, 1) + "+ 900ms\n" + segments(2, 2) + "+ 900ms\n" + segments(3, 3)
    play(started(), DEAD_DOWNLOAD + slow + "+ 999ms\n+ 1ms\n" + segments(4, 4) + BELONGS_TO_NOTHING)


def test_late_segments_end_with_the_last() -> None:
    play(started(), DEAD_DOWNLOAD + "> 620 81 00 00 00 00 00 00 00\n> 620 02" + " 00" * 7 + "\n"
         + BELONGS_TO_NOTHING)  # fmt: skip


def test_any_other_number_is_not_late() -> None:
    play(started(), DEAD_DOWNLOAD + segments(1, 3) + segments(5, 5) + BELONGS_TO_NOTHING)
    play(started(), DEAD_DOWNLOAD + segments(2, 2) + BELONGS_TO_NOTHING)


def test_a_number_of_0_within_a_sub_block_is_refused_once() -> None:
    device = started()
    play(
        device,
        "> 620 C0 00 23 00 00 00 00 00\n< 5A0 A4 ..\n"
        + segments(1, 30)
        + "> 620 00 10 21 00 02 00 00 00\n< 5A0 80 00 23 00 03 00 04 05\n"
        + segments(31, 127)
        + READ_MODE.format(mode=0),
    )


def test_a_sub_block_is_confirmed_once() -> None:
    """A node that was away for 500 ms finds the rest of a sub-block that it had to believe lost."""
    device = started()
    play(
        device,
        """
        > 620 C2 00 23 00 0E 00 00 00
        < 5A0 A4 00 23 00 7F 00 00 00
        > 620 01 30 31 32 33 34 35 36
        + 500ms
        < 5A0 A2 01 7F 00 00 00 00 00
        > 620 82 37 38 39 3A 3B 3C 3D      # was under way
        > 620 81 37 38 39 3A 3B 3C 3D
        < 5A0 A2 01 7F 00 00 00 00 00
        > 620 C1 00 00 00 00 00 00 00
        < 5A0 A1 00 00 00 00 00 00 00
        """,
    )
    assert device.od["Texture"].value == b"0123456789:;<="


def test_sdo_segments_of_a_confirmed_block_are_late_after_abort() -> None:
    device = started()
    play(
        device,
        "> 620 C0 00 23 00 00 00 00 00\n< 5A0 A4 ..\n"
        + segments(1, 30)
        + "+ 500ms\n< 5A0 A2 1E 7F ..\n"
        + segments(31, 40)
        + "+ 500ms\n< 5A0 80 00 23 00 00 00 04 05\n"
        + segments(41, 127)
        + segments(1, 127)
        + READ_MODE.format(mode=0),
    )


def test_a_sub_block_that_was_left_leaves_nothing_under_way() -> None:
    device = started()
    play(
        device,
        "> 620 C0 00 23 00 00 00 00 00\n< 5A0 A4 ..\n"
        + segments(1, 0x3F)
        + "+ 500ms\n< 5A0 A2 3F 7F ..\n"
        + "+ 500ms\n< 5A0 80 00 23 00 00 00 04 05\n"
        + READ_MODE.format(mode=0),
    )


@pytest.mark.parametrize("request_", ["60", "70", "00", "0B", "A1", "A2", "A3", "C1", "D5"])
def test_the_request_that_crosses_an_abort_has_its_answer(request_: str) -> None:
    late = f"> 620 {request_} 10 21 00 00 00 00 00\n"
    play(started(), DEAD_UPLOAD + late + READ_MODE.format(mode=0) + "+ 3000ms")
    play(started(), DEAD_UPLOAD + late + late + BELONGS_TO_NOTHING + late + BELONGS_TO_NOTHING)
    play(started(), DEAD_UPLOAD + "+ 99ms\n" + late + READ_MODE.format(mode=0))
    play(started(), DEAD_UPLOAD + "+ 99ms\n+ 1ms\n" + late + BELONGS_TO_NOTHING)


@pytest.mark.parametrize("request_", ["E0", "FF"])
def test_sdo_request_outside_a_transfer_is_not_late(request_: str) -> None:
    play(started(), DEAD_UPLOAD + f"> 620 {request_}{' 00' * 7}\n" + BELONGS_TO_NOTHING)


def test_an_abort_that_is_an_answer_leaves_nothing_under_way() -> None:
    play(
        started(),
        "> 620 40 08 10 00 00 00 00 00\n< 5A0 41 ..\n> 620 70 00 00 00 00 00 00 00\n< 5A0 80 ..\n"
        "> 620 60 00 00 00 00 00 00 00\n" + BELONGS_TO_NOTHING,
    )


def test_the_last_word_of_an_upload_may_come_late_or_not_at_all() -> None:
    upload = """
        > 620 A4 10 21 00 7F 00 00 00
        < 5A0 C6 10 21 00 01 00 00 00
        > 620 A3 00 00 00 00 00 00 00
        < 5A0 81 00 00 00 00 00 00 00
        > 620 A2 01 7F 00 00 00 00 00
        < 5A0 D9 00 00 00 00 00 00 00
        + 999ms
        + 1ms
        """
    last_word = "> 620 A1 00 00 00 00 00 00 00\n"
    play(started(), upload + last_word + READ_MODE.format(mode=0))
    play(started(), upload + "+ 3000ms\n" + READ_MODE.format(mode=0))


Transfer = Generator[list[bytes], bytes, list[bytes]]
"""Yields requests, gets the next answer, returns the frames after the last."""

TEXTURE = b"\0\x23\0"
LABEL = b"\x01\x23\0"
MODE = b"\x10\x21\0"


def parts_of(data: bytes) -> list[bytes]:
    return [data[k : k + 7].ljust(7, b"\0") for k in range(0, len(data), 7)] or [bytes(7)]


def write_block(data: bytes) -> Transfer:
    answer = yield [b"\xc6" + TEXTURE + len(data).to_bytes(4, "little")]
    assert answer[:5] == b"\xa4" + TEXTURE + b"\x7f"
    parts = parts_of(data)
    done = 0
    while done < len(parts):
        sub_block = parts[done : done + 127]
        last = (done + len(sub_block) == len(parts)) << 7
        answer = yield [
            bytes((k | (last if k == len(sub_block) else 0),)) + part
            for k, part in enumerate(sub_block, 1)
        ]
        assert answer[0] == 0xA2
        assert answer[1] <= len(sub_block)
        done += answer[1]
    unused = 7 * len(parts) - len(data)
    answer = yield [bytes((0xC1 | unused << 2,)) + crc_hqx(data, 0).to_bytes(2, "little")]
    assert answer == b"\xa1" + bytes(7)
    return []


def read_block(expected: bytes, block_size: int) -> Transfer:
    answer = yield [b"\xa4" + TEXTURE + bytes((block_size, 0))]
    assert answer == b"\xc6" + TEXTURE + len(expected).to_bytes(4, "little")
    data, request = b"", b"\xa3"
    left = len(parts_of(expected))
    while left:
        count = min(left, block_size)
        answer = yield [request]
        for number in range(1, count + 1):
            assert answer[0] == number | (number == left) << 7
            data += answer[1:]
            if number < count:
                answer = yield []
        left -= count
        request = bytes((0xA2, count, block_size))
    answer = yield [request]
    assert answer[0] & 0xE3 == 0xC1
    assert data[: len(data) - (answer[0] >> 2 & 7)] == expected
    return [b"\xa1"]


def write_segmented(data: bytes) -> Transfer:
    answer = yield [b"\x21" + LABEL + len(data).to_bytes(4, "little")]
    assert answer == b"\x60" + LABEL + bytes(4)
    parts = [data[k : k + 7] for k in range(0, len(data), 7)] or [b""]
    for k, part in enumerate(parts):
        toggle = (k & 1) << 4
        answer = yield [bytes((toggle | (7 - len(part)) << 1 | (k == len(parts) - 1),)) + part]
        assert answer == bytes((0x20 | toggle,)) + bytes(7)
    return []


def read_segmented(expected: bytes) -> Transfer:
    answer = yield [b"\x40" + LABEL]
    assert answer == b"\x41" + LABEL + len(expected).to_bytes(4, "little")
    data = b""
    for k in range(max(1, -(-len(expected) // 7))):
        answer = yield [bytes((0x60 | (k & 1) << 4,))]
        assert answer[0] & 0xF0 == (k & 1) << 4
        data += answer[1 : 8 - (answer[0] >> 1 & 7)]
    assert answer[0] & 1
    assert data == expected
    return []


def read_expedited() -> Transfer:
    answer = yield [b"\x40" + MODE]
    assert answer == b"\x4f" + MODE + bytes(4)
    return []


class NodeThatIsAway(RuleBasedStateMachine):
    """A prompt client, a wire that holds its frames, and a node that comes to them when it may.

    Every answer has to be the one that the client waits for, or the abort of a time-out.
    """

    @initialize()
    def power_on(self) -> None:
        self.device = started()
        self.texture = self.label = b""
        self.wire: deque[bytes] = deque()
        self.client: Transfer | None = None

    @precondition(lambda self: self.client is None)
    @rule(size=st.integers(0, 1800))
    def write_texture(self, size: int) -> None:
        self.begin(write_block(bytes((k * 37 + size) & 0xFF for k in range(size))))

    @precondition(lambda self: self.client is None)
    @rule(block_size=st.integers(1, 127))
    def read_texture(self, block_size: int) -> None:
        self.begin(read_block(self.device.od["Texture"].value, block_size))

    @precondition(lambda self: self.client is None)
    @rule(size=st.integers(5, 40))
    def write_label(self, size: int) -> None:
        self.begin(write_segmented(bytes(32 + (k + size) % 95 for k in range(size))))

    @precondition(lambda self: self.client is None)
    @rule()
    def read_label(self) -> None:
        if len(self.device.od["Label"].value) > 4:
            self.begin(read_segmented(self.device.od["Label"].value.encode()))

    @precondition(lambda self: self.client is None)
    @rule()
    def read_mode(self) -> None:
        self.begin(read_expedited())

    def begin(self, transfer: Transfer) -> None:
        self.client = transfer
        self.wire += [request.ljust(8, b"\0") for request in next(transfer)]

    @rule(count=st.integers(1, 130))
    def hear(self, count: int) -> None:
        for _ in range(count):
            if not self.wire:
                break
            self.answered(self.device.receive(Frame(0x620, self.wire.popleft())))

    @rule(most=st.integers(1, 200))
    def send(self, most: int) -> None:
        self.answered(self.device.segments(most))

    @rule(milliseconds=st.sampled_from([1, 300, 500, 700, 999]))
    def be_away(self, milliseconds: int) -> None:
        self.answered(self.device.advance(1000 * milliseconds))
        self.hear(1)

    def answered(self, frames: list[Frame]) -> None:
        for _, data, _ in frames:
            assert self.client is not None, f"nobody waits for {data.hex(' ')}"
            if data[0] == 0x80:
                assert int.from_bytes(data[4:], "little") == 0x05040000
                self.client = None
                continue
            try:
                requests = self.client.send(data)
            except StopIteration as end:
                requests = end.value
                self.client = None
            self.wire += [request.ljust(8, b"\0") for request in requests]

    def teardown(self) -> None:
        self.hear(len(self.wire))
        for _ in range(1000):
            self.send(1)
            self.hear(1)
            if self.client is None:
                break
        assert self.client is None
        self.send(200)
        assert self.device.od["Mode"].value == 0


TestNodeThatIsAway = NodeThatIsAway.TestCase
TestNodeThatIsAway.settings = settings(deadline=None, max_examples=100, stateful_step_count=40)
