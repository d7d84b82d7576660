"""Answers behind the next SYNC, told from the ticks alone."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttac_can.instrument.nodes.bus_loop import LateAnswers

pytestmark = pytest.mark.sources


class Queue:
    """Ticks of a plate that hears all SYNCs but those told, and a stimulator that answers them."""

    def __init__(self, first: int = 0, before: int = 0, deadline_ms: int = 20) -> None:
        self.answers = LateAnswers(SimpleNamespace(ms=deadline_ms))  # type: ignore[arg-type]
        for _ in range(before):
            self.answers.sync()
        self.tick = first
        self.waiting: list[int] = []

    def period(self, answered: int, *, heard: bool = True) -> list[bool]:
        """Send a SYNC and answer so many measurements before the next; tell which were late."""
        self.answers.sync()
        if heard:
            self.waiting.append(self.tick)
            self.tick = self.tick + 1 & 0xFF
        now, self.waiting = self.waiting[:answered], self.waiting[answered:]
        return [self.answers.late(tick) for tick in now]

    def periods(self, count: int, *, heard: bool = True) -> list[bool]:
        return [late for _ in range(count) for late in self.period(99, heard=heard)]


@pytest.mark.parametrize(("first", "before"), [(0, 0), (0, 1), (7, 0), (200, 300), (255, 255)])
def test_no_answer_is_late_before_the_next_sync(first: int, before: int) -> None:
    queue = Queue(first, before)
    assert queue.periods(600) == [False] * 600
    assert queue.answers.summary() == ""


@pytest.mark.parametrize("behind", [1, 2, 18])
def test_an_answer_behind_the_next_sync_is_late(behind: int) -> None:
    queue = Queue()
    queue.periods(50)
    for _ in range(behind):
        assert queue.period(0) == []
    assert queue.period(99) == [True] * behind + [False]
    assert queue.answers.summary() == f"{behind} of the last 20 drives late"
    queue.periods(19 - behind)
    assert queue.answers.summary() == f"{behind} of the last 20 drives late"
    queue.periods(behind - 1)
    assert queue.answers.summary() == "1 of the last 20 drives late"
    queue.periods(1)
    assert queue.answers.summary() == ""


def test_one_behind_stays_late_until_it_has_caught_up() -> None:
    queue = Queue()
    queue.periods(5)
    assert queue.period(0) == []
    assert [queue.period(1) for _ in range(10)] == [[True]] * 10
    assert queue.period(2) == [True, False]


@pytest.mark.parametrize("deadline_ms", [3, 20, 100])
def test_sync_lost_by_the_plate_makes_answers_late_a_deadline(deadline_ms: int) -> None:
    queue = Queue(deadline_ms=deadline_ms)
    queue.periods(5)
    queue.period(99, heard=False)
    assert queue.periods(deadline_ms + 20) == [True] * deadline_ms + [False] * 20
    assert queue.period(0) == []
    assert queue.period(99) == [True, False], "and what is late then is"


def test_the_first_answer_may_have_been_late_itself() -> None:
    queue = Queue()
    queue.period(0)
    assert queue.period(1) == [False], "nobody knows yet"
    assert queue.period(2) == [False, False]
    assert queue.period(1) == [False], "two of them were earlier than that"
    assert queue.period(0) == []
    assert queue.period(2) == [True, False]


@pytest.mark.parametrize(
    ("answers", "late"), [([0, 2], [True, False]), ([0, 1, 2], [True, True, False])]
)
def test_loop_late_from_its_first_answer_is_detected(answers: list[int], late: list[bool]) -> None:
    queue = Queue()
    queue.period(0)
    told = [queue.period(1), queue.period(2)]
    told += [queue.period(answered) for _ in range(10) for answered in answers]
    assert told[:2] == [[False], [False, False]], "nobody knows yet"
    assert [late for period in told[2 + 2 * len(answers) :] for late in period] == late * 8


def test_each_second_late_answer_is_found_after_steady_lateness() -> None:
    queue = Queue()
    queue.periods(5)
    queue.period(0)
    assert [late for _ in range(21) for late in queue.period(1)] == [True] * 20 + [False]
    queue.period(99)
    late = [late for _ in range(10) for answered in (0, 2) for late in queue.period(answered)]
    assert late[4:] == [True, False] * 8


def test_a_new_least_is_a_new_beginning() -> None:
    queue = Queue(deadline_ms=5)
    queue.periods(5)
    for _ in range(2):
        queue.period(99, heard=False)
        assert queue.periods(6) == [True] * 5 + [False]
    assert not queue.answers.late(queue.tick), "one that overtakes its SYNC"
    queue.answers.sync()
    queue.tick += 1
    assert queue.periods(30) == [False] * 30


@pytest.mark.parametrize(("apart", "new_least"), [(30, False), (19, False), (18, True), (0, True)])
def test_measurement_before_its_sync_is_the_rule_at_two_of_20(apart: int, new_least: bool) -> None:
    queue = Queue()
    queue.periods(5)
    for between in (apart, 0):
        assert not queue.answers.late(queue.tick), "before its SYNC is heard"
        queue.answers.sync()
        queue.tick += 1
        assert queue.periods(between) == [False] * between
    assert queue.periods(30) == [new_least] * 20 + [False] * 10
    assert queue.period(0) == []
    assert queue.period(99) == [True, False]


def test_tick_half_the_count_behind_is_late_one_more_is_ahead() -> None:
    for behind, late in ((127, True), (128, False)):
        queue = Queue()
        queue.periods(5)
        assert queue.answers.late(queue.tick - 1 - behind & 0xFF) is late


def test_a_new_run_begins_anew() -> None:
    queue = Queue()
    queue.periods(5)
    queue.period(0)
    queue.period(1)
    queue.answers.restart()
    queue.tick, queue.waiting = 0, []
    assert queue.periods(3) == [False] * 3
    assert queue.answers.summary() == ""


@given(
    st.integers(0, 255),
    st.integers(0, 600),
    st.lists(st.integers(0, 4) | st.just(99), min_size=1, max_size=200),
)
def test_answer_after_the_next_sync_is_late(first: int, before: int, periods: list[int]) -> None:
    queue = Queue(first, before)
    queue.periods(3)
    in_a_row = 0
    for answered in periods:
        waiting = len(queue.waiting)
        for at, late in enumerate(queue.period(answered)):
            was = at < waiting
            in_a_row = in_a_row + 1 if was else 0
            # Constant lateness is taken for the rule, and the plate has ended the run by then.
            if in_a_row > 20 or len(queue.waiting) > 100:
                return
            assert late == was
