"""The mode shape: how much of the plate's vibration acts on a finger, by its position.

A standing wave has nodes, and a fingertip covers several mm of it. So the finger feels
``W (1 + c cos(k x) + s sin(k x))`` with ``k = 2 pi/node distance``, while the pick-up reads W. The
predictive friction law uses this, and learns c and s while a finger slides.

They are learned from the error of ln mu. If c were off by dc, the error would be
``dln mu/dW W cos(k x) dc``, and likewise for s; but m0 of the law follows the error, too. So a
Kalman filter has as its regressors what m0 has not followed of these two: each minus itself behind
the same low-pass filter. Their change is taken from m0 as far as m0 had followed it.

All functions are pure, with floats and named tuples.
"""

from __future__ import annotations

from math import cos, pi, sin
from typing import Final, NamedTuple

VARIANCE: Final = 0.07**2
"""Variance of c and s over plates [A]: a contact of 7 mm on nodes of 8 mm has 0.09."""
ERROR_VARIANCE: Final = 3e-3
"""Variance of ln mu in a tick without noise, as force and speed of a finger change."""
FARTHEST: Final = 0.4
"""Bound of c and s; beyond it something else than a mode shape is learned."""
RESOLUTION: Final = 1e-4
"""Resolution with which c and s are stored."""


Regressors = tuple[float, float]
"""Change of ln mu with c and with s."""


class ModeShape(NamedTuple):
    """Known mode shape, and its covariance."""

    k: float
    """In rad/m."""
    c: float
    s: float
    cc: float
    cs: float
    ss: float


def shape_of(node_distance: float, c: float, s: float) -> ModeShape:
    """Return a mode shape as it is before learning.

    Parameters
    ----------
    node_distance
        Distance of the nodes in m.
    c, s
        Known coefficients, 0 for none.
    """
    return ModeShape(2.0 * pi / node_distance, c, s, VARIANCE, 0.0, VARIANCE)


FLAT: Final = shape_of(8e-3, 0.0, 0.0)
"""A mode shape of which nothing is known."""


def restored(known: ModeShape, stored: ModeShape) -> ModeShape:
    """Return a stored mode shape, or the known one if that was stored."""
    apart = max(abs(known.c - stored.c), abs(known.s - stored.s))
    return stored if known.k != stored.k or apart > RESOLUTION else known


def share_at(shape: ModeShape, x: float) -> float:
    """Return the vibration that acts on a finger at x in m, relative to that of the pick-up."""
    at = shape.k * x
    return 1.0 + shape.c * cos(at) + shape.s * sin(at)


def regressors(shape: ModeShape, x: float, by_share: float) -> Regressors:
    """Return by how much ln mu at x in m changes with c and with s.

    ``by_share`` is its change with the share of the vibration that acts, ``dln mu/dW W``.
    """
    at = shape.k * x
    return by_share * cos(at), by_share * sin(at)


def unsureness(shape: ModeShape, by: Regressors) -> float:
    """Return the variance of ln mu that comes from that of c and s, by its `regressors`."""
    by_c, by_s = by
    return by_c * by_c * shape.cc + 2.0 * by_c * by_s * shape.cs + by_s * by_s * shape.ss


def learned(
    shape: ModeShape, by: Regressors, followed: Regressors, error: float, relative: float
) -> tuple[ModeShape, float]:
    """Return the mode shape after a tick of steady sliding, and the change that m0 needs with it.

    Parameters
    ----------
    shape
        Mode shape before it.
    by, followed
        `regressors` of this tick, and what m0 has followed of them.
    error
        Measured ln mu minus the expected one.
    relative
        Standard uncertainty of the COF divided by the COF.
    """
    k, c, s, cc, cs, ss = shape
    followed_c, followed_s = followed
    x, y = by[0] - followed_c, by[1] - followed_s
    by_x, by_y = cc * x + cs * y, cs * x + ss * y
    spread = x * by_x + y * by_y + relative * relative + ERROR_VARIANCE
    e = error / spread
    c_new, s_new = _bounded(c + by_x * e), _bounded(s + by_y * e)
    cc, cs, ss = cc - by_x * by_x / spread, cs - by_x * by_y / spread, ss - by_y * by_y / spread
    change = -followed_c * (c_new - c) - followed_s * (s_new - s)
    return ModeShape(k, c_new, s_new, cc, cs, ss), change


def follow(followed: Regressors, by: Regressors, share: float) -> Regressors:
    """Return what m0 has followed of the regressors after it took over a share of an error."""
    followed_c, followed_s = followed
    return followed_c + share * (by[0] - followed_c), followed_s + share * (by[1] - followed_s)


def _bounded(x: float) -> float:
    return FARTHEST if x > FARTHEST else -FARTHEST if x < -FARTHEST else x
