"""The measurement PDOs of a tick, one by one: what completes a measurement, and what is counted."""

from __future__ import annotations

import pytest
from line import packed

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.nodes.bus_loop import Pairing
from smarttac_can.nodes.loop_frames import received_measurement

FIRST, SECOND, LAST = 5, 6, 7


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
        parts = {FIRST: data[:8], SECOND: data[8:16], LAST: data[16:]}
        return [self.pairing.take(rpdo, parts[rpdo]) for rpdo in rpdos]

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


def test_what_is_left_of_a_measurement_is_a_lost_cycle() -> None:
    pair = Pair()
    pair.take(FIRST, SECOND)
    assert pair.whole(0)
    assert pair.counted == (1, 0, 0)


def test_a_wrong_sum_is_counted_and_not_answered() -> None:
    pair = Pair()
    assert not pair.whole(0, corrupt=True)
    assert (pair.counted, pair.foreign) == ((0, 1, 0), 0)
    assert pair.answered(0)


def test_the_fourth_that_begins_after_three_that_were_no_good_says_so() -> None:
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
def test_another_session_is_that_of_the_plate_when_it_comes_twice_in_a_row(session: int) -> None:
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
