"""Raw samples of the strain gauges, for what looks at the sensors and not at a finger."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.stimulator import Stimulator

GAUGES: Final = range(1, 7)
SAMPLES: Final = 64


def mean_gauges(stimulator: Stimulator) -> npt.NDArray[np.float64]:
    """Return the mean of 64 raw samples of S1..S6 in N, shape (6,)."""
    means: npt.NDArray[np.float64] = stimulator.sample(gauge_names(), SAMPLES).mean(axis=0) * 1e-3
    return means


def gauge_names() -> list[str]:
    """Name the objects with the raw readings of S1..S6."""
    return [f"Plate input.S{gauge}" for gauge in GAUGES]
