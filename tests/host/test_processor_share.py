"""What is left of a processor, by times that are made up."""

from __future__ import annotations

import pytest

from smarttac_can.host.processor_share import ProcessorShare


class Thread:
    """Works and waits for as long as it is told to."""

    def __init__(self, unit: int = 1) -> None:
        self.now = 0
        self._worked = 0
        self._unit = unit
        self.share = ProcessorShare(self.now, self.worked)

    def worked(self) -> int:
        return 1000 * (self._worked // self._unit * self._unit)

    def work(self, us: int) -> int:
        self.now += us
        self._worked += us
        return self.share.owed(self.now)

    def wait(self, us: int) -> int:
        self.now += us
        return self.share.owed(self.now)


def test_nothing_is_owed_for_10_ms_of_work_and_then_half_a_millisecond_is() -> None:
    thread = Thread()
    assert thread.work(10_000) == 0
    assert thread.work(1) == 500


def test_waits_count() -> None:
    thread = Thread()
    thread.wait(200)
    assert thread.work(11_000) == 300
    assert thread.wait(299) == 1
    assert thread.wait(1) == 0
    assert thread.work(10_000) == 0, "from then on anew"
    assert thread.work(1) == 500


def test_what_the_system_took_counts() -> None:
    thread = Thread()
    thread.work(5_000)
    thread.wait(15_000)
    assert thread.work(5_000) == 0


@pytest.mark.parametrize("unit", [10_000, 15_625, 64_000])
def test_a_coarse_unit_owes_next_to_nothing(unit: int) -> None:
    thread = Thread(unit)
    owed = 0
    for _ in range(10_000):
        owed += thread.work(350)
        owed += thread.wait(650)
    assert owed <= 100_000, "of 10 s"
