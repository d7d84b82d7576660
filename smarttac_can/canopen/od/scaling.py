"""Convert quantities in SI units to the integers of the object dictionary."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from smarttac_can.canopen.od.entry import Entry


class Quantiser:
    """A group of integer entries that are written together, once per cycle.

    It converts each like `Entry.quantise`, in half the time.

    Parameters
    ----------
    entries
        Entries of integer types.
    """

    __slots__ = ("_rows",)

    def __init__(self, entries: Sequence[Entry]) -> None:
        self._rows = [
            (position, entry, entry.si, int(entry.low), int(entry.high))
            for position, entry in enumerate(entries)
        ]

    def write(self, values: Sequence[float]) -> None:
        """Write finite quantities in SI base units, rounded half to even, clipped to the limits."""
        for position, entry, si, low, high in self._rows:
            raw = round(values[position] / si)
            entry.value = raw if low <= raw <= high else low if raw < low else high


class QuantisedOnDemand:
    """A group of integer entries that are converted only when they are read.

    The values are those that a `Quantiser` would have written for the last row. A row is immutable,
    so the time of reading does not matter.

    Parameters
    ----------
    entries
        Entries of integer types; their values are computed from now on.

    Attributes
    ----------
    row
        Finite quantities in SI base units, in the order of the entries.
    """

    __slots__ = ("_defaults", "row")

    def __init__(self, entries: Sequence[Entry]) -> None:
        self._defaults = tuple([entry.default * entry.si for entry in entries])
        self.reset()
        for position, entry in enumerate(entries):
            entry.compute(self._reader(position, entry))

    def reset(self) -> None:
        """Set the row to the defaults of the entries."""
        self.row: tuple[float, ...] = self._defaults

    def _reader(self, position: int, entry: Entry) -> Callable[[], int]:
        si, low, high = entry.si, int(entry.low), int(entry.high)

        def read() -> int:
            raw = round(self.row[position] / si)
            return raw if low <= raw <= high else low if raw < low else high

        return read
