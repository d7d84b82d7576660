"""The histogram of a loop's delays. Needs matplotlib, as `smarttac_can.paper.figures` does."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from smarttac_can.bench.drawing import GREEN, INK, PALE, RED, canvas
from smarttac_can.timing.loop_timing import Delays, LoopTiming

_BINS: Final = 120
_MS_PER_US: Final = 1e-3
_CURVES: Final[dict[str, dict[str, Any]]] = {
    "sync": {"color": PALE, "linestyle": ":", "label": "SYNC later than 1 ms after the last"},
    "measurement": {"color": GREEN, "linestyle": "--", "label": "measurement after SYNC"},
    "drive": {"color": RED, "linestyle": "-", "label": "drive after SYNC"},
}


def histogram(timing: LoopTiming) -> Figure:
    """Draw how often SYNC, measurement and drive came how late, the counts logarithmic.

    Parameters
    ----------
    timing
        Of a loop that ran.
    """
    curves: dict[str, Delays] = {name: getattr(timing, name) for name in _CURVES}
    longest = max(delays.quantile_us(1.0) for delays in curves.values())
    edges = np.linspace(0, longest + 1, _BINS + 1)
    with canvas(7.2, 4.6) as figure:
        axes = figure.subplots()
        for name, delays in curves.items():
            counts, _ = np.histogram(
                list(delays.counts), edges, weights=list(delays.counts.values())
            )
            style = dict(_CURVES[name])
            style["label"] += f", at most {delays.quantile_us(1.0) * _MS_PER_US:.2f} ms"
            axes.stairs(counts, edges * _MS_PER_US, linewidth=1.8, **style)
        axes.set_yscale("log")
        axes.set(xlim=(0, (longest + 1) * _MS_PER_US), ylim=(0.7, None))
        axes.set_title(f"Delays in {timing.ticks} ticks of the loop, {timing.missed} missed")
        axes.set_xlabel("delay (ms)")
        axes.set_ylabel("ticks")
        axes.legend(loc="upper right", labelcolor=INK)
    return figure
