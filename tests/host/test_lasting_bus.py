"""A connection whose interface comes and goes, on a scripted clock."""

from itertools import pairwise

import pytest

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import BusError, QueueFullError
from smarttac_can.host.lasting_bus import FIRST_WAIT_S, LONGEST_WAIT_S, LastingBus

HELLO, GOODBYE = Frame(0x701, b"\x7f"), Frame(0x081, bytes(8))
FULL = Frame(0x081, b"\x11\x81".ljust(8, b"\0"))


class Interface:
    """What can be unplugged."""

    def __init__(self) -> None:
        self.now = 0.0
        self.plugged = True
        self.down = False
        self.full = False
        self.tries: list[float] = []
        self.sent: list[Frame] = []
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
        if self.interface.full:
            raise QueueFullError("queue full")
        self.interface.sent.append(frame)

    def receive(self, timeout: float) -> Frame | None:
        self.check()
        self.interface.sleep(timeout)
        return None

    def check(self) -> None:
        if not self.interface.plugged or self.interface.down:
            raise BusError("network is down")

    def close(self) -> None:
        self.interface.open -= 1


def lasting(interface: Interface) -> tuple[LastingBus, list[str]]:
    said: list[str] = []

    def back() -> list[Frame]:
        said.append("back")
        return [HELLO]

    def full(reason: BusError) -> list[Frame]:
        said.append(f"full: {reason}")
        return [FULL] if len(said) == 1 else []

    bus = LastingBus(
        interface.connect,
        lost=lambda reason: said.append(f"lost: {reason}"),
        back=back,
        full=full,
        clock=lambda: interface.now,
        pause=interface.sleep,
    )
    return bus, said


@pytest.mark.parametrize("use", [lambda bus: bus.send(GOODBYE), lambda bus: bus.receive(0.001)])
def test_lost_is_told_once_and_the_broken_connection_closed(use):
    interface = Interface()
    bus, said = lasting(interface)
    interface.plugged = False
    for _ in range(3):
        use(bus)
    assert said == ["lost: network is down"]
    assert (interface.open, interface.sent) == (0, [])


def test_tries_again_at_growing_intervals_up_to_the_longest():
    interface = Interface()
    bus, _ = lasting(interface)
    interface.plugged = False
    while interface.now < 30.0:
        bus.receive(0.001)
    waits = [b - a for a, b in pairwise(interface.tries)]
    assert waits[0] == pytest.approx(FIRST_WAIT_S, abs=0.03)
    assert all(later >= earlier - 0.03 for earlier, later in pairwise(waits))
    assert waits[-1] == pytest.approx(LONGEST_WAIT_S, abs=0.03)


def test_back_is_told_its_frames_are_sent_and_the_interval_begins_anew():
    interface = Interface()
    bus, said = lasting(interface)
    for _ in range(2):
        interface.plugged = False
        bus.receive(0.001)
        interface.sleep(2 * LONGEST_WAIT_S)
        bus.receive(0.001)
        interface.plugged = True
        interface.sleep(2 * FIRST_WAIT_S + 0.001)
        bus.receive(0.001)
    assert said == ["lost: network is down", "back"] * 2
    assert interface.sent == [HELLO, HELLO]
    bus.close()
    assert interface.open == 0


def test_a_full_queue_is_told_and_no_reason_to_leave():
    interface = Interface()
    bus, said = lasting(interface)
    interface.full = True
    bus.send(GOODBYE)
    interface.full = False
    bus.send(GOODBYE)
    assert said == ["full: queue full"]
    assert (interface.sent, interface.tries) == ([FULL, GOODBYE], [0.0])


def test_what_is_to_say_of_a_full_queue_goes_out_before_the_next_frame_it_takes():
    interface = Interface()
    bus, said = lasting(interface)
    interface.full = True
    for _ in range(3):
        bus.send(GOODBYE)
    interface.full = False
    bus.send(GOODBYE)
    bus.send(GOODBYE)
    assert said == ["full: queue full"] * 3
    assert interface.sent == [FULL, GOODBYE, GOODBYE]


def test_what_was_to_say_of_a_full_queue_ends_with_the_bus():
    interface = Interface()
    bus, _ = lasting(interface)
    interface.full = True
    bus.send(GOODBYE)
    interface.full = interface.plugged = False
    bus.send(GOODBYE)
    interface.plugged = True
    interface.sleep(LONGEST_WAIT_S)
    bus.receive(0.001)
    assert interface.sent == [HELLO]


def test_an_interface_that_opens_while_it_is_down_is_not_back():
    interface = Interface()
    bus, said = lasting(interface)
    interface.down = True
    while interface.now < 30.0:
        bus.receive(0.1)
    assert said == ["lost: network is down"]
    waits = [b - a for a, b in pairwise(interface.tries)]
    assert waits[-1] == pytest.approx(LONGEST_WAIT_S, abs=0.2)
    assert interface.open == 0
    interface.down = False
    interface.sleep(LONGEST_WAIT_S)
    bus.receive(0.1)
    assert (said[1:], interface.sent) == (["back"], [HELLO])


def test_the_first_connection_must_be_there():
    interface = Interface()
    interface.plugged = False
    with pytest.raises(BusError, match="no such device"):
        lasting(interface)
