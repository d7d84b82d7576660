"""The friction map of a finger: friction as a function of the amplitude.

``ln mu = m0 + h(W)``. m0 varies with force, sweat and position. h is the shape of the friction map:
falling, linear between nodes, and 0 at W = 0. It is the mean over many kinds of fingers plus three
components, whose weights a Kalman filter learns from pairs of settled levels.

All functions are pure, with floats and tuples; amplitudes are in m.
"""

from __future__ import annotations

from typing import Final, NamedTuple

Nodes = tuple[float, ...]
"""Values at the nodes 0, `SPACING`, ... `LAST` times `SPACING`."""
SPACING: Final = 0.25e-6
"""Distance of two nodes in m."""
LAST: Final = 12
# fmt: off
MEAN: Final = (
    0.0, -0.008, -0.036, -0.083, -0.147, -0.223, -0.307, -0.396, -0.484, -0.570, -0.649, -0.722,
    -0.787,
)
FIRST: Final = (
    0.0, -0.004, -0.019, -0.044, -0.079, -0.120, -0.163, -0.204, -0.240, -0.267, -0.284, -0.293,
    -0.294,
)
SECOND: Final = (
    0.0, -0.006, -0.020, -0.036, -0.049, -0.057, -0.057, -0.048, -0.030, -0.006, 0.020, 0.047,
    0.071,
)
THIRD: Final = (
    0.0, -0.005, -0.014, -0.019, -0.018, -0.011, 0.0, 0.009, 0.015, 0.014, 0.007, -0.005, -0.020,
)
# fmt: on
"""Mean and components of h, as printed by tools/pages/make shapes."""
FLATTEST: Final = 0.2
"""Least fall of h from node to node, as a fraction of that of the mean. The learned map can
therefore not rise, or be so flat that an error of a few % alternates between both ends."""
FARTHEST: Final = 4.0
"""Bound of a weight in standard deviations of the weights of all fingers."""
FORGOTTEN: Final = 0.02
"""Fraction of the weights that fades with each pair, as speed and sweat change the shape."""


class Weights(NamedTuple):
    """Weights of the three components, in standard deviations, and their covariance."""

    a: float
    b: float
    c: float
    aa: float
    ab: float
    ac: float
    bb: float
    bc: float
    cc: float


PRIOR: Final = Weights(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
"""Weights before learning, for any finger."""


class Plateau(NamedTuple):
    """Means over a period of steady vibration."""

    ln_mu: float
    """Mean of ln mu."""
    W: float
    """Mean amplitude in m."""
    ln_ref: float
    """ln of the reference of the COF."""


def value(nodes: Nodes, W: float) -> float:
    """Return the value at an amplitude, 0 or more; extrapolated linearly beyond the last node."""
    place = W / SPACING
    i = int(place)
    if i >= LAST:
        i = LAST - 1
    return nodes[i] + (place - i) * (nodes[i + 1] - nodes[i])


def slope(nodes: Nodes, W: float) -> float:
    """Return the change per m of the value at an amplitude, 0 or more."""
    i = min(int(W / SPACING), LAST - 1)
    return (nodes[i + 1] - nodes[i]) / SPACING


def amplitude_for(nodes: Nodes, h: float) -> float:
    """Return the amplitude at which a falling shape is h; extrapolated linearly at both ends."""
    i = 0
    while i < LAST - 1 and nodes[i + 1] > h:
        i += 1
    return SPACING * (i + (nodes[i] - h) / (nodes[i] - nodes[i + 1]))


def shape(weights: Weights) -> Nodes:
    """Return h at the nodes for weights of the components."""
    h1 = _node(weights, 1, 0.0)
    h2 = _node(weights, 2, h1)
    h3 = _node(weights, 3, h2)
    h4 = _node(weights, 4, h3)
    h5 = _node(weights, 5, h4)
    h6 = _node(weights, 6, h5)
    h7 = _node(weights, 7, h6)
    h8 = _node(weights, 8, h7)
    h9 = _node(weights, 9, h8)
    h10 = _node(weights, 10, h9)
    h11 = _node(weights, 11, h10)
    h12 = _node(weights, 12, h11)
    return (0.0, h1, h2, h3, h4, h5, h6, h7, h8, h9, h10, h11, h12)


def _node(weights: Weights, i: int, above: float) -> float:
    """Return h at a node, which is limited to be below that of the node before, ``above``."""
    h = MEAN[i] + weights.a * FIRST[i] + weights.b * SECOND[i] + weights.c * THIRD[i]
    most = above + FLATTEST * (MEAN[i] - MEAN[i - 1])
    return h if h < most else most


def learned(weights: Weights, before: Plateau, after: Plateau, variance: float) -> Weights:
    """Return the weights after two settled levels of one pass.

    Parameters
    ----------
    weights
        Weights so far.
    before, after
        Both levels.
    variance
        Variance of the difference of their ln mu, above 0.
    """
    x = value(FIRST, after.W) - value(FIRST, before.W)
    y = value(SECOND, after.W) - value(SECOND, before.W)
    z = value(THIRD, after.W) - value(THIRD, before.W)
    expected = value(MEAN, after.W) - value(MEAN, before.W)
    expected += weights.a * x + weights.b * y + weights.c * z
    kept = 1.0 - FORGOTTEN
    aa = kept * weights.aa + FORGOTTEN
    bb = kept * weights.bb + FORGOTTEN
    cc = kept * weights.cc + FORGOTTEN
    ab, ac, bc = kept * weights.ab, kept * weights.ac, kept * weights.bc
    by_a = aa * x + ab * y + ac * z
    by_b = ab * x + bb * y + bc * z
    by_c = ac * x + bc * y + cc * z
    spread = x * by_a + y * by_b + z * by_c + variance
    e = (after.ln_mu - before.ln_mu - expected) / spread
    return Weights(
        _bounded(weights.a + by_a * e),
        _bounded(weights.b + by_b * e),
        _bounded(weights.c + by_c * e),
        aa - by_a * by_a / spread,
        ab - by_a * by_b / spread,
        ac - by_a * by_c / spread,
        bb - by_b * by_b / spread,
        bc - by_b * by_c / spread,
        cc - by_c * by_c / spread,
    )


def _bounded(weight: float) -> float:
    return FARTHEST if weight > FARTHEST else -FARTHEST if weight < -FARTHEST else weight
