import pytest
from one_device import download, play, started

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState

WATCH_NODE_5_FOR_20_MS = "> 620 23 16 10 01 14 00 05 00\n< 5A0 60 16 10 01 00 00 00 00\n"


def test_heartbeat_is_not_added_by_late_call_or_state_change() -> None:
    device = started()
    assert download(device, 0x1017, 0, 10, 2) == 0
    play(device, "> 000 80 20\n+ 35ms\n< 720 7F\n+ 4ms\n+ 1ms\n< 720 7F")


def period(ms: int) -> str:
    """Write Producer heartbeat time; a heartbeat goes out at once unless it is 0."""
    heartbeat = "< 720 05\n" if ms else ""
    return f"> 620 2B 17 10 00 {ms:02X} 00 00 00\n{heartbeat}< 5A0 60 17 10 00 00 00 00 00\n"


@pytest.mark.parametrize(
    ("written", "goes_on"),
    [
        # The same one begins anew as well.
        (period(10) + "+ 9ms\n" + period(10), "+ 9ms\n+ 1ms\n< 720 05\n+ 9ms\n+ 1ms\n< 720 05"),
        (period(10) + "+ 6ms\n" + period(20), "+ 19ms\n+ 1ms\n< 720 05"),
        (period(0), "100x + 1ms"),
        (period(10) + period(0), "100x + 1ms"),
    ],
)
def test_heartbeat_goes_out_at_once_when_1017h_is_written(written: str, goes_on: str) -> None:
    play(started(), written + goes_on)


def test_consumer_reports_loss_and_return() -> None:
    device = started()
    play(
        device,
        WATCH_NODE_5_FOR_20_MS
        + """
        + 50ms                               # not seen yet: not lost
        > 705 05
        + 19ms
        > 705 05
        + 19ms
        + 1ms
        < 0A0 30 81 11 05 00 00 00 00
        + 50ms                               # once
        > 705 7F
        < 0A0 00 00 00 00 00 00 00 00
        """,
    )
    assert device.nmt_state == NMTState.PRE_OPERATIONAL, "1029h:1 is 0"


def test_one_node_cannot_be_watched_twice() -> None:
    device = started()
    assert download(device, 0x1016, 1, 0x50014, 4) == 0
    assert download(device, 0x1016, 2, 0x50020, 4) == 0x06040043
    assert device.od.entry(0x1016, 2).value == 0
    assert download(device, 0x1016, 1, 0x50030, 4) == 0
    assert download(device, 0x1016, 2, 0x60020, 4) == 0
    assert download(device, 0x1016, 1, 0x60030, 4) == 0x06040043


def test_reserved_bits_are_0() -> None:
    assert download(started(), 0x1016, 1, 0x0105_0014, 4) == 0x06090030


def test_switching_the_watch_off_takes_the_error_back() -> None:
    device = started()
    play(
        device,
        WATCH_NODE_5_FOR_20_MS
        + """
        > 705 05
        + 20ms
        < 0A0 30 81 11 05 00 00 00 00
        > 620 23 16 10 01 00 00 00 00
        < 0A0 00 00 00 00 00 00 00 00
        < 5A0 60 16 10 01 00 00 00 00
        > 705 05
        + 50ms
        """,
    )


def test_consumer_time_written_anew_counts_from_last_heartbeat() -> None:
    device = started()
    play(
        device,
        WATCH_NODE_5_FOR_20_MS
        + """
        > 705 05
        + 15ms
        > 620 23 16 10 01 1E 00 05 00           # 30 ms, of which 15 are over
        < 5A0 60 16 10 01 00 00 00 00
        + 14ms
        + 1ms
        < 0A0 30 81 11 05 00 00 00 00
        > 620 23 16 10 01 28 00 05 00           # and still missing
        < 5A0 60 16 10 01 00 00 00 00
        + 100ms
        > 705 05
        < 0A0 00 00 00 00 00 00 00 00
        + 40ms
        < 0A0 30 81 11 05 00 00 00 00
        """,
    )


def test_an_entry_that_is_not_in_use_clears_no_loss_of_another() -> None:
    device = started()
    download(device, 0x1016, 1, 0x5_0014, 4)
    device.receive(Frame(0x705, b"\5"))
    play(device, "+ 20ms\n< 0A0 30 81 11 05 00 00 00 00")
    assert download(device, 0x1016, 2, 0x5_0000, 4) == 0  # the same node, but no time
    assert download(device, 0x1016, 2, 0, 4) == 0
    assert device.od.entry(0x1001, 0).value & 0x10
    play(device, "> 705 05\n< 0A0 00 00 00 00 00 00 00 00")


def test_consumer_time_shortened_repeatedly_keeps_its_deadline() -> None:
    device = started()
    download(device, 0x1016, 1, 0x5_0000 | 100, 4)
    device.receive(Frame(0x705, b"\5"))
    for milliseconds in range(99, 50, -1):
        assert device.advance(1000) == []
        assert download(device, 0x1016, 1, 0x5_0000 | milliseconds, 4) == 0
    play(device, "+ 1ms\n+ 1ms\n< 0A0 30 81 11 05 00 00 00 00")


def test_a_time_that_is_over_already_is_lost_at_once() -> None:
    device = started()
    download(device, 0x1016, 1, 0x5_0000 | 100, 4)
    device.receive(Frame(0x705, b"\5"))
    device.advance(60_000)
    download(device, 0x1016, 1, 0x5_0000 | 20, 4)
    play(device, "+ 0ms\n< 0A0 30 81 11 05 00 00 00 00")


LIFE_TIME_20_MS = """
    > 620 2B 0C 10 00 0A 00 00 00
    < 5A0 60 0C 10 00 00 00 00 00
    > 620 2F 0D 10 00 02 00 00 00
    < 5A0 60 0D 10 00 00 00 00 00
"""


def test_life_guarding_begins_with_the_first_remote_frame() -> None:
    device = started()
    play(
        device,
        LIFE_TIME_20_MS
        + """
        + 100ms
        > 720 rtr
        < 720 05
        + 19ms
        > 720 rtr
        < 720 85
        + 19ms
        + 1ms
        < 0A0 30 81 11 00 00 00 00 00
        + 100ms
        """
        # An entry that is not in use yet clears nothing.
        + WATCH_NODE_5_FOR_20_MS
        + """
        > 720 rtr
        < 720 7F
        < 0A0 00 00 00 00 00 00 00 00
        """,
    )
    assert device.nmt_state is NMTState.PRE_OPERATIONAL


@pytest.mark.parametrize("stricter", ["2B 0C 10 00 08 00 00 00", "2F 0D 10 00 01 00 00 00"])
def test_a_master_that_makes_its_watch_stricter_is_still_missed(stricter: str) -> None:
    device = started()
    play(device, LIFE_TIME_20_MS + "> 720 rtr\n< 720 05")
    play(device, f"> 620 {stricter}\n< 5A0 60 {stricter[3:11]} 00 00 00 00")
    play(device, "+ 16ms\n< 0A0 30 81 11 00 00 00 00 00")


@pytest.mark.parametrize(("guard_time", "factor"), [(10, 0), (0, 3)])
def test_no_life_time_without_both_parameters(guard_time: int, factor: int) -> None:
    device = started()
    download(device, 0x100C, 0, guard_time, 2)
    download(device, 0x100D, 0, factor, 1)
    play(device, "> 720 rtr\n< 720 05\n+ 60000ms")
