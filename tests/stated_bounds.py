"""Objects made with a number at each of its bounds, as the message of its refusal states them."""

import math
from collections.abc import Callable, Iterator
from typing import TypeVar

import pytest

Made = TypeVar("Made")


def made_at_bounds(name: str, make: Callable[[float], Made]) -> Iterator[Made]:
    """Give the objects of a number just within each bound; one just beyond it is refused."""
    with pytest.raises(ValueError, match=rf"^{name} nan is outside ") as refusal:
        make(math.nan)
    low, high = map(float, str(refusal.value).rsplit(" ", 1)[1].split(".."))
    for bound, outward in ((low, -1.0), (high, 1.0)):
        # As it is stated a bound is rounded to six digits.
        margin = 1e-5 * abs(bound)
        with pytest.raises(ValueError, match=rf"^{name} .* is outside"):
            make(bound + outward * (margin or 1e-9))
        yield make(bound - outward * margin)
