"""A listener's bus: a frame goes out at once, whatever the thread that listens waits for."""

import threading
from collections import deque

from nodes_on_a_bus import GUARD_S, until

from smarttac_can.bench.watch.listener import Listener
from smarttac_can.canopen.bus.bus import BusError, QueueFullError
from smarttac_can.canopen.device.frame import Frame

FRAME = Frame(0x620, bytes(8))


class SilentBus:
    """A bus on which nobody else speaks; `wait` ends when the test is over."""

    def __init__(self) -> None:
        self.sent: list[Frame] = []
        self.waits, self.over = threading.Event(), threading.Event()
        self.refusal: BusError | None = None
        self.closed = False

    def send(self, frame: Frame) -> None:
        assert not self.closed
        if self.refusal is not None:
            raise self.refusal
        self.sent.append(frame)

    def wait(self, _timeout: float) -> bool:
        self.waits.set()
        return not self.over.wait(GUARD_S)

    def read(self, _frames: deque[Frame]) -> bool:
        return False

    def block(self, can_ids: frozenset[int]) -> None:
        assert not can_ids

    def close(self) -> None:
        self.closed = True


def test_a_stop_does_not_wait_for_the_bus() -> None:
    bus = SilentBus()
    with Listener(lambda: bus) as listener:
        assert bus.waits.wait(GUARD_S)
        listener.send(FRAME)
        assert bus.sent == [FRAME]
        bus.over.set()
    listener.send(FRAME)
    assert bus.sent == [FRAME]
    assert bus.closed


def test_a_full_queue_drops_the_frame_alone() -> None:
    bus = SilentBus()
    with Listener(lambda: bus) as listener:
        bus.refusal = QueueFullError("full")
        listener.send(FRAME)
        bus.refusal = None
        listener.send(FRAME)
        bus.over.set()
    assert (bus.sent, listener.lost) == ([FRAME], "")


def test_a_bus_that_fails_to_send_is_lost_and_opened_again() -> None:
    buses = [SilentBus(), SilentBus()]
    waiting = list(buses)
    for bus in buses:
        bus.over.set()
    buses[0].refusal = BusError("unplugged")
    with Listener(lambda: waiting.pop(0)) as listener:
        listener.send(FRAME)

        def sent_again() -> list[Frame]:
            listener.send(FRAME)
            return buses[1].sent

        until(sent_again)
        assert buses[0].closed
        assert listener.lost == ""
