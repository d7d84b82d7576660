"""Ticks of recorded rows: extended beyond the 16 bits of the bus, and parted where they restart."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.traces import Integers

_WRAP: Final = 1 << 16
_FEW: Final = 100
"""Ticks that may be missing where a run goes on; one that begins anew is farther off."""
_AHEAD_MS: Final = 1000
"""Ticks follow the clock, and their frames are taken within this time."""
_AMBIGUOUS_MS: Final = 60_000
"""The 16 bits of the tick come round after 65.5 s."""

Flags = npt.NDArray[np.bool_]


class Counted(NamedTuple):
    """Ticks of rows; arrays of equal length."""

    run: Integers
    """Number of the run of ticks, from 0."""
    tick: Integers
    """Tick in ms; rises within a run."""
    origin: Integers
    """Tick with which the run began."""
    follows: Flags
    """Whether no tick is missing before it."""
    new: Flags
    """Whether it is not the tick of the row before once more."""


class TickCount:
    """Counts the ticks of rows that are given piece by piece.

    Parameters
    ----------
    clocked
        Whether ticks follow the clock.
    """

    def __init__(self, clocked: bool) -> None:
        self._clocked = clocked
        # Of the last row: tick on the bus, time in ns, run, tick, and where the run began.
        self._last = (0, 0, -1, -1, -1)

    def count(self, wire: Integers, time_ns: Integers, restarted: Flags) -> Counted:
        """Count the next rows.

        Parameters
        ----------
        wire
            Their ticks, modulo 2^16.
        time_ns
            When they came.
        restarted
            Whether a node, or the simulation, has said before a row that it begins anew.
        """
        delta, anew = self._steps(wire, time_ns, restarted)
        steps = np.cumsum(np.where(anew, 0, delta))
        begun = np.maximum.accumulate(np.where(anew, np.arange(len(anew)), -1))
        # Before the first that begins anew the last run goes on.
        _, _, run, tick, origin = self._last
        ticks = np.where(begun < 0, tick + steps, wire[begun] + steps - steps[begun])
        counted = Counted(
            run=run + np.cumsum(anew),
            tick=ticks,
            origin=np.where(begun < 0, origin, wire[begun]),
            follows=anew | (delta <= 1),
            new=anew | (delta > 0),
        )
        if len(wire):
            last = (wire, time_ns, counted.run, counted.tick, counted.origin)
            self._last = tuple(int(column[-1]) for column in last)  # type: ignore[assignment]
        return counted

    def _steps(self, wire: Integers, time_ns: Integers, restarted: Flags) -> tuple[Integers, Flags]:
        """Return by how many ticks each row is further than the one before, or begins anew."""
        delta = np.diff(wire, prepend=self._last[0]) % _WRAP
        elapsed = np.diff(time_ns, prepend=self._last[1]) // 1_000_000
        back = delta > _WRAP // 2
        if self._clocked:
            rounds = np.rint((elapsed - delta) / _WRAP).astype(np.int64)
            delta += _WRAP * np.where(elapsed > _AMBIGUOUS_MS, rounds.clip(0), 0)
            back &= delta - elapsed > _AHEAD_MS
        anew = back | restarted & ((delta == 0) | (delta > _FEW))
        if len(anew) and self._last[2] < 0:
            anew[0] = True
        return delta, anew
