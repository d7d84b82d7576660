"""The loop alone, on a simulated bus and clock: the cost of each step is part of the case."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from itertools import count, pairwise
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from toy_node import (
    AT_SYNC,
    EMERGENCY,
    OFF,
    REPLY,
    REQUEST,
    SEGMENT,
    SYNC,
    TICKER,
    ToyNode,
)

from smarttac_can.canopen.bus.bus import BusError, QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.reconnecting_bus import ReconnectingBus
from smarttac_can.host.runner import Observer, run_node

PROMISE_US = 20_000
HEARD_LATE_US = 10_000
TICK_US = 1000
REQUESTED = Frame(REQUEST + 1)
LEARNT = 0x77F
OTHER = Frame(AT_SYNC + 1)
"""Heard, and not answered."""


class Host:
    """A clock in us that moves only by the cost of steps, and a bus on it.

    `arrivals` are (us, frame) in order, the frames that come over the bus; `pauses` are (us, how
    long) at which the process is not run, first chance after that time.
    """

    def __init__(
        self,
        arrivals: Iterable[tuple[int, Frame]] = (),
        *,
        until: int,
        frame_cost: int = 0,
        send_cost: int = 0,
        pauses: tuple[tuple[int, int], ...] = (),
        full: Callable[[int], bool] = lambda now: False,
    ) -> None:
        self.now = 0
        self.paused = 0
        self.until = until
        self.sent: list[tuple[int, Frame]] = []
        self.closed = 0
        self.broken = False
        self.rests = 0
        self.reads = 0
        self.asleep = 0
        self.blocked: list[frozenset[int]] = []
        self._arrivals = iter(arrivals)
        self._next = next(self._arrivals, None)
        self._queue: deque[Frame] = deque()
        self._frame_cost = frame_cost
        self._send_cost = send_cost
        self._pauses = deque(pauses)
        self._full = full

    def clock(self) -> int:
        if self._pauses and self.now >= self._pauses[0][0]:
            _, length = self._pauses.popleft()
            self.now += length
            self.paused += length
        return 1000 * self.now

    def rest(self, seconds: float) -> None:
        self.rests += 1
        self.asleep += round(seconds * 1e6)
        self.now += round(seconds * 1e6)

    @property
    def time(self) -> dict[str, Any]:
        """Times that `run_node` takes for those of a system."""
        return {"clock": self.clock, "rest": self.rest}

    def at_end(self) -> bool:
        return self.now - self.paused >= self.until

    def send(self, frame: Frame) -> None:
        self.now += self._send_cost
        if self.broken:
            raise BusError(f"broken at {frame.can_id:03X}")
        if self._full(self.now):
            raise QueueFullError("queue full")
        self.sent.append((self.now, frame))

    def wait(self, timeout: float) -> bool:
        self._arrive()
        if not self._queue:
            end = self.now + round(timeout * 1e6)
            next_at = end if self._next is None else max(self.now, self._next[0])
            woken = max(self.now, min(end, next_at))
            self.asleep += woken - self.now
            self.now = woken
            self._arrive()
        return bool(self._queue)

    def read(self, frames: deque[Frame]) -> bool:
        self.reads += 1
        self._arrive()
        if not self._queue:
            return False
        self.now += self._frame_cost
        frames.append(self._queue.popleft())
        return True

    def block(self, can_ids: frozenset[int]) -> None:
        self.blocked.append(can_ids)

    def close(self) -> None:
        self.closed += 1

    def ids_sent(self) -> list[int]:
        return [frame.can_id for _, frame in self.sent]

    def _arrive(self) -> None:
        while self._next is not None and self._next[0] <= self.now:
            self._queue.append(self._next[1])
            self._next = next(self._arrivals, None)


class PunctualNode(ToyNode):
    """Has a timer of a tick, and notes how late it was asked for, pauses apart."""

    def __init__(self, host: Host, advance_cost: int = 0) -> None:
        super().__init__()
        self.host = host
        self.advance_cost = advance_cost
        self.behind: list[int] = []
        self.ticks = 0
        self.missed = 0
        self._loop = self.clock.timer(self._cycle)
        self._paused = 0

    def start(self) -> list[Frame]:
        self._loop.start(TICK_US, periodic=True)
        return super().start()

    def advance(self, microseconds: int) -> list[Frame]:
        if self._loop.due <= self.clock.now:
            behind = self.host.now - self._loop.due
            self.behind.append(behind - (self.host.paused - self._paused))
            self._paused = self.host.paused
        self.host.now += self.advance_cost
        return super().advance(microseconds)

    def _cycle(self) -> None:
        self.ticks += 1
        self.missed += self._loop.missed


class Nobody:
    """An observer that does nothing."""

    def started(self) -> None: ...

    def follow(self) -> None: ...

    def full(self, reason: QueueFullError) -> None: ...

    def stopped(self) -> None: ...


def run(
    node: ToyNode,
    host: Host,
    *,
    lockstep: bool = False,
    observer: Observer | None = None,
    resting: bool = False,
) -> None:
    run_node(
        node,
        host,
        host.at_end,
        lockstep=lockstep,
        observer=observer or Nobody(),
        resting=resting,
        **host.time,
    )


class Follower(Nobody):
    """Notes when it was called."""

    def __init__(self, host: Host) -> None:
        self.host = host
        self.followed: list[int] = []
        self.ends: list[str] = []

    def started(self) -> None:
        self.ends.append("started")

    def follow(self) -> None:
        self.followed.append(self.host.now)

    def stopped(self) -> None:
        self.ends.append("stopped")


def every(period: int, frame: Frame = REQUESTED, start: int = 0) -> Iterator[tuple[int, Frame]]:
    return ((at, frame) for at in count(start, period))


def burst(at: int, number: int, frame: Frame = REQUESTED) -> Iterator[tuple[int, Frame]]:
    return iter([(at, frame)] * number)


def test_on_time_every_tick_is_had_and_the_clock_is_device_time() -> None:
    host = Host(until=50_500)
    node = PunctualNode(host)
    run(node, host)
    assert (node.ticks, node.missed) == (50, 0)
    assert set(node.behind) == {0}
    assert [frame for _, frame in host.sent if frame.can_id == TICKER + 1] == [
        Frame(TICKER + 1, at.to_bytes(8, "little")) for at in range(5000, 50_001, 5000)
    ]


def test_a_frame_is_heard_at_the_time_at_which_it_comes() -> None:
    host = Host(iter([(1234, SYNC), (7891, SYNC)]), until=10_000)
    node = ToyNode()
    run(node, host)
    assert [frame for _, frame in host.sent if frame.can_id == AT_SYNC + 1] == [
        Frame(AT_SYNC + 1, at.to_bytes(8, "little")) for at in (1234, 7891)
    ]


def test_timers_are_asked_only_when_the_next_is_due() -> None:
    host = Host(every(130), until=20_000)
    node = ToyNode()
    run(node, host)
    assert node.advances == [0] * 3, "at 5, 10 and 15 ms, whatever comes over the bus"


@pytest.mark.parametrize("cost", [0, 10, 100, 125, 130, 500, 999, 1000, 1001, 2000, 3500, 5000])
@pytest.mark.parametrize("period", [10, 100, 1000, 2500])
def test_a_flood_does_not_hold_up_time(cost: int, period: int) -> None:
    host = Host(every(period), until=200_000, frame_cost=cost)
    node = PunctualNode(host)
    run(node, host)
    assert max(node.behind) <= PROMISE_US
    assert node.ticks + node.missed >= 192
    assert host.ids_sent().count(REPLY + 1) > 32, "and the bus is heard"


@pytest.mark.parametrize("cost", [10, 125, 1000, 5000])
def test_a_flood_leaves_the_processor_to_others_now_and_then(cost: int) -> None:
    host = Host(every(10), until=200_000, frame_cost=cost)
    run(PunctualNode(host), host, resting=True)
    assert host.rests * 500 >= 0.02 * 200_000


@pytest.mark.parametrize("cost", [940, 990, 1000, 1001, 1500, 2500, 5000, 30_000])
@pytest.mark.parametrize("period", [None, 1000, 10])
def test_cycles_that_take_too_long_leave_it_to_others_too(cost: int, period: int | None) -> None:
    arrivals = () if period is None else every(period)
    host = Host(arrivals, until=300_000, frame_cost=10)
    node = PunctualNode(host, advance_cost=cost)
    run(node, host, resting=True)
    assert host.asleep >= 500 * (host.now // (13_000 + cost))
    assert max(node.behind) <= PROMISE_US + cost


@pytest.mark.parametrize("cost", [0, 1500])
def test_that_the_system_runs_another_is_no_rest(cost: int) -> None:
    # As the threads of interrupts do, which are more urgent than a node.
    taken = tuple((at, 600) for at in range(1000, 500_000, 4000))
    arrivals = every(10) if not cost else ()
    host = Host(arrivals, until=400_000, frame_cost=100, pauses=taken)
    run(PunctualNode(host, advance_cost=cost), host, resting=True)
    assert host.rests > 20


def endless_segments(most: int) -> list[Frame]:
    return [Frame(SEGMENT + 1)] * most


def test_a_transfer_waits_for_no_longer_than_is_owed() -> None:
    host = Host(until=500_000, send_cost=10)
    node = ToyNode()
    node.start = list  # type: ignore[method-assign]  # it has no timer
    node.segments = endless_segments  # type: ignore[method-assign]
    run(node, host, resting=True)
    assert 0.02 * 500_000 <= host.asleep <= 0.1 * 500_000


@pytest.mark.parametrize("cost", [0, 300, 600, 900])
@pytest.mark.parametrize("at", [100_000, 100_300, 100_700])
@pytest.mark.parametrize("length", [3_400, 15_000])
def test_runner_that_waits_often_rests_briefly(cost: int, at: int, length: int) -> None:
    host = Host(every(300), until=500_000, pauses=((at, length),))
    node = PunctualNode(host, advance_cost=cost)
    run(node, host, resting=True)
    assert host.rests <= (cost > 600 or length > 10_000), "what it missed may take it all its time"
    assert max(node.behind[-300:]) <= 1


@pytest.mark.parametrize("cost", [300, 600, 750])
def test_a_transfer_waits_rather_than_a_tick(cost: int) -> None:
    host = Host(until=500_000, send_cost=10)
    node = PunctualNode(host, advance_cost=cost)
    node.segments = endless_segments  # type: ignore[method-assign]
    run(node, host, resting=True)
    assert node.missed == 0
    assert max(node.behind) <= 130, "it sends eight segments of 10 us at a time"
    assert 0.02 * 500_000 <= host.asleep <= 0.1 * 500_000
    spare = 500 * (TICK_US - cost) // 10
    assert host.ids_sent().count(SEGMENT + 1) > 0.6 * spare


def test_a_node_that_waits_for_its_frames_needs_no_rest() -> None:
    host = Host(every(300), until=500_000, frame_cost=10)
    run(PunctualNode(host), host, resting=True)
    assert host.rests == 0


@pytest.mark.parametrize("cost", [1, 1500, 3000])
def test_a_node_whose_cycles_take_too_long_still_hears_the_bus(cost: int) -> None:
    host = Host(every(700), until=1_000_000, frame_cost=10)
    node = PunctualNode(host, advance_cost=cost)
    run(node, host, resting=True)
    answered = host.ids_sent().count(REPLY + 1)
    assert answered > 1400, "of 1429 that came"
    assert node.ticks + node.missed >= 990


@settings(deadline=None, max_examples=150)
@example(frame_cost=3500, send_cost=2500, bursts=[], pauses=[], period=1000)
@example(frame_cost=5000, send_cost=4000, bursts=[(9_990, 8)], pauses=[], period=10_000)
@example(frame_cost=900, send_cost=4000, bursts=[(9_990, 8)], pauses=[], period=10_000)
@given(
    frame_cost=st.integers(0, 5000),
    send_cost=st.integers(0, 4000),
    bursts=st.lists(st.tuples(st.integers(0, 300_000), st.integers(1, 200)), max_size=6),
    pauses=st.lists(st.tuples(st.integers(1, 300_000), st.integers(1, 400_000)), max_size=4),
    period=st.integers(50, 10_000),
)
def test_device_time_is_never_far_behind(
    frame_cost: int,
    send_cost: int,
    bursts: list[tuple[int, int]],
    pauses: list[tuple[int, int]],
    period: int,
) -> None:
    arrivals = [(at, REQUESTED) for at, number in bursts for _ in range(number)]
    arrivals += [(at, REQUESTED) for at in range(0, 300_000, period)]
    host = Host(
        iter(sorted(arrivals)),
        until=400_000,
        frame_cost=frame_cost,
        send_cost=send_cost,
        pauses=tuple(sorted(pauses)),
    )
    node = PunctualNode(host)
    run(node, host)
    assert max(node.behind) <= PROMISE_US
    lost = node.missed + node.ticks
    assert host.now // TICK_US - 40 <= lost <= host.now // TICK_US, "no tick is lost or invented"


class WatchingNode(ToyNode):
    """Waits for a request within 50 ms of the last one, as for a heartbeat."""

    def __init__(self) -> None:
        super().__init__()
        self.lost: list[int] = []
        self._watch = self.clock.timer(lambda: self.lost.append(self.clock.now))

        self.order: list[tuple[str, int]] = []

    def receive(self, frame: Frame) -> list[Frame]:
        self.order.append(("heard", self.clock.now))
        if frame == REQUESTED:
            self._watch.start(50_000)
        return super().receive(frame)

    def overdue(self) -> list[Frame]:
        self.order.append(("late", self.clock.now))
        return super().overdue()


def test_queued_frame_is_heard_before_its_deadline_is_judged() -> None:
    host = Host(every(10_000), until=600_000, frame_cost=20, pauses=((200_001, 300_000),))
    node = WatchingNode()
    run(node, host)
    assert node.lost == [], "the bus was never silent: the process was not run"
    after = [event for event in node.order if event[1] > 300_000]
    assert after[0] == ("late", 500_020), "what must not wait comes before what waited"
    heard = next(at for at, event in enumerate(after) if event[0] == "heard" and event[1] > 500_500)
    assert after[heard - 1] == ("late", after[heard][1]), "also after 30 were read"


def test_frame_of_a_pause_after_a_wait_is_heard_before_its_deadline() -> None:
    requests = [(at, REQUESTED) for at in (0, 40_000, 89_500)]
    host = Host(requests, until=120_000, pauses=((89_000, 5000),))
    node = WatchingNode()
    node.clock.timer(int).start(TICK_US, periodic=True)
    run(node, host)
    assert node.lost == [], "the wait until 89 ms was silent, the bus was not"


def test_after_a_pause_the_node_knows_which_frames_are_overtaken() -> None:
    host = Host(every(1000, SYNC), until=60_500, frame_cost=20, pauses=((20_500, 14_400),))
    node = ToyNode()
    run(node, host)
    syncs = [frame for frame in node.heard if frame == SYNC]
    assert len(syncs) == 75, "each is heard"
    assert node.passed == [SYNC] * 14


def test_but_not_for_longer_than_10_ms() -> None:
    def frames() -> Iterator[tuple[int, Frame]]:
        yield 0, REQUESTED
        yield from ((1000 + k, OTHER) for k in range(500))
        yield 60_000, REQUESTED

    host = Host(frames(), until=200_000, frame_cost=100, pauses=((1000, 100_000),))
    node = WatchingNode()
    run(node, host)
    (lost,) = node.lost[:1]
    assert 101_000 + 5_000 < lost <= 101_000 + HEARD_LATE_US + 100


def order_after(host: Host, us: int) -> list[int]:
    """Identifiers of answers and of the ticker, in the order in which they were sent."""
    return [frame.can_id for at, frame in host.sent if at > us]


@pytest.mark.parametrize("late", [0, 1, 150, 700, 1900])
@pytest.mark.parametrize("frames", [1, 2, 4])
def test_frame_before_a_tick_is_heard_before_it(late: int, frames: int) -> None:
    # The first of them wakes the process, which is held up then until after the tick.
    host = Host(burst(4995, frames), until=7900, pauses=((4995, 5 + late),))
    run(ToyNode(), host)
    assert order_after(host, 4000) == [REPLY + 1] * frames + [TICKER + 1, OFF + 1]


def test_but_no_more_than_four_frames_are() -> None:
    host = Host(burst(4995, 10), until=9000, pauses=((4995, 100),))
    run(ToyNode(), host)
    ids = order_after(host, 4000)
    assert ids.index(TICKER + 1) == 4
    assert ids.count(REPLY + 1) == 10


def test_due_timers_come_first_in_a_flood_until_the_bus_is_empty() -> None:
    flood = [(4995, REQUESTED)] * 160
    apart = [(at, REQUESTED) for at in range(14_000, 14_990, 70)]
    last = [(14_995, REQUESTED)] * 3
    host = Host([*flood, *apart, *last], until=19_000, frame_cost=50, pauses=((14_995, 100),))
    run(ToyNode(), host)
    ticks = [at for at, frame in host.sent if frame.can_id == TICKER + 1]
    assert 10_000 <= ticks[1] <= 10_050, "the flood goes on, and holds it up for one frame"
    assert max(at for at, frame in host.sent if at < 13_000) > 10_500
    ids = order_after(host, 14_994)
    assert ids.index(TICKER + 1) == 4, "a frame came before each wait was over, but none waited"


def test_runner_held_up_while_hearing_drains_as_after_a_pause() -> None:
    late = [(4000, OTHER), *[(4995, OTHER)] * 2, *[(6000, REQUESTED)] * 30]
    host = Host(late, until=6800, pauses=((4995, 100), (5097, 3000)), frame_cost=1)
    run(ToyNode(), host)
    ids = order_after(host, 4994)
    assert ids.count(REPLY + 1) == 30
    assert ids.index(TICKER + 1) == ids.index(OFF + 1) - 1, "what is due comes after what waited"


def test_overdue_deadline_acts_before_queued_frames() -> None:
    host = Host(burst(5050, 3), until=7900, frame_cost=300, pauses=((5000, 100),))
    node = ToyNode()
    run(node, host)
    assert node.late[0] == 5100, "before the first of them is even read"


def test_newer_frame_of_a_kind_marks_the_older_overtaken() -> None:
    host = Host([(1500, OTHER), *[(3000, SYNC)] * 2, (4000, SYNC)], until=4900)
    node = ToyNode()
    run(node, host)
    assert node.heard == [OTHER, SYNC, SYNC, SYNC]
    assert node.passed == [SYNC]


def test_a_watch_that_ends_in_a_flood_ends_in_time() -> None:
    def frames() -> Iterator[tuple[int, Frame]]:
        yield 0, REQUESTED
        yield from every(10, OTHER, start=10)

    for cost in (10, 125, 130, 1000, 5000):
        host = Host(frames(), until=100_000, frame_cost=cost)
        node = WatchingNode()
        run(node, host)
        assert node.lost[0] <= cost + 50_000 + PROMISE_US, cost


@pytest.mark.parametrize("lockstep", [False, True])
def test_full_queue_delays_nothing_and_is_told_after_its_cycle(lockstep: bool) -> None:
    syncs = every(1000, SYNC, start=1000)
    host = Host(syncs, until=30_000, full=lambda now: 10_500 <= now < 20_500)
    node = ToyNode()
    told: list[int] = []

    class Clogged(Nobody):
        def full(self, reason: QueueFullError) -> None:
            told.append(host.now)

    run(node, host, lockstep=lockstep, observer=Clogged())
    assert node.failures >= 9, "each cycle that had no answer"
    (began,) = told
    assert 11_000 <= began <= 12_200, "an answer made at 11 ms is late at 12 ms"
    times = [int.from_bytes(f.data, "little") for _, f in host.sent if f.can_id == AT_SYNC + 1]
    assert times[:10] == [k * 1000 for k in range(1, 11)]
    assert not [at for at in times if 11_000 <= at <= 18_000], "old ones are of no use"
    first_after = next(frame for at, frame in host.sent if at >= 20_500)
    assert first_after.can_id == EMERGENCY + 1
    assert len(node.heard) >= 28


def test_other_frames_wait_and_are_no_fault() -> None:
    host = Host(burst(10_500, 3), until=40_000, full=lambda now: 10_200 <= now < 14_000)
    node = ToyNode()
    run(node, host)
    assert host.ids_sent().count(REPLY + 1) == 3
    assert node.failures == 0


def test_timer_reads_no_bus_that_was_silent() -> None:
    host = Host(until=100_000)
    node = PunctualNode(host)
    run(node, host)
    assert node.ticks == 99
    assert host.reads <= 2, "the first, and one after a wait of 50 ms"


def test_frame_is_read_once_and_the_bus_found_empty_once() -> None:
    host = Host(every(1000, start=500), until=100_000)
    node = PunctualNode(host)
    run(node, host)
    assert (node.ticks, len(node.heard)) == (99, 100)
    assert host.reads <= 202


def test_state_is_followed_every_10_ms_when_there_is_time() -> None:
    host = Host(every(400), until=100_000)
    run(PunctualNode(host), host, observer=(follower := Follower(host)))
    gaps = [after - before for before, after in pairwise([0, *follower.followed])]
    assert max(gaps) <= 12_000
    assert min(gaps[1:-1]) >= 10_000
    assert max(at % TICK_US for at in follower.followed[:-1]) < 500, "half a tick is left"


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize("cost", [0, 1000, 3000])
@pytest.mark.parametrize("full", [False, True])
def test_busy_runner_reports_states_each_50_ms(lockstep: bool, cost: int, full: bool) -> None:
    host = Host(every(10), until=200_000, frame_cost=10, full=lambda now: full and now > 5000)
    node = PunctualNode(host, advance_cost=cost) if cost else ToyNode()
    run(node, host, lockstep=lockstep, observer=(follower := Follower(host)))
    gaps = [after - before for before, after in pairwise([0, *follower.followed])]
    assert max(gaps) <= 70_000


def test_in_lockstep_the_state_is_followed_at_each_sync() -> None:
    host = Host(burst(500, 100, SYNC), until=1000)
    run(ToyNode(), host, lockstep=True, observer=(follower := Follower(host)))
    assert len(follower.followed) >= 100, "a state may last for no time of the clock"


def test_frames_read_before_a_bus_is_lost_are_not_heard() -> None:
    host = Host([(1000, OTHER)], until=50_000)
    node = ToyNode()
    read = host.read

    def fail(frames: deque[Frame]) -> bool:
        if read(frames):
            frames.append(REQUESTED)
            raise BusError("unplugged")
        return False

    host.read = fail  # type: ignore[method-assign]
    bus = ReconnectingBus(lambda: host, node, lost=lambda _: None, back=lambda: None)
    run_node(node, bus, host.at_end, **host.time)
    assert node.heard == []


def test_the_node_knows_the_time_at_which_it_is_shut_down() -> None:
    times: list[int] = []

    class TimedNode(ToyNode):
        def shutdown(self) -> list[Frame]:
            times.append(self.time)
            return super().shutdown()

    node = TimedNode()
    node.start = list  # type: ignore[method-assign]  # it has no timer
    host = Host(until=40_000)
    run(node, host)
    assert times == [host.now]


def test_many_frames_at_once_do_not_hold_up_time() -> None:
    class TalkingNode(PunctualNode):
        def receive(self, frame: Frame) -> list[Frame]:
            return [Frame(REPLY + 1)] * 20

    host = Host([(10_500, REQUESTED)], until=60_000, send_cost=900)
    node = TalkingNode(host)
    run(node, host)
    assert host.ids_sent().count(REPLY + 1) == 20
    assert max(node.behind) <= 4000, "20 frames take 18 ms"


def test_one_slow_read_does_not_shorten_later_ones() -> None:
    # The first frame takes the bus 4 ms; those before the tick at 15 ms come at once.
    host = Host([(6000, OTHER), *burst(14_995, 4)], until=19_000, pauses=((14_995, 100),))
    read = host.read

    def slow(frames: deque[Frame]) -> bool:
        more = read(frames)
        if more and frames[-1] == OTHER:
            host.now += 4000
        return more

    host.read = slow  # type: ignore[method-assign]
    run(ToyNode(), host)
    ids = order_after(host, 14_000)
    assert ids.index(TICKER + 1) == 4


def test_no_more_is_read_than_is_heard_in_some_milliseconds() -> None:
    host = Host(every(10), until=300_000)
    most = 0

    class SlowNode(ToyNode):
        def receive(self, frame: Frame) -> list[Frame]:
            host.now += 50
            return super().receive(frame)

    def read(frames: deque[Frame]) -> bool:
        nonlocal most
        more = Host.read(host, frames)
        most = max(most, len(frames))
        return more

    host.read = read  # type: ignore[method-assign]
    node = SlowNode()
    node.start = list  # type: ignore[method-assign]  # it has no timer
    run(node, host)
    assert 100 < most < 400


def test_a_flood_that_ended_is_over_though_nothing_came_since() -> None:
    burst_of = [(4990, OTHER)] * 33
    for cost in (100, 300, 310, 700):
        beat = [(60_000, REQUESTED)]
        host = Host([*burst_of, *beat], until=95_000, frame_cost=cost, pauses=((59_500, 30_000),))
        run(ToyNode(), host)
        ids = order_after(host, 60_000)
        assert ids.index(REPLY + 1) < ids.index(TICKER + 1), cost


class LearningNode(ToyNode):
    """Hears another identifier from a frame on."""

    def __init__(self, lesson: Frame = REQUESTED) -> None:
        super().__init__()
        self.lesson = lesson

    def receive(self, frame: Frame) -> list[Frame]:
        if frame == self.lesson:
            self.ids = self.ids._replace(heard=self.ids.heard | {LEARNT})
        return super().receive(frame)


@pytest.mark.parametrize("lockstep", [False, True])
def test_identifier_wanted_by_a_frame_is_heard_right_behind_it(lockstep: bool) -> None:
    node = LearningNode(OTHER)
    run(node, Host([(1000, OTHER), (1000, Frame(LEARNT))], until=3000), lockstep=lockstep)
    assert node.heard == [OTHER, Frame(LEARNT)]


@pytest.mark.parametrize("lockstep", [False, True])
def test_an_observer_sees_the_beginning_and_the_end(lockstep: bool) -> None:
    host = Host([(1000, SYNC)], until=3000)
    run(ToyNode(), host, lockstep=lockstep, observer=(follower := Follower(host)))
    assert follower.ends == ["started", "stopped"]
    assert follower.followed[-1] == host.now


@pytest.mark.parametrize("lockstep", [False, True])
def test_kernel_drops_identifiers_passed_over_often_until_wanted(lockstep: bool) -> None:
    rare, often = Frame(0x401), Frame(LEARNT)
    frames = [(at, often) for at in range(100, 30_000, 200)]
    frames += [(at, rare) for at in range(110, 30_000, 400)]
    frames += [(at, REQUESTED) for at in range(120, 25_000, 5000)][-1:]
    host = Host(sorted(frames), until=50_000)
    heard: list[int] = []
    node = LearningNode()
    node.heard = heard  # type: ignore[assignment]
    run(node, host, lockstep=lockstep)
    assert host.blocked == [{LEARNT}, set()]
    assert [frame for frame in node.heard if frame == often][0:1] == [often]


@pytest.mark.parametrize("lockstep", [False, True])
def test_new_identifier_is_listened_to_before_the_answer_is_sent(lockstep: bool) -> None:
    host = Host([(1000, REQUESTED)], until=10_000)
    send = host.send

    def answered(frame: Frame) -> None:
        send(frame)
        if frame.can_id == REPLY + 1:
            host._queue.append(Frame(LEARNT))

    host.send = answered  # type: ignore[method-assign]
    node = LearningNode()
    run(node, host, lockstep=lockstep)
    assert node.heard == [REQUESTED, Frame(LEARNT)], (
        "a first heartbeat may follow the answer at once"
    )


def test_sync_comes_to_a_node_in_lockstep_that_does_not_hear_it() -> None:
    host = Host([(1000, SYNC)], until=2000)
    node = ToyNode()
    node.ids = node.ids._replace(heard=frozenset({REQUEST + 1}))
    run(node, host, lockstep=True)
    assert node.advances == [1000], "a stopped node has its heartbeat"


def test_runner_takes_the_sync_identifier_of_the_node() -> None:
    other = Frame(0x081)
    node = ToyNode()
    node.ids = node.ids._replace(sync=other.can_id)
    run(node, Host([(1000, SYNC), (2000, other), (3000, other)], until=4000), lockstep=True)
    assert node.advances == [1000, 1000]
    node = ToyNode()
    node.ids = node.ids._replace(sync=other.can_id, heard=node.ids.heard | {other.can_id})
    run(node, Host([(1500, OTHER), *[(3000, SYNC)] * 2, *[(4000, other)] * 2], until=4900))
    assert node.passed == [SYNC, other]


def fail(*_: Frame) -> list[Frame]:
    raise ZeroDivisionError


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize("fails", ["receive", "follow", "stopped"])
def test_any_failure_shuts_the_node_down_and_closes_the_bus(
    lockstep: bool, fails: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, host, observer = ToyNode(), Host(every(1000, SYNC), until=200_000), Nobody()
    monkeypatch.setattr(node if fails == "receive" else observer, fails, fail)
    with pytest.raises(ZeroDivisionError):
        run(node, host, lockstep=lockstep, observer=observer)
    assert host.sent[-1][1] == Frame(OFF + 1, bytes(2))
    assert host.closed == 1


def test_dead_bus_is_reported_by_its_first_failure() -> None:
    node, host = ToyNode(), Host(iter([(0, SYNC)]), until=1000)
    shut_down: list[Callable[[], list[Frame]]] = []

    def receive(frame: Frame) -> list[Frame]:
        host.broken = True
        return [Frame(0x111)]

    def shutdown() -> list[Frame]:
        shut_down.append(shutdown)
        return [Frame(0x222)]

    node.receive, node.shutdown = receive, shutdown  # type: ignore[method-assign]
    with pytest.raises(BusError, match="broken at 111"):
        run(node, host)
    assert len(shut_down) == 1
    assert host.closed == 1


def test_the_farewell_waits_for_a_full_queue_but_not_for_long() -> None:
    host = Host(until=10_000, full=lambda now: 9_000 <= now < 50_000)
    run(ToyNode(), host)
    at, word = host.sent[-1]
    assert 50_000 <= at < 51_000
    assert word == Frame(OFF + 1, bytes(2))
    host = Host(until=10_000, full=lambda now: now >= 9_000)
    run(ToyNode(), host)
    assert host.now <= 10_000 + 100_000 + 1000
    assert host.closed == 1
