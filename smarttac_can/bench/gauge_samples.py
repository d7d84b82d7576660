"""Raw samples of the strain gauges, for what looks at the sensors and not at a finger."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.weighings import Placing, Weighing

GAUGES: Final = range(1, 7)
SAMPLES: Final = 64


def weigh(stimulator: Stimulator, placing: Placing, do: Callable[[Placing], object]) -> Weighing:
    """Weigh one weight: what the gauges show at a tilt without it, and with it.

    Parameters
    ----------
    stimulator
        Connected; neither armed nor running.
    placing
        Where the weight is to be put.
    do
        Called with what is to be done at the plate, which is done when it returns: a question to a
        person, with the text of the `Placing`, or ``stimulator.finger.put`` for a simulated plate.

    Raises
    ------
    BenchError
        As `Stimulator.sample`.
    """
    do(placing.empty)
    empty = mean_gauges(stimulator)
    do(placing)
    return Weighing(placing, empty, mean_gauges(stimulator))


def mean_gauges(stimulator: Stimulator) -> npt.NDArray[np.float64]:
    """Return the mean of 64 raw samples of S1..S6 in N, shape (6,)."""
    means: npt.NDArray[np.float64] = stimulator.sample(gauge_names(), SAMPLES).mean(axis=0) * 1e-3
    return means


def gauge_names() -> list[str]:
    """Name the objects with the raw readings of S1..S6."""
    return [f"Plate input.S{gauge}" for gauge in GAUGES]
