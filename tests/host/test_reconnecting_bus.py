"""A connection whose interface comes and goes, on a scripted clock."""

from collections import deque
from itertools import pairwise

import pytest
from toy_node import ToyNode

from smarttac_can.canopen.bus.bus import BusError, QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.reconnecting_bus import FIRST_WAIT_S, LONGEST_WAIT_S, ReconnectingBus

HELLO, AGAIN, GOODBYE = Frame(0x701, b"\x7f"), Frame(0x081, bytes(8)), Frame(0x081, b"\1")


class Interface:
    """A bus that can be unplugged."""

    def __init__(self) -> None:
        self.now = 0.0
        self.plugged = True
        self.down = False
        self.deaf = False
        """It is heard, but takes no frame."""
        self.room = 1000
        self.tries: list[float] = []
        self.sent: list[Frame] = []
        self.inbox: list[Frame] = []
        self.filters: list[frozenset[int]] = []
        self.open = 0

    def connect(self) -> "Connection":
        self.tries.append(self.now)
        if not self.plugged:
            raise BusError("no such device")
        self.open += 1
        return Connection(self)

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Connection:
    def __init__(self, interface: Interface) -> None:
        self.interface = interface

    def send(self, frame: Frame) -> None:
        self.check()
        if self.interface.deaf:
            raise BusError("bus error")
        if self.interface.room == 0:
            raise QueueFullError("queue full")
        self.interface.room -= 1
        self.interface.sent.append(frame)

    def wait(self, timeout: float) -> bool:
        self.check()
        if not self.interface.inbox:
            self.interface.sleep(timeout)
        return bool(self.interface.inbox)

    def read(self, frames: deque[Frame]) -> bool:
        self.check()
        frames.extend(self.interface.inbox)
        self.interface.inbox.clear()
        return False

    def block(self, can_ids: frozenset[int]) -> None:
        self.interface.filters.append(can_ids)

    def check(self) -> None:
        if not self.interface.plugged or self.interface.down:
            raise BusError("network is down")

    def close(self) -> None:
        self.interface.open -= 1
        if not self.interface.plugged:
            raise BusError("cannot leave the bus")


def lasting(interface: Interface) -> tuple[ReconnectingBus, list[str]]:
    said: list[str] = []

    class Node(ToyNode):
        def bus_off(self) -> list[Frame]:
            said.append("off")
            return [GOODBYE]

        def bus_recovered(self) -> list[Frame]:
            return [HELLO, AGAIN]

    bus = ReconnectingBus(
        interface.connect,
        Node(),
        lost=lambda reason: said.append(f"lost: {reason}"),
        back=lambda: said.append("back"),
        clock=lambda: interface.now,
        pause=interface.sleep,
    )
    return bus, said


def receive(bus: ReconnectingBus, timeout: float) -> Frame | None:
    """The use of it for a frame."""
    frames: deque[Frame] = deque()
    try:
        while bus.read(frames):
            pass
        if not frames:
            bus.wait(timeout)
            bus.read(frames)
    except BusError as error:
        bus.lose(error)
    return frames[0] if frames else None


def send(bus: ReconnectingBus, frame: Frame) -> None:
    try:
        bus.send(frame)
    except QueueFullError:
        raise
    except BusError as error:
        bus.lose(error)


def lose_and_plug_in(interface: Interface, bus: ReconnectingBus) -> None:
    interface.sleep(1.1)
    interface.plugged = False
    receive(bus, 0.001)
    interface.plugged = True
    interface.sleep(2 * FIRST_WAIT_S)


@pytest.mark.parametrize("use", [lambda bus: send(bus, GOODBYE), lambda bus: receive(bus, 0.001)])
def test_lost_is_told_once_and_the_broken_connection_closed(use):
    interface = Interface()
    bus, said = lasting(interface)
    interface.plugged = False
    for _ in range(3):
        use(bus)
    assert said == ["off", "lost: network is down"]
    assert (interface.open, interface.sent) == (0, [])


def test_tries_again_at_growing_intervals_up_to_the_longest():
    interface = Interface()
    bus, _ = lasting(interface)
    interface.plugged = False
    while interface.now < 30.0:
        receive(bus, 0.001)
    waits = [b - a for a, b in pairwise(interface.tries)]
    assert waits[0] == pytest.approx(FIRST_WAIT_S, abs=0.03)
    assert all(later >= earlier - 0.03 for earlier, later in pairwise(waits))
    assert waits[-1] == pytest.approx(LONGEST_WAIT_S, abs=0.03)


def test_reconnection_is_told_its_frames_sent_and_interval_reset():
    interface = Interface()
    bus, said = lasting(interface)
    for _ in range(2):
        interface.plugged = False
        receive(bus, 0.001)
        interface.sleep(2 * LONGEST_WAIT_S)
        receive(bus, 0.001)
        interface.plugged = True
        interface.sleep(2 * FIRST_WAIT_S + 0.001)
        receive(bus, 0.001)
        interface.sleep(1.1)
    assert said == ["off", "lost: network is down", "back"] * 2
    assert interface.sent == [HELLO, AGAIN] * 2
    bus.close()
    bus.close()
    assert interface.open == 0


def test_a_full_queue_passes_through_and_is_no_reason_to_leave():
    interface = Interface()
    bus, said = lasting(interface)
    interface.room = 0
    for _ in range(3):
        with pytest.raises(QueueFullError, match="queue full"):
            send(bus, GOODBYE)
    assert receive(bus, 0.001) is None
    interface.room = 1
    send(bus, GOODBYE)
    assert (said, interface.sent, interface.tries) == ([], [GOODBYE], [0.0])


def test_nothing_is_waited_for_while_sending():
    interface = Interface()
    bus, _ = lasting(interface)
    interface.room = 0
    with pytest.raises(QueueFullError):
        send(bus, GOODBYE)
    interface.plugged = False
    for _ in range(3):
        send(bus, GOODBYE)
    assert interface.now == 0.0


@pytest.mark.parametrize("room", [0, 1])
def test_frames_of_reconnection_wait_for_room_and_go_out_first(room):
    interface = Interface()
    bus, said = lasting(interface)
    lose_and_plug_in(interface, bus)
    interface.room = room
    receive(bus, 0.001)
    assert said == ["off", "lost: network is down", "back"]
    assert interface.sent == [HELLO, AGAIN][:room]
    interface.room = 0
    with pytest.raises(QueueFullError):
        send(bus, GOODBYE)
    interface.room = 1000
    send(bus, GOODBYE)
    send(bus, GOODBYE)
    assert interface.sent == [HELLO, AGAIN, GOODBYE, GOODBYE]


def test_frames_of_reconnection_go_out_without_a_new_send():
    interface = Interface()
    bus, _ = lasting(interface)
    lose_and_plug_in(interface, bus)
    interface.room = 0
    receive(bus, 0.001)
    interface.room = 1000
    receive(bus, 0.001)
    assert interface.sent == [HELLO, AGAIN]


def test_frames_of_reconnection_end_with_the_bus():
    interface = Interface()
    bus, said = lasting(interface)
    lose_and_plug_in(interface, bus)
    interface.room = 0
    receive(bus, 0.001)
    lose_and_plug_in(interface, bus)
    interface.room = 1000
    receive(bus, 0.001)
    assert said == ["off", "lost: network is down", "back"] * 2
    assert interface.sent == [HELLO, AGAIN]


def test_a_bus_that_is_heard_but_takes_no_frame_is_lost_again():
    interface = Interface()
    bus, said = lasting(interface)
    interface.inbox = [GOODBYE]
    lose_and_plug_in(interface, bus)
    interface.deaf = True
    assert receive(bus, 0.001) == GOODBYE, "what was heard is not lost with the bus"
    assert said == ["off", "lost: network is down", "back", "off", "lost: bus error"]
    assert (interface.open, interface.sent) == (0, [])
    interface.deaf = False
    interface.sleep(2 * FIRST_WAIT_S)
    receive(bus, 0.001)
    assert said[5:] == ["back"]
    assert interface.sent == [HELLO, AGAIN]


def test_a_bus_that_takes_no_frame_is_tried_at_growing_intervals():
    interface = Interface()
    bus, said = lasting(interface)
    lose_and_plug_in(interface, bus)
    interface.deaf = True
    while interface.now < 60.0:
        receive(bus, 0.001)
    waits = [b - a for a, b in pairwise(interface.tries[2:])]
    assert waits[-1] == pytest.approx(LONGEST_WAIT_S, abs=0.1)
    assert said.count("back") < 25


def test_an_interface_that_opens_while_it_is_down_is_not_back():
    interface = Interface()
    bus, said = lasting(interface)
    interface.down = True
    while interface.now < 30.0:
        receive(bus, 0.1)
    assert said == ["off", "lost: network is down"]
    waits = [b - a for a, b in pairwise(interface.tries)]
    assert waits[-1] == pytest.approx(LONGEST_WAIT_S, abs=0.2)
    assert interface.open == 0
    interface.down = False
    interface.sleep(LONGEST_WAIT_S)
    receive(bus, 0.1)
    assert (said[2:], interface.sent) == (["back"], [HELLO, AGAIN])


def test_blocked_identifiers_stay_blocked_after_reconnection():
    interface = Interface()
    bus, _ = lasting(interface)
    lose_and_plug_in(interface, bus)
    receive(bus, 0.001)
    assert interface.filters == [], "at first everything is heard"
    bus.block(frozenset({1}))
    lose_and_plug_in(interface, bus)
    bus.block(frozenset({2}))
    receive(bus, 0.001)
    lose_and_plug_in(interface, bus)
    receive(bus, 0.001)
    assert interface.filters == [{1}, {2}, {2}]


def test_while_it_is_there_nothing_stands_between():
    interface = Interface()
    connection = Connection(interface)
    bus = ReconnectingBus(
        lambda: connection, ToyNode(), lost=lambda _: None, back=lambda: None,
        clock=lambda: interface.now, pause=interface.sleep,
    )  # fmt: skip
    own = connection.send, connection.wait, connection.read
    assert (bus.send, bus.wait, bus.read) == own
    lose_and_plug_in(interface, bus)
    assert bus.send != connection.send
    receive(bus, 0.001)
    assert (bus.send, bus.wait, bus.read) == own


def test_without_a_bus_nobody_waits_longer_than_asked_for():
    interface = Interface()
    bus, _ = lasting(interface)
    interface.plugged = False
    send(bus, GOODBYE)
    for timeout in (0.0, 0.001, 1.0):
        before = interface.now
        assert receive(bus, timeout) is None
        assert interface.now - before == pytest.approx(min(timeout, 0.02))


def test_the_first_connection_must_be_there():
    interface = Interface()
    interface.plugged = False
    with pytest.raises(BusError, match="no such device"):
        lasting(interface)
