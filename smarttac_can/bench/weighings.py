"""Known weights on a plate at known angles: what a calibration is made of."""

from __future__ import annotations

import csv
from io import TextIOWrapper
from math import cos, isfinite, radians, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from smarttac_can.host.files import in_words, open_regular

if TYPE_CHECKING:
    import _csv

STANDARD_GRAVITY: Final = 9.80665
"""In m/s^2."""
_RANGES: Final = {
    "mass_g": (1.0, 800.0),
    "angle_deg": (0.0, 60.0),
    "azimuth_deg": (-360.0, 360.0),
    "x_mm": (-38.0, 38.0),
}
_MOST_ROWS: Final = 100
_LONGEST_LINE: Final = 200


class Placing(NamedTuple):
    """Where a weight is to be put, and how the plate is to be tilted.

    As a text it says what to do: ``put 200 g at -20 mm``.
    """

    mass_g: float
    angle_deg: float
    """Of the plate from level."""
    azimuth_deg: float
    """Direction in which it falls: 0 along x, 90 along y."""
    x_mm: float
    """Position of the weight from the middle; counts where the plate is level."""

    @property
    def level(self) -> bool:
        """Whether the weight loads no lateral gauge."""
        return self.angle_deg == 0.0

    @property
    def empty(self) -> Placing:
        """The plate at the same tilt without a weight."""
        return self._replace(mass_g=0.0)

    def __str__(self) -> str:
        if self.mass_g:
            return f"put {self.mass_g:g} g at {self.x_mm:g} mm"
        tilt = f"tilt the plate by {self.angle_deg:g} degrees towards {self.azimuth_deg:g}"
        return f"{'level the plate' if self.level else tilt}, nothing on it"

    def load(self, gravity: float) -> tuple[float, float, float]:
        """Return Fx, Fy and Fn in N under a gravity in m/s^2."""
        weight = self.mass_g * 1e-3 * gravity
        along = weight * sin(radians(self.angle_deg))
        azimuth = radians(self.azimuth_deg)
        return along * cos(azimuth), along * sin(azimuth), weight * cos(radians(self.angle_deg))


class Weighing(NamedTuple):
    """A weight, with what the gauges showed at the same tilt without it and with it."""

    placing: Placing
    empty: npt.NDArray[np.float64]
    """Raw S1..S6 in N."""
    loaded: npt.NDArray[np.float64]
    """Raw S1..S6 in N."""

    @property
    def gauges(self) -> npt.NDArray[np.float64]:
        """What the weight has added to S1..S6 in N."""
        return self.loaded - self.empty

    def as_json(self) -> dict[str, Any]:
        """Return what a certificate holds of it."""
        raw = {"empty_mN": self.empty, "loaded_mN": self.loaded}
        return self.placing._asdict() | {
            name: [round(float(value) * 1e3, 3) for value in values] for name, values in raw.items()
        }


@in_words()
def read_plan(path: Path | str) -> list[Placing]:
    """Read the placings of a CSV file with the columns mass_g, angle_deg, azimuth_deg, x_mm.

    Raises
    ------
    ValueError
        If it is no such file, or a number is out of range; names the line.
    OSError
        If it cannot be read.
    """
    path = Path(path)
    with TextIOWrapper(open_regular(path), encoding="utf-8", newline="") as file:
        reader = csv.reader(iter(lambda: file.readline(_LONGEST_LINE), ""))
        try:
            plan = _placings(reader, path)
        except csv.Error as error:
            raise ValueError(f"{path}: line {reader.line_num}: {error}") from error
    if not plan:
        raise ValueError(f"{path}: no weighing")
    return plan


def _placings(reader: _csv.Reader, path: Path) -> list[Placing]:
    if [name.strip() for name in next(reader, [])] != list(_RANGES):
        raise ValueError(f"{path}: line 1 is not {','.join(_RANGES)}")
    plan = []
    for row in reader:
        plan.append(_placing(row, f"{path}: line {reader.line_num}"))
        if len(plan) > _MOST_ROWS:
            raise ValueError(f"{path}: more than {_MOST_ROWS} weighings")
    return plan


def _placing(row: list[str], where: str) -> Placing:
    if len(row) != len(_RANGES):
        raise ValueError(f"{where} has {len(row)} of {len(_RANGES)} fields")
    numbers = []
    for (name, (low, high)), text in zip(_RANGES.items(), row, strict=True):
        try:
            number = float(text)
        except ValueError:
            raise ValueError(f"{where}: {name} {text.strip()!r} is not a number") from None
        if not (isfinite(number) and low <= number <= high):
            raise ValueError(f"{where}: {name} {text.strip()} is outside {low:g}..{high:g}")
        numbers.append(number)
    return Placing(*numbers)
