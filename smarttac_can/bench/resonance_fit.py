"""The resonance of a plate from what it answered at some frequencies."""

from __future__ import annotations

from math import pi
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

_LEAST_POINTS = 3


class ResonanceFit(NamedTuple):
    """What ``V/W = (1 + j tau (w - w0)) / gain`` says of a plate, by least squares.

    With gain and tau of the signs that the fit finds: a plate whose pick-up or drive has the wrong
    polarity shows a gain below 0, one whose phase runs backwards a tau below 0.
    """

    gain: float
    """Vibration at resonance in m peak-to-peak per V."""
    tau: float
    """Time constant in s."""
    f0: float
    """Resonance in Hz."""
    residual: float
    """Root mean square of what the fit leaves of V/W, as a fraction of 1/gain."""

    @property
    def quality(self) -> float:
        """Quality factor ``pi f0 tau``."""
        return pi * self.f0 * self.tau

    @classmethod
    def from_sweep(
        cls,
        frequency: npt.ArrayLike,
        W: npt.ArrayLike,
        voltage: float,
    ) -> Self:
        """Fit a sweep.

        Parameters
        ----------
        frequency
            Shape (n,), in Hz, three or more that differ.
        W
            Shape (n,), complex vibration in m peak-to-peak at each, in the frame of the drive.
        voltage
            Of the drive in V, above 0.

        Raises
        ------
        ValueError
            If there are too few points, or the plate does not answer: W is 0 or all the same.
        """
        f = np.asarray(frequency, dtype=np.float64)
        answers = np.asarray(W, dtype=np.complex128)
        if len(f) < _LEAST_POINTS or len(np.unique(f)) < _LEAST_POINTS:
            raise ValueError(f"{len(f)} points of a sweep are fewer than {_LEAST_POINTS}")
        if not np.all(np.abs(answers) > 0.0):
            raise ValueError("the plate does not vibrate")
        inverse = voltage / answers
        centre = f.mean()
        slope, middle = np.polyfit(f - centre, inverse.imag, 1)
        real = float(inverse.real.mean())
        if not slope or not real:
            raise ValueError("the vibration does not change with the frequency")
        fitted = real + 1j * (middle + slope * (f - centre))
        residual = float(np.sqrt(np.mean(np.abs(inverse - fitted) ** 2)))
        return cls(
            gain=1.0 / real,
            tau=float(slope) / (2.0 * pi * real),
            f0=float(centre - middle / slope),
            residual=residual / abs(real),
        )
