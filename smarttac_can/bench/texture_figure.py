"""The picture of a texture. Needs matplotlib (extra ``report``); draws off screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from smarttac_can.bench.drawing import RED, canvas

if TYPE_CHECKING:
    from smarttac_can.bench.textures import Texture


def texture_figure(texture: Texture) -> Figure:
    """Draw the COF over the plate, or over the time."""
    first, last = texture.extent
    places = np.linspace(first, last, 4001)
    with canvas(7.2, 3.4) as figure:
        axes = figure.subplots()
        axes.plot(places, texture.cof(places), color=RED, lw=1.4)
        axes.set_xlim(first, last)
        axes.set_ylim(bottom=0.0)
        axes.set_title("Over time" if texture.over_time else "Over the plate")
        axes.set_xlabel("time (s)" if texture.over_time else "position on the plate (mm)")
        axes.set_ylabel("coefficient of friction")
    return figure
