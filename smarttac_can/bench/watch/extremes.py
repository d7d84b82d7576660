"""The least and greatest values of objects, which a look at the last value would miss."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Final

from smarttac_can.canopen.od.dictionary import ObjectDictionary

_STEPS: Final = 200
"""Steps that are kept: those of 2 s at least."""


class Extremes:
    """Least and greatest values of objects, in steps.

    Parameters
    ----------
    od
        Object dictionary of the objects.
    units
        Units of the extremes by the name of the object; other objects are ignored.
    """

    def __init__(self, od: ObjectDictionary, units: Mapping[str, str]) -> None:
        self._sizes = {name: od[name].unit.in_unit(unit) for name, unit in units.items()}
        self._present: dict[str, tuple[int, int]] = {}
        self._steps: deque[tuple[float, Mapping[str, tuple[int, int]]]] = deque(maxlen=_STEPS)

    def take(self, name: str, values: Iterable[int]) -> None:
        """Add raw values of an object to the present step."""
        if name not in self._sizes:
            return
        # The COF is 0 where there is none.
        known = [raw for raw in values if raw or "COF" not in name]
        if known:
            _widen(self._present, name, min(known), max(known))

    def end_step(self, began: float) -> None:
        """End the present step, which began at a time in s; the next one begins."""
        self._steps.append((began, self._present))
        self._present = {}

    def since(self, time: float) -> dict[str, tuple[float, float]]:
        """Return the extremes of ended steps that began after a time in s; safe in any thread."""
        merged: dict[str, tuple[int, int]] = {}
        for began, step in reversed(self._steps.copy()):
            if began <= time:
                break
            for name, (low, high) in step.items():
                _widen(merged, name, low, high)
        return {
            name: (low * self._sizes[name], high * self._sizes[name])
            for name, (low, high) in merged.items()
        }


def _widen(extremes: dict[str, tuple[int, int]], name: str, low: int, high: int) -> None:
    known_low, known_high = extremes.get(name, (low, high))
    extremes[name] = min(low, known_low), max(high, known_high)
