"""Quantities in SI units on their way into the integers of the object dictionary."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from smarttac_can.od.dictionary import Entry


class Quantiser:
    """A row of integer entries that are written together, once a cycle.

    Does for each what `Entry.quantise` does for one, at half the cost.

    Parameters
    ----------
    entries
        Entries of integer types.
    """

    __slots__ = ("_rows",)

    def __init__(self, entries: Sequence[Entry]) -> None:
        self._rows = [(entry, entry.si, int(entry.low), int(entry.high)) for entry in entries]

    def write(self, values: Iterable[float]) -> None:
        """Write finite quantities in SI base units, rounded half to even, clipped to the limits."""
        for (entry, si, low, high), value in zip(self._rows, values, strict=True):
            raw = round(value / si)
            entry.value = low if raw < low else high if raw > high else raw
