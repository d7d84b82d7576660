"""The loop over the bus without a node: which measurement is answered, and until when.

The deadline is 3 ms, and a window of the watch over its source 8 SYNCs.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from line import packed
from one_watch import Present

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.canopen.device.port import Clock
from smarttac_can.instrument.nodes.bus_loop import BusLoop, Pairing, SourceWatch
from smarttac_can.instrument.nodes.loop_frames import received_measurement
from smarttac_can.instrument.nodes.loop_time import Deadline, set_deadline
from smarttac_can.vocabulary.signals import MEASUREMENT_RPDOS
from smarttac_can.vocabulary.watchdogs import Watchdog

FIRST, SECOND, LAST = 5, 6, 7


def parted(measurement: bytes) -> dict[int, bytes]:
    return {FIRST: measurement[:8], SECOND: measurement[8:16], LAST: measurement[16:]}


# The measurement PDOs of a tick, one by one: a complete measurement, and the counts.


class Pair:
    """A pairing, and how often it said that measurements are unusable, or foreign."""

    def __init__(self) -> None:
        self.od = stimulator_od()
        self.unusable = self.foreign = 0
        self.pairing = Pairing(self.od, self._unusable, self._foreign)
        self._sent = received_measurement(stimulator_od())

    def _unusable(self) -> None:
        self.unusable += 1

    def _foreign(self) -> None:
        self.foreign += 1

    def take(self, *rpdos: int, data: bytes | None = None) -> list[bool]:
        """Take some of the three PDOs of a measurement, which is sound by default."""
        data = packed(self._sent) if data is None else data
        return [self.pairing.take(rpdo, parted(data)[rpdo]) for rpdo in rpdos]

    def whole(self, tick: int, session: int = 0, *, corrupt: bool = False) -> bool:
        """Whether all three of a tick are to be answered."""
        values = {"Tick": tick, "Gauge tick": (tick + session) & 0xFF}
        for entry in self._sent.entries:
            entry.value = values.get(entry.name.rpartition(".")[2], 0)
        data = packed(self._sent)
        if corrupt:
            data = bytes((data[0] ^ 1,)) + data[1:]
        first, second, whole = self.take(FIRST, SECOND, LAST, data=data)
        assert not (first or second)
        return whole

    def answered(self, tick: int, session: int = 0) -> bool:
        whole = self.whole(tick, session)
        if whole:
            self.pairing.answered()
        return whole

    @property
    def counted(self) -> tuple[int, ...]:
        """Lost cycles, corrupt measurements, foreign ticks."""
        names = ("Lost cycles", "Corrupt measurements", "Foreign ticks")
        return tuple(self.od[f"Cycle.{name}"].value for name in names)


def test_all_three_are_answered_and_nothing_is_counted() -> None:
    pair = Pair()
    assert (pair.pairing.level, pair.pairing.session) == (0.0, 0)
    for tick in (254, 255, 0, 1):
        assert pair.answered(tick)
        assert pair.pairing.level == 0.0
    assert (pair.counted, pair.unusable, pair.foreign) == ((0, 0, 0), 0, 0)


@pytest.mark.parametrize(
    "rpdos",
    [(FIRST, LAST), (SECOND, LAST), (LAST,), (FIRST, LAST, SECOND), (FIRST, SECOND, SECOND),
     (FIRST, SECOND, FIRST, LAST)],
)  # fmt: skip
def test_without_one_or_in_another_order_they_are_no_measurement(rpdos: tuple[int, ...]) -> None:
    pair = Pair()
    assert not any(pair.take(*rpdos))
    assert pair.answered(0)


def test_remainder_of_a_measurement_is_a_lost_cycle() -> None:
    pair = Pair()
    pair.take(FIRST, SECOND)
    assert pair.whole(0)
    assert pair.counted == (1, 0, 0)


def test_a_wrong_bit_is_counted_and_not_answered() -> None:
    pair = Pair()
    sound = packed(received_measurement(stimulator_od()))
    for bit in range(8 * len(sound)):
        wrong = int.from_bytes(sound, "little") ^ 1 << bit
        data = wrong.to_bytes(len(sound), "little")
        assert not any(pair.take(FIRST, SECOND, LAST, data=data)), f"bit {bit}"
    assert (pair.counted, pair.foreign) == ((0, 192, 0), 0)
    assert pair.answered(0)


def test_fourth_incomplete_measurement_in_a_row_is_reported() -> None:
    pair = Pair()
    for begun, level in enumerate((1 / 3, 2 / 3, 1.0), 1):
        pair.whole(begun, corrupt=True)
        assert pair.pairing.level == pytest.approx(level, rel=1e-12)
        assert pair.unusable == 0
    pair.take(FIRST)
    assert pair.unusable == 1


def test_one_that_is_good_begins_the_count_anew() -> None:
    pair = Pair()
    for at in range(12):
        assert pair.whole(at, corrupt=at % 3 != 2) == (at % 3 == 2)
    assert pair.unusable == 0


def test_no_tick_is_answered_twice_in_a_run() -> None:
    pair = Pair()
    assert pair.whole(7)
    assert pair.answered(7), "the first time it was not answered"
    assert not pair.whole(7)
    assert (pair.counted, pair.foreign) == ((0, 0, 1), 1)
    pair.pairing.start_run()
    assert pair.whole(7)


@pytest.mark.parametrize("session", [0, 9, 255])
def test_new_session_of_the_plate_is_believed_twice_in_a_row(session: int) -> None:
    pair = Pair()
    assert pair.answered(0, session)
    assert pair.pairing.session == session
    other, third = (session + 1) & 0xFF, (session + 2) & 0xFF
    assert not pair.answered(1, other)
    assert pair.answered(2, session)
    assert not pair.answered(3, other)
    assert not pair.answered(4, third)
    assert (pair.pairing.session, pair.foreign) == (session, 3)
    assert pair.answered(5, third)
    assert pair.pairing.session == third
    assert pair.counted == (0, 0, 3)


def test_after_a_reset_any_session_is_that_of_the_plate() -> None:
    pair = Pair()
    assert pair.answered(0, 9)
    pair.take(FIRST, SECOND)
    pair.pairing.forget()
    assert (pair.pairing.level, pair.pairing.session) == (0.0, 0)
    assert pair.answered(0, 17)
    assert (pair.pairing.session, pair.counted) == (17, (0, 0, 0))


# Measurements against SYNCs, counted by the clock.


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


def test_queued_measurements_are_answered_up_to_the_deadline() -> None:
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


def test_window_of_one_measurement_per_sync_leaves_none_waiting() -> None:
    watch = settled()
    watch.sync(6)
    watch.answers(6)
    assert watch.level == 0.0
    watch.answers(1)
    assert watch.level == THIRD


def test_window_of_one_measurement_per_sync_clears_owed_answers() -> None:
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
def test_surplus_measurements_while_sync_was_lost_are_forgotten(us: int, level: float) -> None:
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


def test_surplus_measurements_are_forgotten_by_a_reset() -> None:
    watch = Watch()
    watch.source.collide(True)
    watch.source.plate_reports_another()
    watch.source.forget()
    assert not watch.double
    watch.source.plate_reports_another()
    watch.clock.advance(3_000_000)
    assert not watch.double


# The loop.


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
        self.parts = parted(packed(received_measurement(stimulator_od())))

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


@pytest.mark.sources
def test_last_pdo_of_a_measurement_is_answered() -> None:
    loop = Loop()
    loop.sync()
    assert loop.take(FIRST, SECOND, LAST) == [False, False, True]
    assert loop.take(LAST) == [False], "there is nothing before it"


def test_a_measurement_without_a_sync_is_not_answered() -> None:
    loop = Loop()
    assert loop.take(FIRST, SECOND, LAST) == [False, False, False]
    assert loop.od["Cycle.Surplus measurements"].value == 1


@pytest.mark.sources
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


@pytest.mark.sources
def test_a_write_to_anything_else_leaves_the_deadline() -> None:
    loop = Loop()
    loop.answer()
    loop.loop.on_write(loop.od["Setpoint.Amplitude"], 1)
    assert loop.over_after() == 3


@pytest.mark.sources
def test_missing_measurement_is_seen_from_the_deadline_on() -> None:
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
