"""How long a thread has to rest, by times that are made up."""

from __future__ import annotations

import pytest

from smarttac_can.host.processor_share import ProcessorShare


class Thread:
    """Works and waits for as long as it is told to, in us."""

    def __init__(self, unit: int = 1) -> None:
        self.now = 0
        self.worked = 0
        self.unit = unit
        self.rests: list[float] = []
        self.share = ProcessorShare(
            lambda: 1000 * self.now, lambda: 1000 * (self.worked // unit * unit), self.rest
        )

    def rest(self, seconds: float) -> None:
        self.rests.append(seconds)
        self.now += round(seconds * 1e6)

    def work(self, us: int) -> int:
        self.now += us
        self.worked += us
        return self.share.owed()

    def wait(self, us: int, work: int = 0) -> int:
        self.now += us
        self.worked += work
        self.share.waited(1000 * us)
        return self.share.owed()


def test_half_a_millisecond_is_owed_after_8_ms_and_taken_after_10() -> None:
    thread = Thread()
    assert thread.work(8_000) == 0
    assert thread.work(1) == 500
    thread.work(1_999)
    thread.share.rest_if_owed()
    assert thread.rests == []
    thread.work(1)
    thread.share.rest_if_owed()
    assert thread.rests == [0.0005]
    thread.share.rest_if_owed()
    assert thread.rests == [0.0005], "it has rested"
    assert thread.work(8_000) == 0
    assert thread.work(1) == 500


def test_waits_count() -> None:
    thread = Thread()
    thread.wait(200)
    assert thread.work(11_000) == 300
    assert thread.wait(299) == 1
    assert thread.wait(1) == 0
    assert thread.work(8_000) == 0, "from then on anew"
    assert thread.work(1) == 500


def test_what_the_system_took_counts_neither_as_work_nor_as_wait() -> None:
    thread = Thread()
    for _ in range(7):
        thread.now += 5000
        assert thread.work(1000) == 0
    thread.now += 5000
    assert thread.work(1000) == 500


@pytest.mark.parametrize("taken", [0, 50, 200, 450])
def test_a_wait_that_was_work_is_none_though_the_system_took_some_of_it(taken: int) -> None:
    thread = Thread()
    for _ in range(1000):
        thread.wait(1000, work=1000 - taken)
        thread.share.rest_if_owed()
    assert len(thread.rests) >= 40


@pytest.mark.parametrize("unit", [1000, 10_000, 15_625, 64_000])
def test_a_coarse_unit_of_processor_time_owes_nothing_more(unit: int) -> None:
    thread = Thread(unit)
    owed = 0
    for _ in range(10_000):
        owed += thread.work(350)
        owed += thread.wait(650)
    assert owed == 0
