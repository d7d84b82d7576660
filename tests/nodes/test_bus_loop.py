"""The loop over the bus without a node: what is answered, and until when."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from line import packed
from one_watch import Present

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.device.port import Clock
from smarttac_can.nodes.bus_loop import BusLoop
from smarttac_can.nodes.loop_frames import MEASUREMENT_RPDOS, received_measurement
from smarttac_can.nodes.loop_time import Deadline

FIRST, SECOND, LAST = 5, 6, 7


class Loop:
    """A loop whose measurements are due within 3 ms, and how often they were not answered."""

    def __init__(self) -> None:
        self.od = stimulator_od()
        self.clock = Clock()
        self.faults = Present()
        self.unanswered = 0
        self.deadlines = [self.od.entry(index, 5) for index in (0x1404, 0x1405, 0x1406)]
        for entry in self.deadlines:
            entry.value = 3
        self.deadline = Deadline(self.od, MEASUREMENT_RPDOS)
        self.loop = BusLoop(
            self.od, self.clock, self.deadline, self.faults.observe, self._unanswered
        )
        data = packed(received_measurement(stimulator_od()))
        self.parts = {FIRST: data[:8], SECOND: data[8:16], LAST: data[16:]}

    def _unanswered(self) -> None:
        self.unanswered += 1

    def sync(self) -> None:
        device: Any = SimpleNamespace(sync=SimpleNamespace(own=False, produces=False, counter=0))
        self.loop.sync(device)

    def take(self, *rpdos: int) -> list[bool]:
        return [self.loop.take(rpdo, self.parts[rpdo]) for rpdo in rpdos]

    def answer(self) -> None:
        """Have a measurement answered."""
        self.sync()
        assert self.take(FIRST, SECOND, LAST)[-1]
        self.loop.answer()

    def write(self, at: int, milliseconds: int) -> None:
        """Write a deadline."""
        self.loop.on_write(self.deadlines[at], milliseconds)
        self.deadlines[at].value = milliseconds
        self.deadline.configure()

    def over_after(self) -> int:
        """Milliseconds until the deadline is over."""
        begun = self.clock.now
        while not self.unanswered:
            self.clock.advance(1000)
        return (self.clock.now - begun) // 1000


def test_what_completes_a_measurement_is_answered() -> None:
    loop = Loop()
    loop.sync()
    assert loop.take(FIRST, SECOND, LAST) == [False, False, True]
    assert loop.take(LAST) == [False], "there is nothing before it"


def test_a_measurement_without_a_sync_is_not_answered() -> None:
    loop = Loop()
    assert loop.take(FIRST, SECOND, LAST) == [False, False, False]
    assert loop.od["Cycle.Surplus measurements"].value == 1


@pytest.mark.parametrize(
    ("writes", "ms"),
    [
        ([(0, 5)], 3),
        ([(1, 2)], 2),
        ([(0, 5), (1, 6), (2, 7)], 5),
        ([(2, 7), (1, 6), (0, 5)], 5),
        ([(0, 5), (1, 6), (2, 7), (0, 9)], 6),
    ],
)
def test_the_shortest_of_the_deadlines_holds_from_its_write_on(
    writes: list[tuple[int, int]], ms: int
) -> None:
    loop = Loop()
    loop.answer()
    for write in writes:
        loop.write(*write)
    assert loop.over_after() == ms


def test_a_write_to_anything_else_leaves_the_deadline() -> None:
    loop = Loop()
    loop.answer()
    loop.loop.on_write(loop.od["Setpoint.Amplitude"], 1)
    assert loop.over_after() == 3


def test_who_comes_late_finds_it_over_from_the_deadline_on() -> None:
    loop = Loop()
    loop.answer()
    loop.clock.now += 2999
    loop.loop.overdue()
    assert loop.unanswered == 0
    loop.clock.now += 1
    loop.loop.overdue()
    assert loop.unanswered == 1
    loop.loop.overdue()
    assert loop.unanswered == 1
