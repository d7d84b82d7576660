"""Measurements against SYNCs, counted by the clock: the deadline is 3 ms, a window 8 SYNCs."""

from __future__ import annotations

import pytest
from one_watch import Present

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.device.port import Clock
from smarttac_can.nodes.bus_loop import SourceWatch
from smarttac_can.nodes.loop_frames import MEASUREMENT_RPDOS
from smarttac_can.nodes.loop_time import Deadline, set_deadline
from smarttac_can.vocabulary.watchdogs import Watchdog

THIRD = pytest.approx(1 / 3, rel=1e-12)
"""The level of one strange measurement: two are none of a fault, three are."""


class Watch:
    """A watch, and whether it sees another source."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.tripped = Present()
        self.od = stimulator_od()
        set_deadline(self.od, MEASUREMENT_RPDOS, 3)
        self.source = SourceWatch(
            self.od, self.clock, Deadline(self.od, MEASUREMENT_RPDOS), self.tripped.observe
        )

    def sync(self, count: int = 1, *, answers: int = 0, us: int = 1000) -> None:
        """Let time pass to a SYNC, so many times, and have so many measurements after each."""
        for _ in range(count):
            self.clock.advance(us)
            self.source.sync()
            self.answers(answers)

    def answers(self, count: int) -> list[bool]:
        return [self.source.may_answer() for _ in range(count)]

    @property
    def level(self) -> float:
        return self.source.level

    @property
    def surplus(self) -> int:
        return int(self.od["Cycle.Surplus measurements"].value)

    @property
    def double(self) -> bool:
        return Watchdog.DOUBLE in self.tripped


def test_without_a_sync_none_is_answered() -> None:
    watch = Watch()
    assert watch.level == 0.0
    assert watch.answers(1) == [False]
    assert (watch.surplus, watch.level) == (1, THIRD)


def test_after_a_sync_one_is_answered_and_one_ahead() -> None:
    watch = Watch()
    watch.sync()
    assert watch.answers(3) == [True, True, False]
    assert (watch.surplus, watch.level) == (1, THIRD)
    watch.sync()
    assert watch.answers(2) == [True, False], "the one ahead was that of this SYNC"


def test_of_those_that_waited_as_many_as_the_deadline_are_answered_and_none_is_strange() -> None:
    watch = Watch()
    watch.sync(10)
    assert watch.answers(10) == [True] * 4 + [False] * 6
    assert (watch.surplus, watch.level) == (6, 0.0)
    assert watch.answers(1) == [False]
    assert (watch.surplus, watch.level) == (7, THIRD)


def test_those_of_a_second_may_have_waited() -> None:
    watch = Watch()
    watch.sync(1200)
    watch.answers(1000)
    assert watch.level == 0.0
    watch.answers(1)
    assert watch.level == THIRD


def settled() -> Watch:
    """Return a watch after a window in which each SYNC had its measurement, but for the last."""
    watch = Watch()
    watch.sync(6)
    watch.sync(9, answers=1)
    watch.sync()
    return watch


def test_a_window_with_a_measurement_a_sync_says_that_none_waits_any_more() -> None:
    watch = settled()
    watch.sync(6)
    watch.answers(6)
    assert watch.level == 0.0
    watch.answers(1)
    assert watch.level == THIRD


def test_after_such_a_window_no_answer_is_left_for_what_never_came() -> None:
    assert settled().answers(3) == [True, True, False], "that of the last SYNC, and one ahead"


def test_a_window_that_lacks_some_says_nothing() -> None:
    watch = Watch()
    watch.sync(7)
    watch.sync(answers=1)
    watch.answers(7)
    assert watch.level == 0.0


def test_two_strange_ones_in_a_window_pass_and_three_do_not() -> None:
    watch = Watch()
    watch.sync(answers=1)
    for _ in range(2):
        watch.source.unexpected()
    watch.sync(answers=1)
    assert not watch.double
    assert watch.level == pytest.approx(2 / 3, rel=1e-12)
    watch.sync(5, answers=1)
    watch.source.unexpected()
    assert not watch.double, "it is the next SYNC that tells"
    watch.sync()
    assert watch.double


def test_after_8_syncs_strange_ones_are_forgotten() -> None:
    watch = Watch()
    watch.sync(7, answers=1)
    watch.source.unexpected()
    watch.source.unexpected()
    watch.sync(answers=1)
    assert watch.level == 0.0
    watch.source.unexpected()
    watch.sync(answers=1)
    assert not watch.double


@pytest.mark.parametrize(("us", "level"), [(3000, 2 / 3), (3001, 0.0)])
def test_what_came_while_sync_was_lost_is_forgotten(us: int, level: float) -> None:
    watch = Watch()
    watch.sync(answers=1)
    watch.source.unexpected()
    watch.source.unexpected()
    watch.sync(us=us)
    assert watch.level == pytest.approx(level, rel=1e-12)


def test_it_is_over_3_s_after_the_plate_has_told() -> None:
    watch = Watch()
    watch.source.plate_reports_another()
    watch.clock.advance(2_999_999)
    assert watch.double
    watch.source.collide(False)
    assert watch.double, "there is no frame of its own, but there was one of the plate"
    watch.clock.advance(1)
    assert not watch.double


def test_a_collision_lasts_until_it_is_no_more() -> None:
    watch = Watch()
    watch.source.collide(True)
    assert watch.double
    watch.source.plate_reports_another()
    watch.clock.advance(3_000_000)
    assert watch.double
    watch.source.collide(False)
    assert not watch.double


def test_what_was_noticed_is_forgotten_by_a_reset() -> None:
    watch = Watch()
    watch.source.collide(True)
    watch.source.plate_reports_another()
    watch.source.forget()
    assert not watch.double
    watch.source.plate_reports_another()
    watch.clock.advance(3_000_000)
    assert not watch.double
