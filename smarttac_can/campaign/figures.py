"""How the figures of the fingers are distributed, drawn; needs matplotlib (extra ``report``)."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.figure import Figure

from smarttac_can.bench.drawing import GREEN, RED, canvas
from smarttac_can.campaign.chunk import COLUMNS, Rows
from smarttac_can.campaign.summary import LIMIT_CYCLE

_PANELS: Final = {
    "rise_time_ms": "rise time, ms",
    "overshoot_percent": "overshoot, % of the step",
    "static_error_percent": "static error, % of the reference",
    "chatter": "chatter",
}
_CURVES: Final = {"": (RED, "-", "true COF"), "measured_": (GREEN, "--", "measured COF")}


def distributions(rows: Rows, title: str) -> Figure:
    """Draw the share of fingers below each value, of the true and of the measured COF.

    Parameters
    ----------
    rows
        A row a finger; columns as in `COLUMNS`.
    title
        Over the figure.
    """
    with canvas(9.0, 6.4) as figure:
        figure.suptitle(title)
        for axes, (name, label) in zip(figure.subplots(2, 2).flat, _PANELS.items(), strict=True):
            for prefix, (colour, line, legend) in _CURVES.items():
                column = rows[:, COLUMNS.index(prefix + name)]
                known = np.sort(column[np.isfinite(column)])
                share = 100.0 * np.arange(1, len(known) + 1) / len(rows)
                axes.plot(known, share, color=colour, linestyle=line, label=legend)
            if name == "chatter":
                axes.axvline(LIMIT_CYCLE, color="black", linewidth=0.8, linestyle=":")
            axes.set_xscale("log")
            axes.set_xlabel(label)
            axes.set_ylabel("fingers below, %")
            axes.set_ylim(0.0, 100.0)
        figure.axes[0].legend()
    return figure
