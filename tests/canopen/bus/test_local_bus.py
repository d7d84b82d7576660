import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_node import (
    AT_SYNC,
    BOOT_UP,
    REPLY,
    REQUEST,
    SEGMENT,
    SYNC,
    TICKER,
    StreamingNode,
    ToyNode,
)

from smarttac_can.canopen.bus.bus import BusError
from smarttac_can.canopen.bus.local_bus import Connection, LocalBus
from smarttac_can.canopen.device.frame import Frame

Log = list[tuple[int, Frame]]


def logged(bit_rate: int = 1_000_000) -> tuple[LocalBus, Log]:
    log: Log = []
    return LocalBus(bit_rate=bit_rate, log=lambda time, frame: log.append((time, frame))), log


def test_segments_follow_when_nothing_else_waits() -> None:
    bus, log = logged()
    port = bus.connect(lambda frame: None)
    bus.attach(StreamingNode(1))
    bus.attach(ToyNode(2, follows=REQUEST + 1))
    bus.attach(ToyNode(3, follows=SEGMENT + 1))
    del log[:]
    port.send(Frame(REQUEST + 1, b"\2"))
    assert [frame.can_id for _, frame in log] == [
        *(REQUEST + 1, REPLY + 1, REPLY + 2, SEGMENT + 1, SEGMENT + 1, REPLY + 3, REPLY + 3)
    ]


def test_frame_sent_from_a_listener_waits_for_its_turn() -> None:
    bus = LocalBus()
    port = bus.connect(lambda frame: None)

    def answer_twice(frame: Frame) -> None:
        if frame.can_id == 1:
            second.send(Frame(2))
            second.send(Frame(3))

    second = bus.connect(answer_twice)
    third: list[Frame] = []
    bus.connect(third.append)
    port.send(Frame(1))
    assert third == [Frame(1), Frame(2), Frame(3)]


def test_time_stamps_count_the_longest_frame_at_the_bit_rate() -> None:
    bus, log = logged()
    port = bus.connect(lambda frame: None)
    port.send(Frame(1))
    port.send(Frame(1, bytes(8)))
    port.send(Frame(1, rtr=True))
    assert [time for time, _ in log] == [55, 55 + 135, 55 + 135 + 55]
    slow, slow_log = logged(bit_rate=800_000)
    slow.connect(lambda frame: None).send(Frame(1, bytes(8)))
    assert slow_log == [(169, Frame(1, bytes(8)))]


def test_sync_is_at_a_whole_millisecond_of_a_lockstep_bus() -> None:
    bus, log = logged()
    port = bus.connect(lambda frame: None)
    bus.attach(ToyNode())
    for _ in range(3):
        port.send(SYNC)
    assert [time for time, frame in log if frame == SYNC] == [1055, 2055, 3055]


def test_sync_advances_nodes_and_clock_by_the_tick_given() -> None:
    log: Log = []
    bus = LocalBus(tick=250, log=lambda time, frame: log.append((time, frame)))
    node = ToyNode()
    bus.attach(node)
    port = bus.connect(lambda frame: None)
    port.send(SYNC)
    bus.advance(600)
    assert node.advances == [250, 250, 250, 100]
    assert [time for time, frame in log if frame == SYNC] == [250 + 55]
    with pytest.raises(ValueError, match=r"^tick 0 is not above 0$"):
        LocalBus(tick=0)


def test_sync_moves_no_clock_where_nobody_is_in_lockstep() -> None:
    bus = LocalBus()
    node = ToyNode()
    bus.attach(node, lockstep=False)
    bus.connect(lambda frame: None).send(SYNC)
    assert node.advances == []
    assert bus.time < 1000


def test_clock_does_not_run_back_when_a_tick_is_overfull() -> None:
    bus, log = logged(bit_rate=10_000)
    port = bus.connect(lambda frame: None)
    bus.attach(ToyNode())
    for _ in range(3):
        port.send(SYNC)
    stamps = [time for time, _ in log]
    assert stamps == sorted(set(stamps))
    assert bus.time > 3000 + 6 * 5500


def test_advance_without_sync_lets_timers_run_tick_by_tick() -> None:
    bus, log = logged()
    lockstep, clocked = ToyNode(1), ToyNode(2)
    bus.attach(lockstep)
    bus.attach(clocked, lockstep=False)
    del log[:]
    bus.advance(5500)
    assert lockstep.advances == clocked.advances == [1000] * 5 + [500]
    assert [frame.can_id for _, frame in log] == [TICKER + 1, TICKER + 2]
    assert bus.time == 5500
    with pytest.raises(ValueError, match="-1 is below 0"):
        bus.advance(-1)


def test_local_bus_sync_moves_lockstep_nodes_but_its_producer() -> None:
    bus = LocalBus()
    producer, clocked, follower = ToyNode(1), ToyNode(2), ToyNode(3)
    port = bus.attach(producer)
    bus.attach(clocked, lockstep=False)
    bus.attach(follower)
    port.send(SYNC)
    assert SYNC in clocked.heard
    assert (producer.advances, clocked.advances, follower.advances) == ([], [], [1000])


def test_closed_port_is_off_the_bus() -> None:
    bus = LocalBus()
    inbox: list[Frame] = []
    port = bus.connect(inbox.append)
    node = ToyNode()
    plug = bus.attach(node)
    assert inbox == [Frame(BOOT_UP + 1, b"\0")]
    plug.close()
    plug.close()
    port.send(Frame(REQUEST + 1))
    plug.send(Frame(1))
    bus.advance(10_000)
    bus.shutdown()
    assert node.heard == []
    assert node.advances == []
    assert len(inbox) == 1


def test_endless_answers_are_an_error_and_leave_the_bus_usable() -> None:
    bus = LocalBus()
    inbox: list[Frame] = []
    port = bus.connect(lambda frame: None)
    first = ToyNode(1, follows=REPLY + 2)
    second = ToyNode(2, follows=REPLY + 1)
    bus.attach(first)
    plug = bus.attach(second)
    with pytest.raises(BusError, match="no rest"):
        port.send(Frame(REQUEST + 1))
    plug.close()
    bus.connect(inbox.append)
    port.send(Frame(REQUEST + 1, b"x"))
    assert inbox == [Frame(REQUEST + 1, b"x"), Frame(REPLY + 1, b"x")]


def test_long_run_driven_from_inside_a_listener_is_no_storm() -> None:
    bus = LocalBus()
    node = ToyNode()
    ticks = 60_000

    def next_sync(frame: Frame) -> None:
        if frame.can_id == AT_SYNC + 1 and node.time < ticks * 1000:
            port.send(SYNC)

    port = bus.connect(next_sync)
    bus.attach(node)
    port.send(SYNC)
    assert node.time == ticks * 1000
    assert bus.time >= ticks * 1000


def test_listener_error_reaches_the_sender_with_an_empty_queue() -> None:
    bus = LocalBus()

    def fail(frame: Frame) -> None:
        if frame.data == b"bad":
            raise ZeroDivisionError

    inbox: list[Frame] = []
    port = bus.connect(inbox.append)
    bus.attach(ToyNode())
    bus.connect(fail)
    del inbox[:]
    with pytest.raises(ZeroDivisionError):
        port.send(Frame(REQUEST + 1, b"bad"))
    assert inbox == []
    port.send(Frame(REQUEST + 1, b"good"))
    assert inbox == [Frame(REPLY + 1, b"good")]


def test_local_bus_refuses_long_frames_and_bit_rate_0() -> None:
    port = LocalBus().connect(lambda frame: None)
    with pytest.raises(ValueError, match=r"9 data bytes are outside 0\.\.8"):
        port.send(Frame(1, bytes(9)))
    with pytest.raises(ValueError, match="bit_rate 0 is not above 0"):
        LocalBus(bit_rate=0)


FRAMES = st.builds(
    Frame,
    st.sampled_from([0x080, REQUEST + 1, REQUEST + 2, REPLY + 1, 0x123]),
    st.binary(max_size=8),
    st.booleans(),
)


def replay(frames: list[Frame]) -> tuple[Log, list[Frame]]:
    bus, log = logged()
    heard: list[Frame] = []
    port: Connection = bus.connect(heard.append)
    bus.attach(ToyNode(1))
    bus.attach(ToyNode(2, follows=REPLY + 1))
    for frame in frames:
        port.send(frame)
    return log, heard


@settings(max_examples=50)
@given(st.lists(FRAMES, max_size=40))
def test_same_traffic_twice_is_the_same_to_the_microsecond(frames: list[Frame]) -> None:
    log, heard = replay(frames)
    assert (log, heard) == replay(frames)
    stamps = [time for time, _ in log]
    assert stamps == sorted(set(stamps))
    assert len(log) == len(frames) + len(heard)
