"""Frames on their way to a bus that takes them or not, on a scripted clock."""

from collections.abc import Callable, Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_node import AT_SYNC, EMERGENCY, REPLY, TICKER, ToyNode

from smarttac_can.canopen.bus.bus import BusError, QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.outbox import Outbox

TICK_US = 1000
STEP_US = 200
"""How often it is tried to hand something over."""
MOST = 8


class Queue:
    """The transmit queue of a bus, with room for so many frames."""

    def __init__(self) -> None:
        self.room = 0
        self.sent: list[Frame] = []
        self.tries = 0

    def send(self, frame: Frame) -> None:
        self.tries += 1
        if self.room == 0:
            raise QueueFullError(f"queue full at try {self.tries}")
        self.room -= 1
        self.sent.append(frame)


class Node(ToyNode):
    """Numbers its emergency messages."""

    def __init__(self, answers: int = 1) -> None:
        super().__init__()
        self.answers = answers
        self.told_at: list[int] = []

    def transmit_failed(self) -> list[Frame]:
        self.told_at.append(self.clock.now)
        return [emergency(len(self.told_at))] * self.answers


def numbered(can_id: int, number: int) -> Frame:
    return Frame(can_id, number.to_bytes(4, "little"))


def urgent(number: int) -> Frame:
    return numbered(AT_SYNC + 1, number)


def emergency(number: int) -> Frame:
    return numbered(EMERGENCY + 1, number)


def other(number: int) -> Frame:
    return numbered(REPLY + 1, number)


class Case:
    """An outbox with all that is around it."""

    def __init__(self, answers: int = 1) -> None:
        self.node = Node(answers)
        self.queue = Queue()
        self.said: list[str] = []
        self.outbox = Outbox(self.node, self.queue, lambda reason: self.said.append(str(reason)))

    def put(self, *frames: Frame) -> None:
        self.outbox.put(frames)

    def flush(self, room: int = 1000, most: int = MOST) -> list[Frame]:
        """Hand over to a queue with so much room; return what it took."""
        before = len(self.queue.sent)
        self.queue.room = room
        for _ in range(most):
            if not self.outbox.hand_over():
                break
        return self.queue.sent[before:]

    def try_for(self, microseconds: int) -> None:
        """Let time pass, and try all along to hand over to a full queue."""
        for _ in range(microseconds // STEP_US):
            self.node.clock.now += STEP_US
            assert self.flush(0) == []


def test_urgent_frames_go_first_and_each_class_in_order() -> None:
    case = Case()
    case.put(other(1), urgent(1), other(2), emergency(2))
    case.put(numbered(TICKER + 1, 3), other(3))
    wanted = [urgent(1), emergency(2), numbered(TICKER + 1, 3), other(1), other(2), other(3)]
    assert case.flush() == wanted
    assert case.outbox.empty
    assert case.flush() == []


def test_nothing_of_before_a_reset_follows_its_boot_up_message() -> None:
    case = Case()
    case.put(other(1), urgent(1), other(2))
    case.put(other(3), Frame(0x701, b"\0"), other(4))
    assert case.flush() == [urgent(1), Frame(0x701, b"\0"), other(4)]
    case.put(other(5), Frame(0x701, b"\5"))
    assert case.flush() == [other(5), Frame(0x701, b"\5")]


def test_outbox_asks_the_node_which_frames_are_urgent() -> None:
    case = Case()
    case.node.ids = case.node.ids._replace(urgent=frozenset({REPLY + 1}))
    case.put(urgent(1), other(1))
    assert case.flush() == [other(1), urgent(1)]


def test_a_full_bus_is_asked_once_and_keeps_the_order() -> None:
    case = Case()
    case.put(other(1), urgent(1), urgent(2), other(2))
    assert case.flush(0) == []
    assert case.queue.tries == 1, "nobody waits for a full bus"
    assert case.flush(1) == [urgent(1)]
    case.put(urgent(3))
    assert case.flush(3) == [urgent(2), urgent(3), other(1)]
    assert case.flush() == [other(2)]
    assert case.said == []


def test_urgent_frame_is_a_fault_from_one_tick_of_age_on() -> None:
    case = Case()
    case.node.clock.now = 5_000_000
    case.put(urgent(1))
    case.try_for(TICK_US - STEP_US)
    case.node.clock.now += STEP_US - 1
    assert case.flush(0) == []
    assert case.node.told_at == []
    case.node.clock.now += 1
    assert case.flush(0) == []
    assert case.node.told_at == [5_001_000]
    assert case.said == ["queue full at try 6"], "the word of the bus"


def test_full_queue_reaches_the_node_per_tick_others_per_episode() -> None:
    case = Case()
    for number in range(10):
        case.put(urgent(number))
        case.try_for(TICK_US)
    assert case.node.told_at == [TICK_US * n for n in range(1, 11)]
    assert len(case.said) == 1
    assert case.flush(3) == [emergency(1), emergency(2), emergency(3)]
    case.try_for(2 * TICK_US)
    assert len(case.said) == 1, "the episode lasts until nothing waits"
    while case.flush():
        pass
    case.put(urgent(11))
    case.try_for(TICK_US)
    assert len(case.said) == 2


def test_an_episode_lasts_while_the_bus_takes_nothing() -> None:
    case = Case(answers=0)
    for number in range(5):
        case.put(urgent(number))
        case.try_for(TICK_US)
        assert case.outbox.empty, "it was of no use any more"
        assert case.flush() == []
    assert len(case.node.told_at) == 5
    assert len(case.said) == 1


def test_outbox_keeps_emcy_and_the_last_frames_of_the_node_alone() -> None:
    case = Case()
    case.node.transmit_failed = lambda: [other(9), urgent(9)]  # type: ignore[method-assign]
    case.put(emergency(7), urgent(1), other(1), emergency(8))
    case.try_for(TICK_US)
    case.put(other(2))
    assert case.flush() == [emergency(7), emergency(8), urgent(9), other(1), other(9), other(2)]


@pytest.mark.parametrize(("kind", "faults"), [(other, 0), (emergency, 200)])
def test_outbox_is_bounded_and_drops_the_oldest_frames(
    kind: Callable[[int], Frame], faults: int
) -> None:
    case = Case(answers=0)
    for number in range(200):
        case.put(kind(number))
        case.try_for(TICK_US)
    assert (len(case.node.told_at), len(case.said)) == (faults, faults > 0)
    assert case.flush(most=1000) == [kind(number) for number in range(200 - 64, 200)]


def test_a_bus_that_is_lost_is_not_a_full_one() -> None:
    class Lost(Queue):
        def send(self, frame: Frame) -> None:
            raise BusError("gone")

    case = Case()
    outbox = Outbox(case.node, Lost(), lambda reason: case.said.append(str(reason)))
    outbox.put([urgent(1)])
    case.node.clock.now += 2 * TICK_US
    with pytest.raises(BusError, match="gone"):
        outbox.hand_over()
    assert (case.node.told_at, case.said) == ([], [])


STEPS = st.tuples(
    st.sampled_from([0, 0, 0, 1, 2, 5, 1000]),  # room in the queue
    st.lists(st.sampled_from([urgent, emergency, other]), max_size=4),
)


def ascending(frames: Iterable[Frame]) -> list[int]:
    """The numbers of frames; they must ascend."""
    numbers = [int.from_bytes(frame.data, "little") for frame in frames]
    assert numbers == sorted(set(numbers))
    return numbers


@settings(deadline=None, max_examples=300)
@given(st.lists(STEPS, max_size=60), st.sampled_from([1, MOST, 1000]))
def test_urgent_frame_is_sent_within_its_tick_or_reported(
    steps: list[tuple[int, list]], most: int
) -> None:
    case = Case(answers=0)
    made: dict[Frame, int] = {}
    sent: dict[Frame, int] = {}
    for room, kinds in steps:
        frames = [kind(len(made) + n) for n, kind in enumerate(kinds)]
        made.update((frame, case.node.clock.now) for frame in frames)
        case.put(*frames)
        left = room
        # A bus that takes frames is asked again at once, as long as there are any.
        while taken := case.flush(left, most):
            sent.update((frame, case.node.clock.now) for frame in taken)
            left -= len(taken)
        case.node.clock.now += STEP_US
    loop = [f for f in made if f.can_id == AT_SYNC + 1]
    for frame in loop:
        if frame in sent:
            assert sent[frame] - made[frame] <= TICK_US
        elif case.node.clock.now - made[frame] > TICK_US:
            told = [t for t in case.node.told_at if made[frame] <= t <= made[frame] + TICK_US]
            assert told, f"{frame} is neither sent nor told of"
    for earlier, later in zip(case.node.told_at, case.node.told_at[1:], strict=False):
        assert later > earlier
    assert len(case.said) <= len(case.node.told_at)
    for can_ids in ({AT_SYNC + 1, EMERGENCY + 1}, {REPLY + 1}):
        ascending(frame for frame in sent if frame.can_id in can_ids)
    while taken := case.flush():
        sent.update((frame, case.node.clock.now) for frame in taken)
    assert case.outbox.empty
    assert all(frame in sent for frame in made if frame.can_id == EMERGENCY + 1)
    if not case.node.told_at:
        assert sent.keys() == made.keys()
