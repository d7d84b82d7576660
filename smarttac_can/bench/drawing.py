"""Style of all figures. Needs matplotlib (extra ``report``); draws without a window."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase

INK, PALE = "#1f2933", "#6b7785"
RED, GREEN = "#c1361c", "#1a9377"
STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 10.5,
    "axes.edgecolor": PALE,
    "axes.labelcolor": INK,
    "axes.titlelocation": "left",
    "axes.titlesize": 12,
    "axes.titleweight": "bold",
    "axes.titlecolor": INK,
    "axes.titlepad": 12,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e8ec",
    "grid.linewidth": 0.8,
    "xtick.color": PALE,
    "ytick.color": PALE,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "text.color": INK,
    "legend.frameon": False,
    "lines.solid_capstyle": "round",
    "savefig.facecolor": "white",
    "svg.hashsalt": "smarttac-can",
}
# Omit the date and the version of matplotlib, so that the bytes are reproducible.
_FORMATS: Final[dict[str, dict[str, Any]]] = {
    "png": {"dpi": 144, "metadata": {"Software": None}},
    "svg": {"metadata": {"Date": None, "Creator": None}},
}


class Picture(Figure):
    """A figure that a notebook shows as the last value of a cell, without pyplot."""

    def _repr_png_(self) -> bytes:
        return rendered(self)["png"]


@contextmanager
def canvas(width: float, height: float) -> Iterator[Figure]:
    """Create a figure without a window, with a size in inches, in the style of the report."""
    with mpl.rc_context(STYLE):
        figure = Picture(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        yield figure


@contextmanager
def drawn_into(given: FigureBase | None, width: float, height: float) -> Iterator[FigureBase]:
    """Draw into a figure, or a new `canvas` if it is None, in the style of the report.

    Raises
    ------
    ValueError
        If `given` is not a figure.
    """
    if not isinstance(given, FigureBase | None):
        raise ValueError(f"figure {given!r} is no figure of matplotlib")
    if given is None:
        with canvas(width, height) as figure:
            yield figure
    else:
        with mpl.rc_context(STYLE):
            yield given


def rendered(figure: Figure) -> dict[str, bytes]:
    """Return a figure as PNG and SVG, by the name of the format; always the same bytes."""
    pictures = {}
    with mpl.rc_context(STYLE):
        for name, options in _FORMATS.items():
            file = BytesIO()
            figure.savefig(file, format=name, **options)
            pictures[name] = file.getvalue()
    return pictures


def save(figure: Figure, path: Path) -> None:
    """Save a figure as PNG and SVG; only the suffix of `path` is replaced."""
    for name, picture in rendered(figure).items():
        path.with_suffix(f".{name}").write_bytes(picture)
