"""The examiner on a bus that is not always ready for a frame."""

from collections import deque
from contextlib import closing

import pytest
from read_once import read_once
from rich_eds import RICH

from smarttac_can.canopen.bus.bus import QueueFullError
from smarttac_can.canopen.conformance.case import DeviceDescription, Failure
from smarttac_can.canopen.conformance.examiner import Examiner
from smarttac_can.canopen.conformance.run import CASES, DeviceTimeBus, run_cases
from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.instrument.nodes.device_node import DeviceNode


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


class LoadedSystem:
    """A device that answers at once, and an examiner whose process then rests for a while.

    It rests between saying how long it waits and looking for the first time.
    """

    def __init__(self, rest: float) -> None:
        self._bus = DeviceTimeBus(DeviceNode(Device(read_once(RICH, 5))))
        self._rest = rest
        self._calls = 0
        self._lost = 0.0
        self.receive = self._bus.receive
        self.close = self._bus.close

    def send(self, frame: Frame) -> None:
        self._bus.send(frame)
        self._calls = 0

    def clock(self) -> float:
        self._calls += 1
        if self._calls == 2:
            self._lost += self._rest
        return self._bus.time() + self._lost


@pytest.mark.parametrize("rest", [0.0, 0.2, 0.5, 1.0, 60.0])
def test_no_rest_of_the_examiner_makes_a_case_fail(rest: float) -> None:
    cases = [case for case in CASES if case.number in ("SDO-01", "SDO-12", "SDO-16", "HB-01")]
    system = LoadedSystem(rest)
    with closing(system):
        examiner = Examiner(system, DeviceDescription(RICH, 5), timeout=0.3, clock=system.clock)
        results = run_cases(examiner, cases)
    assert [(r.case.number, r.verdict, r.reason) for r in results] == [
        (case.number, "pass", "") for case in cases
    ]


def test_examiner_finds_its_answer_behind_queued_frames() -> None:
    now = [0.0]
    waiting = deque([Frame(0x705, b"\x05")] * 50 + [Frame(0x585, bytes(8))])

    class Bus(Queue):
        def receive(self, timeout: float) -> Frame | None:
            return waiting.popleft() if waiting else None

    def clock() -> float:
        before = now[0]
        now[0] += 0.001 if before else 2.0
        return before

    examiner = Examiner(Bus(0), DeviceDescription(RICH, 5), timeout=0.3, clock=clock)
    assert examiner.expect(0x585, "SDO response") == Frame(0x585, bytes(8))


def test_a_bus_whose_frames_never_end_holds_nobody_up() -> None:
    now = [0.0]

    class Bus(Queue):
        def receive(self, timeout: float) -> Frame | None:
            return Frame(0x705, b"\x05")

    def clock() -> float:
        now[0] += 0.001
        return now[0]

    examiner = Examiner(Bus(0), DeviceDescription(RICH, 5), timeout=0.3, clock=clock)
    with pytest.raises(Failure, match="no SDO response"):
        examiner.expect(0x585, "SDO response")
    assert now[0] < 1.0
