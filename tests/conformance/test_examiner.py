"""The examiner on a bus that is not always ready for a frame."""

from pathlib import Path

import pytest

from smarttac_can.conformance.description import DeviceDescription
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import QueueFullError

RICH = (Path(__file__).parents[1] / "eds" / "rich.eds").read_text()


class Queue:
    def __init__(self, full_for: int) -> None:
        self.left = full_for
        self.tries = 0
        self.sent: list[Frame] = []

    def send(self, frame: Frame) -> None:
        self.tries += 1
        if self.tries <= self.left:
            raise QueueFullError("no buffer space available")
        self.sent.append(frame)

    def receive(self, timeout: float) -> Frame | None:
        raise AssertionError("what comes meanwhile is still to be heard")


def test_a_full_queue_is_waited_for() -> None:
    queue = Queue(full_for=3)
    Examiner(queue, DeviceDescription(RICH, 5)).send(0x605, b"\x40")
    assert queue.sent == [Frame(0x605, b"\x40")]


def test_a_queue_that_stays_full_is_an_error_after_the_time_out() -> None:
    now = [0.0]

    def clock() -> float:
        now[0] += 0.1
        return now[0]

    queue = Queue(full_for=1000)
    with pytest.raises(QueueFullError):
        Examiner(queue, DeviceDescription(RICH, 5), timeout=0.5, clock=clock).send(0x605, b"\x40")
    assert 2 < queue.tries < 10
    assert queue.sent == []
