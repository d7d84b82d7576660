"""The newest faults, which a reset or a power cut does not take away."""

from __future__ import annotations

from typing import Final

from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.modes import Mode

_PLACES: Final = range(1, 9)
_SETPOINTS: Final = ("Voltage", "Frequency", "Amplitude", "COF left", "COF right")


class FaultMemory:
    """A line a fault, the newest first: its code, its cause, the mode and the set-points.

    It only tells. What is latched, and bars a run, is the supervisor's.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.

    Attributes
    ----------
    lines
        What is kept: a tuple, which another thread may read.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._places = [od[f"Fault memory.Fault {number}"] for number in _PLACES]
        self._mode = od["Mode"]
        self._setpoints = [od[f"Setpoint.{name}"] for name in _SETPOINTS]
        self.lines: tuple[str, ...] = ()

    def recall(self, lines: tuple[str, ...]) -> None:
        """Begin with lines that were kept elsewhere."""
        self.lines = lines[: len(self._places)]
        self.show()

    def show(self) -> None:
        """Put them into the object dictionary, after a reset of it, too."""
        for place in self._places:
            place.value = ""
        for place, line in zip(self._places, self.lines, strict=False):
            place.value = line

    def note(self, code: int, text: str, circumstances: str = "") -> None:
        """Keep a fault, with mode and set-points unless there is something else to say."""
        line = f"{code:04X}h {text}; {circumstances or self._asked()}"
        self.recall((line, *self.lines))

    def _asked(self) -> str:
        mode = Mode(self._mode.value).name.lower().replace("_", " ")
        return ", ".join([f"mode {mode}", *map(_shown, self._setpoints)])


def _shown(entry: Entry) -> str:
    name = entry.name.rpartition(".")[2]
    number = entry.value * float(entry.unit.number)
    return f"{name} {number:.10g} {entry.unit.symbol}".rstrip()
