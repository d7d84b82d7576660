"""How the figures of the fingers are distributed, drawn; needs matplotlib (extra ``report``)."""

from __future__ import annotations

from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from smarttac_can.bench.drawing import GREEN, PALE, RED, canvas
from smarttac_can.campaign.record import COLUMNS, Rows
from smarttac_can.campaign.summary import LIMIT_CYCLE

_PANELS: Final = {
    "rise_time_ms": "rise time (ms)",
    "overshoot_percent": "overshoot (% of the step)",
    "static_error_percent": "static error (% of the reference)",
    "chatter": "chatter of the COF (standard deviation)",
}
_CURVES: Final = {"": (RED, "-", "true COF"), "measured_": (GREEN, "--", "measured COF")}
_FEW_DECADES, _MANY_DECADES = 1.0, 2.5


def distributions(rows: Rows, title: str) -> Figure:
    """Draw the share of fingers below each value, of the true and of the measured COF.

    Parameters
    ----------
    rows
        A row a finger; columns as in `COLUMNS`.
    title
        What was run, below the heading.
    """
    with canvas(9.0, 7.0) as figure:
        figure.suptitle(f"Random fingers under control (simulated)\n{title}", fontsize=11)
        panels = figure.subplots(2, 2, sharey=True)
        for axes, (name, label) in zip(panels.flat, _PANELS.items(), strict=True):
            for prefix, (colour, line, legend) in _CURVES.items():
                column = rows[:, COLUMNS.index(prefix + name)]
                known = np.sort(column[np.isfinite(column)])
                share = 100.0 * np.arange(len(known) + 1) / len(rows)
                # From 0 on, so that a single finger shows as well.
                values = [*known[:1], *known]
                axes.plot(values, share[: len(values)], color=colour, linestyle=line, label=legend)
            if name == "chatter":
                _mark_limit_cycles(axes)
            axes.set_xscale("log")
            _label_few(axes)
            axes.set_xlabel(label)
            axes.set_ylim(0.0, 100.0)
        for axes in panels[:, 0]:
            axes.set_ylabel("fingers below (%)")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _mark_limit_cycles(axes: Axes) -> None:
    axes.axvline(LIMIT_CYCLE, color=PALE, linewidth=1.2, linestyle=":")
    axes.annotate(
        f"limit cycle above {LIMIT_CYCLE:g}",
        (LIMIT_CYCLE, 3.0),
        (-3.0, 0.0),
        textcoords="offset points",
        ha="right",
        va="bottom",
        rotation=90,
        fontsize=9,
    )


def _label_few(axes: Axes) -> None:
    """Label a logarithmic axis by plain numbers, so few that they do not touch."""
    low, high = axes.get_xlim()
    decades = np.log10(high / low)
    if decades < _FEW_DECADES:
        axes.xaxis.set_major_locator(MaxNLocator(4))
    else:
        subs = (1.0,) if decades > _MANY_DECADES else (1.0, 2.0, 5.0)
        axes.xaxis.set_major_locator(LogLocator(subs=subs, numticks=8))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
