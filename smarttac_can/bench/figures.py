"""The pictures of textures and traces. Needs matplotlib (extra ``report``)."""

from __future__ import annotations

from contextlib import nullcontext
from typing import TYPE_CHECKING, Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure, FigureBase

from smarttac_can.bench.drawing import INK, RED, STYLE, canvas

if TYPE_CHECKING:
    from smarttac_can.bench.textures import Texture
    from smarttac_can.bench.traces import Floats, Trace

_MARGIN: Final = 0.02
_HEADROOM: Final = 0.1
"""Free space beside and above the curve, as shares of it."""
_PANELS: Final = {
    "COF": {"cof": "measured", "cof_reference": "reference"},
    "force (N)": {"normal_force_n": "normal", "tangential_force_n": "tangential"},
    "amplitude (µm)": {"amplitude_um": ""},
    "voltage (V)": {"voltage_v": ""},
    "frequency (Hz)": {"frequency_hz": ""},
    "position (mm)": {"position_mm": ""},
}
"""What stands below each other: lines by array, and what the legend calls them."""
_COLORS: Final = (RED, INK)
_MOST_POINTS: Final = 4000
"""Of a line; twice what a screen has across."""


def texture_figure(texture: Texture) -> Figure:
    """Draw the COF over the plate, or over the time."""
    first, last = texture.extent
    places = np.linspace(first, last, 4001)
    with canvas(7.2, 3.4) as figure:
        axes = figure.subplots()
        axes.plot(places, texture.cof(places), color=RED, lw=1.4)
        # A line on the frame would be cut to half its width.
        aside = _MARGIN * (last - first)
        axes.set_xlim(first - aside, last + aside)
        axes.set_ylim(0.0, (1.0 + _HEADROOM) * max(texture.cof(places)))
        axes.set_title("Over time" if texture.over_time else "Over the plate")
        axes.set_xlabel("time (s)" if texture.over_time else "position on the plate (mm)")
        axes.set_ylabel("coefficient of friction")
    return figure


def trace_figure(trace: Trace, given: FigureBase | None) -> FigureBase:
    """Draw the arrays of a trace over the time, those that have a value anywhere.

    Raises
    ------
    ValueError
        If what it is to be drawn into is no figure.
    """
    if not isinstance(given, FigureBase | None):
        raise ValueError(f"figure {given!r} is no figure of matplotlib")
    panels = {
        label: {name: what for name, what in lines.items() if not _empty(trace, name)}
        for label, lines in _PANELS.items()
    }
    panels = {label: lines for label, lines in panels.items() if lines}
    new = canvas(9.0, 1.0 + 1.3 * len(panels)) if given is None else nullcontext(given)
    with mpl.rc_context(STYLE), new as figure:
        rows = figure.subplots(len(panels), sharex=True, squeeze=False)[:, 0]
        for axes, (label, lines) in zip(rows, panels.items(), strict=True):
            for color, (name, what) in zip(_COLORS, lines.items(), strict=False):
                line = _line(trace, getattr(trace, name))
                axes.plot(*line, color=color, lw=1.0, label=what)
            axes.set_ylabel(label)
            axes.ticklabel_format(useOffset=False)
            if len(lines) > 1:
                axes.legend(
                    loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, ncols=2
                )
        figure.align_ylabels(rows)
        lost = f", {trace.lost} ticks lost" if trace.lost else ""
        rows[0].set_title(f"{trace.experiment}, subject {trace.subject}{lost}")
        rows[-1].set_xlabel("time (s)")
    return figure


def _empty(trace: Trace, name: str) -> bool:
    return bool(np.isnan(getattr(trace, name)).all())


def _line(trace: Trace, values: Floats) -> tuple[Floats, Floats]:
    """Return times and values of a line, which is broken where ticks are missing.

    Of a long one the least and the greatest value of equal parts are left, which look the same.
    """
    rows, points = np.arange(len(trace)), [values]
    if len(trace) > _MOST_POINTS:
        rows = np.linspace(0, len(trace), _MOST_POINTS // 2, endpoint=False).astype(np.intp)
        points = [np.fmin.reduceat(values, rows), np.fmax.reduceat(values, rows)]
    many = len(points)
    missing = many * (np.flatnonzero(np.diff(trace.tick[rows]) > np.diff(rows)) + 1)
    times = np.repeat(trace.time_s[rows], many)
    return (
        np.insert(times, missing, np.nan),
        np.insert(np.column_stack(points).ravel(), missing, np.nan),
    )
