"""How near every watch came to a fault while nothing was broken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from smarttac_can.trials.fault_row import mode_name
from smarttac_can.trials.rig import Rig
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.watchdogs import COUNTED, PLATE_COUNTED

Table = dict[str, dict[str, float]]
"""Largest levels by watch and mode; 1.0 is a fault, or 0 V at the plate."""

NAMES: Final = (
    *(watchdog.name for watchdog in COUNTED),
    *(f"plate: {what}" for what in PLATE_COUNTED),
)
"""Watches of stimulator and plate, in the order of their levels."""
_DIGITS: Final = 3


class Margins:
    """The largest levels of a rig with a plate node, mode by mode.

    Parameters
    ----------
    rig
        Whose nodes are asked, over calls.
    """

    def __init__(self, rig: Rig) -> None:
        self._stimulator = rig.stimulator
        self._plate = rig.plate
        self._mode = rig.od["Mode"]
        self._run: dict[int, Sequence[float]] = {}
        self._kept: dict[int, Sequence[float]] = {}

    def look(self) -> None:
        """Look at a cycle in which nothing is broken."""
        levels = self._stimulator.levels() + self._plate.levels()
        mode = self._mode.value
        before = self._run.get(mode)
        self._run[mode] = levels if before is None else tuple(map(max, before, levels))

    def keep(self) -> None:
        """Keep what was seen since the last time."""
        for mode, levels in self._run.items():
            self._kept[mode] = list(map(max, self._kept.get(mode, levels), levels))
        self._run = {}

    def drop(self) -> None:
        """Forget what was seen since the last time: a watch did trip, and had cause to."""
        self._run = {}

    def table(self) -> Table:
        """Return what was kept."""
        return {
            name: {
                mode_name(Mode(mode)): round(levels[at], _DIGITS)
                for mode, levels in sorted(self._kept.items())
            }
            for at, name in enumerate(NAMES)
        }


def largest(tables: Sequence[Table]) -> Table:
    """Return the largest levels of several tables."""
    return {
        name: {
            mode_name(mode): max(levels)
            for mode in Mode
            if (levels := [t[name][mode_name(mode)] for t in tables if mode_name(mode) in t[name]])
        }
        for name in NAMES
    }
