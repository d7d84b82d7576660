"""Style of all figures. Needs matplotlib (extra ``report``); draws without a window."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import matplotlib.style
from matplotlib.backend_bases import RendererBase
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


def style() -> AbstractContextManager[None]:
    """Return a block in the style of the report, whatever the caller or a matplotlibrc has set."""
    return matplotlib.style.context(STYLE, after_reset=True)


class Picture(Figure):
    """A figure that a notebook shows as the last value of a cell, without pyplot."""

    def draw(self, renderer: RendererBase) -> None:
        """Draw all parts; those that are made only now, such as ticks, are in the style, too."""
        with style():
            super().draw(renderer)

    def _repr_png_(self) -> bytes:
        file = BytesIO()
        save_as(self, file, "png")
        return file.getvalue()


@contextmanager
def canvas(width: float, height: float) -> Iterator[Figure]:
    """Create a figure without a window, with a size in inches, in the style of the report."""
    with style():
        figure = Picture(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(figure)
        yield figure


@contextmanager
def drawn_into(given: FigureBase | None, width: float, height: float) -> Iterator[FigureBase]:
    """Draw into a figure, or a new `canvas` if it is None, in the style of the report.

    What this style does not say, as the width of ticks, is the caller's choice in a given figure.

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
    pictures = {name: BytesIO() for name in _FORMATS}
    for name, file in pictures.items():
        save_as(figure, file, name)
    return {name: file.getvalue() for name, file in pictures.items()}


def save_as(figure: Figure, file: Path | BytesIO, name: str) -> None:
    """Save a figure in a format of matplotlib; PNG and SVG have always the same bytes."""
    with style():
        figure.savefig(file, format=name, **_FORMATS.get(name, {}))


def save(figure: Figure, path: Path) -> None:
    """Save a figure as PNG and SVG; only the suffix of `path` is replaced."""
    for name, picture in rendered(figure).items():
        path.with_suffix(f".{name}").write_bytes(picture)
