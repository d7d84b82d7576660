"""Samples of COF out of a recording, and the tables through them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.texture_files import Integers, read_columns
from smarttac_can.bench.texture_tables import (
    MOST_MM,
    Floats,
    cof_bounds,
    over_position,
    over_time,
)
from smarttac_can.vocabulary.textures import TextureTable

_CURE: Final = "; leave out rows where the finger turns, rests or hardly touches"


class Samples(NamedTuple):
    """COF at places, and where in its file each stands."""

    path: Path
    line: Integers
    place: Floats
    """Positions in mm, or times in s."""
    cof: Floats

    @classmethod
    def of_cof(cls, path: Path, place: str, cof: str) -> Samples:
        """Read columns of place and COF; raises as `read_columns`."""
        line, (places, values) = read_columns(path, (place, cof))
        return cls(path, line, places, values)

    @classmethod
    def of_forces(
        cls, path: Path, place: str, lateral: str, normal: str, least_force: float
    ) -> Samples:
        """Read columns of place and forces, where the normal force is `least_force` or more.

        Raises
        ------
        ValueError
            As `read_columns`, or if the normal force is nowhere so large.
        """
        line, (places, along, across) = read_columns(path, (place, lateral, normal))
        pressed = across >= max(least_force, 1e-9)
        if not pressed.any():
            raise ValueError(f"{path}: no normal force is {least_force:g} or more")
        cof = np.abs(along[pressed]) / across[pressed]
        return cls(path, line[pressed], places[pressed], cof)

    def over_position(self, step: float) -> TextureTable:
        """Return the table through the means of all samples near each multiple of a step in mm.

        Raises
        ------
        ValueError
            If a position, or a mean, cannot be played; names the line.
        """
        far = np.abs(self.place) > MOST_MM
        self._refuse(far, lambda k: f"position {self.place[k]:g} is outside ±{MOST_MM:g} mm")
        cells, which = np.unique(np.round(self.place / step), return_inverse=True)
        mean = np.bincount(which, self.cof) / np.bincount(which)
        self._refuse_cof(self._unplayable(self.cof) & self._unplayable(mean)[which])
        # The mean of what lies on a bound may lie beyond it by a rounding.
        return over_position(cells * step, np.clip(mean, *cof_bounds()))

    def over_time(self) -> TextureTable:
        """Return the table through all samples, in the order of their times.

        Raises
        ------
        ValueError
            If a COF cannot be played; names the line. If it is too long, or a single sample.
        """
        self._refuse_cof(self._unplayable(self.cof))
        order = np.argsort(self.place, kind="stable")
        times = self.place[order] - self.place[order][0]
        points = zip(times.tolist(), self.cof[order].tolist(), strict=True)
        try:
            return over_time(list(points), repeats=False)
        except ValueError as error:
            raise ValueError(f"{self.path}: {error}") from None

    @staticmethod
    def _unplayable(cof: Floats) -> npt.NDArray[np.bool_]:
        low, high = cof_bounds()
        return (cof < low) | (cof > high)

    def _refuse_cof(self, wrong: npt.NDArray[np.bool_]) -> None:
        low, high = cof_bounds()
        self._refuse(wrong, lambda k: f"COF {self.cof[k]:g} is outside {low:g}..{high:g}{_CURE}")

    def _refuse(self, wrong: npt.NDArray[np.bool_], why: Callable[[int], str]) -> None:
        if wrong.any():
            first = int(wrong.argmax())
            raise ValueError(f"{self.path}: line {self.line[first]}: {why(first)}")
