"""What a process that came late knows of the frames that wait."""

from __future__ import annotations

import pytest
from test_runner import OTHER, Host
from toy_node import REQUEST, SYNC

from smarttac_can.device.frame import Frame
from smarttac_can.host.read_ahead import ReadAhead

REQUESTED = Frame(REQUEST + 1)


def taken(inbox: ReadAhead, number: int) -> list[tuple[Frame | None, bool]]:
    frames = []
    for _ in range(number):
        frame = inbox.receive(0.0)
        frames.append((frame, frame is not None and inbox.overtaken(frame)))
    return frames


def test_of_what_was_read_it_is_known_what_newer_ones_wait_behind() -> None:
    waiting = [SYNC, REQUESTED, SYNC, OTHER, SYNC]
    host = Host([(1, frame) for frame in waiting], until=0)
    inbox = ReadAhead(host, host.clock)
    host.now = 5000
    assert inbox.receive(0.0) == SYNC
    inbox.put_back(SYNC)
    inbox.read()
    assert taken(inbox, 6) == [
        (SYNC, True),
        (REQUESTED, False),
        (SYNC, True),
        (OTHER, False),
        (SYNC, False),
        (None, False),
    ]


@pytest.mark.parametrize(
    "other", [Frame(SYNC.can_id, b"\1"), Frame(SYNC.can_id, rtr=True), REQUESTED]
)
def test_what_is_of_another_kind_overtakes_nothing(other: Frame) -> None:
    host = Host([(1, SYNC), (1, other)], until=0)
    inbox = ReadAhead(host, host.clock)
    host.now = 1
    inbox.read()
    assert taken(inbox, 2) == [(SYNC, False), (other, False)]


def test_it_is_late_when_nobody_looked_for_2_ms() -> None:
    host = Host([(at, SYNC) for at in (1999, 3999, 3999, 5000)], until=0)
    inbox = ReadAhead(host, host.clock)
    told = []
    for now in (1999, 3999, 3999, 5999):
        host.now = now
        assert inbox.receive(0.0) == SYNC
        told.append(inbox.late)
    assert told == [False, True, False, True]
    inbox.put_back(SYNC)
    assert inbox.receive(0.0) == SYNC
    assert not inbox.late, "what comes again is told once"


def test_they_are_read_for_no_longer_than_a_ms() -> None:
    host = Host([(1, SYNC)] * 40, until=0, frame_cost=300)
    inbox = ReadAhead(host, host.clock)
    host.now = 5000
    inbox.read()
    assert host.now == 5000 + 1200, "but for the last one"
    # What was read is taken before the bus is asked again, at once as that took its time.
    assert [known for _, known in taken(inbox, 4)] == [True] * 3 + [False]
    assert host.now == 6200
    inbox.receive(0.0)
    assert (host.now, inbox.late) == (6500, False), "reading is looking"


def test_what_is_behind_a_frame_is_read_once() -> None:
    host = Host([(1, SYNC)] * 2 + [(2, OTHER)], until=0)
    inbox = ReadAhead(host, host.clock)
    host.now = 1
    first = inbox.receive(0.0)
    assert first == SYNC
    inbox.look_behind()
    assert inbox.overtaken(first)
    host.now = 2
    inbox.look_behind()
    assert taken(inbox, 2) == [(SYNC, False), (OTHER, False)], "the rest waits on the bus"


def test_frames_that_nobody_listens_to_do_not_end_the_reading() -> None:
    patience: list[float] = []

    class Filtering(Host):
        def receive(
            self, timeout: float, patience_s: float = 0.0, *, every: bool = False
        ) -> Frame | None:
            patience.append(patience_s)
            return super().receive(timeout, every=every)

    host = Filtering([(1, SYNC)] * 4, until=0, frame_cost=300)
    inbox = ReadAhead(host, host.clock)
    host.now = 1
    inbox.read()
    assert patience == pytest.approx([1e-3, 0.7e-3, 0.4e-3, 0.1e-3])


def test_on_a_silent_bus_it_waits_as_the_bus_does() -> None:
    host = Host([(9000, SYNC)], until=0)
    inbox = ReadAhead(host, host.clock)
    assert inbox.receive(0.005) is None
    assert host.now == 5000
    assert inbox.receive(0.005) == SYNC
    assert host.now == 9000


def test_what_was_read_is_judged_when_it_is_taken() -> None:
    host = Host([(1, frame) for frame in (SYNC, OTHER, REQUESTED, OTHER)], until=0)
    inbox = ReadAhead(host, host.clock)
    inbox.listen_to(frozenset({SYNC.can_id}))
    host.now = 1
    inbox.read()
    assert inbox.receive(0.0) == SYNC
    # The frame in front has made another one wanted, and one unwanted.
    inbox.listen_to(frozenset({REQUESTED.can_id}))
    assert host.listened == [{SYNC.can_id}, {REQUESTED.can_id}]
    assert inbox.receive(0.0) == REQUESTED
    assert inbox.receive(0.0) is None


def test_every_frame_is_read_ahead() -> None:
    asked: list[bool] = []

    class Filtering(Host):
        def receive(
            self, timeout: float, patience: float = 0.0, *, every: bool = False
        ) -> Frame | None:
            asked.append(every)
            return super().receive(timeout, patience)

    host = Filtering([(1, SYNC), (1, OTHER)], until=0)
    inbox = ReadAhead(host, host.clock)
    host.now = 1
    inbox.receive(0.0)
    inbox.read()
    assert asked == [False, True, True]
