"""How many SYNCs in a window are right, counted by the clock."""

import pytest
from one_watch import Present

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.canopen.device.port import Clock
from smarttac_can.instrument.nodes.bus_loop import SyncWatch
from smarttac_can.instrument.nodes.loop_time import Deadline, set_deadline
from smarttac_can.vocabulary.signals import MEASUREMENT_RPDOS
from smarttac_can.vocabulary.watchdogs import Watchdog


class Watch:
    """A watch with a deadline of 3 ms and counters up to 10, and its trips."""

    def __init__(self, deadline_ms: int = 3) -> None:
        self.clock = Clock()
        self.tripped = Present()
        self.peak = 0.0
        od = stimulator_od()
        od.entry(0x1019).value = 10
        set_deadline(od, MEASUREMENT_RPDOS, deadline_ms)
        self.sync = SyncWatch(od, self.clock, Deadline(od, MEASUREMENT_RPDOS), self.tripped.observe)

    def hear(self, milliseconds: int, syncs: list[int]) -> None:
        """Let time pass, with so many SYNCs at the end of each millisecond."""
        for at in range(milliseconds):
            for _ in range(syncs[at % len(syncs)]):
                self.sync.heard(0)
            self.peak = max(self.peak, self.sync.levels(1000)[1])
            self.clock.advance(1000)


@pytest.mark.parametrize(
    ("syncs", "irregular"),
    [
        # Windows of 8 ms, with 6 to 10 SYNCs.
        ([1], False),
        ([1, 1, 1, 2, 1, 1, 2, 1], False),
        ([1, 1, 1, 2, 1, 2, 2, 1], True),
        ([1, 1, 0, 1, 1, 0, 1, 1], False),
        ([1, 1, 0, 1, 0, 1, 0, 1], True),
    ],
)
def test_two_too_many_or_too_few_in_8_ms_pass_and_three_do_not(
    syncs: list[int], irregular: bool
) -> None:
    watch = Watch()
    watch.hear(32, syncs)
    assert (Watchdog.SYNC_IRREGULAR in watch.tripped) == irregular
    assert Watchdog.SYNC_LOST not in watch.tripped


@pytest.mark.parametrize(
    ("syncs", "level"),
    [
        ([1] * 100, 0.0),
        ([*[1] * 50, 2, *[1] * 49], 1 / 3),
        ([*[1] * 50, 2, 2, *[1] * 48], 2 / 3),
        # 13 or 12 in a window of 1000.
        ([*[1] * 79, 2] * 31, 13 / 14),
    ],
)
def test_sync_level_rises_with_surplus_in_either_window(syncs: list[int], level: float) -> None:
    watch = Watch()
    watch.hear(len(syncs), syncs)
    assert watch.peak == pytest.approx(level)
    assert not watch.tripped


def test_the_eleventh_at_once_is_irregular_though_no_time_passes() -> None:
    watch = Watch()
    watch.hear(1, [10])
    assert not watch.tripped
    watch.sync.heard(0)
    assert watch.tripped == {Watchdog.SYNC_IRREGULAR}


def test_no_sync_for_the_deadline_is_lost() -> None:
    watch = Watch()
    assert watch.sync.levels(1000) == (0.0, 0.0)
    watch.sync.heard(0)
    watch.clock.advance(2999)
    assert not watch.tripped
    watch.clock.advance(1)
    assert watch.tripped == {Watchdog.SYNC_LOST}
    watch.sync.heard(0)
    assert not watch.tripped


@pytest.mark.parametrize(
    ("deadline_ms", "period_us", "drifts"),
    [
        *((3, us, drifts) for us, drifts in
          ((800, True), (985, True), (990, False), (1012, False), (1016, True))),
        *((20, us, drifts) for us, drifts in
          ((800, True), (965, True), (973, False), (1030, False), (1034, True))),
    ],
)  # fmt: skip
def test_sync_drift_allows_1_percent_and_a_deadline(
    deadline_ms: int, period_us: int, drifts: bool
) -> None:
    watch = Watch(deadline_ms)
    for _ in range(2_500_000 // period_us):
        watch.clock.advance(period_us)
        watch.sync.heard(0)
    assert (Watchdog.SYNC_IRREGULAR in watch.tripped) == drifts


def test_a_pause_within_the_deadline_is_no_drift() -> None:
    watch = Watch(20)
    for _ in range(3):
        watch.hear(985, [1])
        watch.hear(15, [0])
        for _ in range(15):
            watch.sync.heard(0)
    watch.hear(1000, [1])
    assert not watch.tripped


def test_a_sync_that_is_lost_at_times_is_no_drift() -> None:
    """Two of 40 are missing: lost, and more than 1 % of a second."""
    watch = Watch()
    watch.hear(2500, [1, 0, 0, *[1] * 37])
    watch.clock.advance(3000)
    assert watch.tripped == {Watchdog.SYNC_LOST}


@pytest.mark.parametrize(
    ("counters", "jumps"),
    [
        ([3, 4, 5], False),
        ([9, 10, 1], False),
        ([3, 5], True),
        ([3, 3], True),
        ([10, 2], True),
        # One that has none says nothing of the next.
        ([3, 0, 7], False),
    ],
)
def test_a_counter_that_jumps(counters: list[int], jumps: bool) -> None:
    watch = Watch()
    for counter in counters:
        watch.sync.heard(counter)
        watch.clock.advance(1000)
    assert watch.tripped == ({Watchdog.SYNC_COUNTER} if jumps else set())
