"""The picture of a texture. Needs matplotlib (extra ``report``); draws off screen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.figure import Figure

from smarttac_can.bench.drawing import RED, canvas

_MARGIN: Final = 0.02
_HEADROOM: Final = 0.1
"""Free space beside and above the curve, as shares of it."""

if TYPE_CHECKING:
    from smarttac_can.bench.textures import Texture


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
