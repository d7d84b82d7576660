"""The shapes of friction maps that the control holds are those that the tool finds."""

import runpy
from pathlib import Path

import numpy as np

from smarttac_can.control.friction_map import FIRST, MEAN, SECOND, THIRD

TOOL = Path(__file__).parents[2] / "tools" / "friction_shapes.py"


def test_the_shapes_are_those_of_the_tool():
    mean, components = runpy.run_path(str(TOOL))["shapes"]()
    for held, found in zip((MEAN, FIRST, SECOND, THIRD), (mean, *components), strict=True):
        np.testing.assert_allclose(held, found, rtol=0.0, atol=5.1e-4)
