"""What a process that came late knows of the frames that wait."""

from __future__ import annotations

import pytest
from test_runner import OTHER, Host
from toy_node import REQUEST, SYNC

from smarttac_can.device.frame import Frame
from smarttac_can.host.read_ahead import ReadAhead

REQUESTED = Frame(REQUEST + 1)


def taken(host: Host, inbox: ReadAhead, number: int) -> list[tuple[Frame | None, bool]]:
    frames = []
    for _ in range(number):
        frame = inbox.receive(0.0)
        frames.append((frame, frame is not None and inbox.overtaken(frame)))
    return frames


@pytest.mark.parametrize(("late_us", "known"), [(1999, False), (2000, True)])
def test_what_newer_ones_wait_behind_is_known_after_2_ms(late_us: int, known: bool) -> None:
    waiting = [SYNC, REQUESTED, SYNC, OTHER, SYNC]
    host = Host([(1, frame) for frame in waiting], until=0)
    inbox = ReadAhead(host, host.clock)
    host.now = late_us
    assert taken(host, inbox, 6) == [
        (SYNC, known),
        (REQUESTED, False),
        (SYNC, known),
        (OTHER, False),
        (SYNC, False),
        (None, False),
    ]


def test_they_are_read_ahead_for_no_longer_than_a_ms() -> None:
    host = Host([(1, SYNC)] * 40, until=0, frame_cost=100)
    inbox = ReadAhead(host, host.clock)
    host.now = 5000
    assert inbox.receive(0.0) == SYNC
    assert host.now == 5100, "not before the node was asked what must not wait"
    assert inbox.overtaken(SYNC)
    assert host.now == 6100
    # What was read is taken before the bus is asked again, and at once.
    assert [known for _, known in taken(host, inbox, 10)] == [True] * 9 + [False]
    assert host.now == 6100


def test_after_work_of_2_ms_it_looks_ahead_again() -> None:
    host = Host([(at, SYNC) for at in (1, 2, 5001, 5002)], until=0)
    inbox = ReadAhead(host, host.clock)
    host.now = 3000
    assert taken(host, inbox, 2) == [(SYNC, True), (SYNC, False)]
    host.now = 6000
    assert taken(host, inbox, 2) == [(SYNC, True), (SYNC, False)]


def test_on_a_silent_bus_it_waits_as_the_bus_does() -> None:
    host = Host([(9000, SYNC)], until=0)
    inbox = ReadAhead(host, host.clock)
    assert inbox.receive(0.005) is None
    assert host.now == 5000
    assert inbox.receive(0.005) == SYNC
    assert not inbox.overtaken(SYNC)
    assert host.now == 9000
