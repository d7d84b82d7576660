"""Faulty cycles in a row, and those that come again and again."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttac_can.nodes.watches import full_bucket, leaked


class Bucket:
    """A leaky bucket."""

    def __init__(self) -> None:
        self.level = 0

    def count(self, faulty: bool, most: int) -> bool:
        """Take a cycle, and tell whether there is a fault."""
        self.level = leaked(self.level, full_bucket(most), faulty)
        return self.level >= full_bucket(most)


def cycles_until_fault(pattern: list[bool], most: int, repeats: int = 1000) -> int | None:
    bucket = Bucket()
    for at, faulty in enumerate(pattern * repeats, 1):
        if bucket.count(faulty, most):
            return at
    return None


@pytest.mark.parametrize("most", [1, 2, 5, 10])
def test_so_many_in_a_row_are_a_fault_and_one_less_is_none(most: int) -> None:
    assert cycles_until_fault([True], most) == most
    assert cycles_until_fault([True] * (most - 1) + [False] * 20 * most, most) is None


@pytest.mark.parametrize(("sound", "at"), [(1, 11), (2, 16), (5, 37), (19, 1601)])
def test_a_fault_that_comes_again_and_again_is_one(sound: int, at: int) -> None:
    assert cycles_until_fault([True] + [False] * sound, 5) == at


def test_one_in_twenty_one_cycles_is_forgotten() -> None:
    assert cycles_until_fault([True] + [False] * 20, 2) is None


@given(st.lists(st.booleans(), max_size=400), st.integers(1, 10))
def test_what_never_trips_is_rare_in_every_window(pattern: list[bool], most: int) -> None:
    bucket = Bucket()
    quiet: list[bool] = []
    for faulty in pattern:
        if bucket.count(faulty, most):
            quiet.clear()
            continue
        quiet.append(faulty)
        for begin in range(len(quiet)):
            window = quiet[begin:]
            assert sum(window) < (20 * most + len(window)) / 21


@given(st.lists(st.booleans(), max_size=60), st.integers(1, 10))
def test_a_fault_that_is_gone_is_forgotten_within_21_sound_cycles(
    pattern: list[bool], most: int
) -> None:
    bucket = Bucket()
    for faulty in pattern:
        bucket.count(faulty, most)
    assert not any([bucket.count(False, most) for _ in range(40)][20:])
