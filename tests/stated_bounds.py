"""The bounds of a number, as the message that refuses it states them."""

import math
from collections.abc import Callable
from typing import Any

import pytest


def bounds_of(name: str, make: Callable[[float], Any]) -> list[float]:
    """Return the bounds that making something with NaN for a number is refused with."""
    with pytest.raises(ValueError, match=rf"^{name} nan is outside ") as refusal:
        make(math.nan)
    return [float(bound) for bound in str(refusal.value).rsplit(" ", 1)[1].split("..")]
