"""The tribometer: from six strain gauges to the contact of the finger."""

from __future__ import annotations

import math
from typing import ClassVar

from smarttac_can.vocabulary.model import require
from smarttac_can.vocabulary.signals import TARE_SAMPLES, TICK, Contact

Matrix = tuple[tuple[float, float], tuple[float, float]]
Forces = tuple[float, float, float, float, float, float]

RELEASE = 0.7
"""A touch ends below this fraction of the contact force, so that noise does not chop it up."""
DETERMINANT_MIN = 0.1
"""Smallest determinant of the cross-talk, or of its inverse, by which two loads are told apart."""
MEMORY = 0.95
"""Fading memory of the position filter: a sample counts half after 14 ms."""


def calibration(crosstalk: Matrix) -> Matrix:
    """Return the inverse of the cross-talk matrix.

    Parameters
    ----------
    crosstalk
        ``(S1, S2) = crosstalk (Fx, Fy)``, found by loading the plate along x and along y.

    Raises
    ------
    ValueError
        If the two loads cannot be told apart: the determinant is below 0.1.
    """
    (xx, xy), (yx, yy) = crosstalk
    determinant = xx * yy - xy * yx
    if not abs(determinant) >= DETERMINANT_MIN:
        raise ValueError(f"crosstalk determinant {determinant:g} is inside -0.1..0.1")
    return (
        (yy / determinant, -xy / determinant),
        (-yx / determinant, xx / determinant),
    )


def _gains(memory: float) -> tuple[tuple[float, float], ...]:
    """Return the gains (position, speed) of the filter for the 1st, 2nd ... sample of a touch."""
    alpha, beta = 1.0 - memory * memory, (1.0 - memory) ** 2
    gains = [(1.0, 0.0)]
    n = 2
    while True:
        expanding = 2.0 * (2.0 * n - 1.0) / (n * (n + 1.0)), 6.0 / (n * (n + 1.0))
        if expanding[0] <= alpha:
            return (*gains, (alpha, beta / TICK))
        gains.append((expanding[0], max(expanding[1], beta) / TICK))
        n += 1


class PositionFilter:
    """Straight line fitted to the positions of a touch, with a fading memory.

    An alpha-beta filter: it follows a steady speed without lag, where a low-pass filter of the
    same noise would report a boundary late. At the start of a touch its gains are those of the
    least-squares line through all samples so far (expanding memory), afterwards those of the
    critically damped fading memory ``alpha = 1 - m^2, beta = (1 - m)^2`` (Morrison, Introduction
    to Sequential Smoothing and Prediction, 1969). The noise of a sample is cut to a quarter.
    """

    __slots__ = ("_age", "position", "speed")

    _GAINS: ClassVar[tuple[tuple[float, float], ...]] = _gains(MEMORY)
    _LAST: ClassVar[int] = len(_GAINS) - 1

    def __init__(self) -> None:
        self.position = 0.0
        self.speed = 0.0
        self._age = 0

    def begin(self, position: float) -> None:
        """Start a touch at a measured position in m."""
        self.position = position
        self.speed = 0.0
        self._age = 1

    def update(self, position: float) -> None:
        """Take the measured position in m of the next tick."""
        age = self._age
        alpha, beta = self._GAINS[age]
        if age < self._LAST:
            self._age = age + 1
        predicted = self.position + TICK * self.speed
        residual = position - predicted
        self.position = predicted + alpha * residual
        self.speed += beta * residual


class Tribometer:
    """Tare, calibration, centre of pressure and coefficient of friction.

    Parameters
    ----------
    lateral
        Calibration ``(Fx, Fy) = lateral (S1, S2)``; see :func:`calibration`.
    gauge_positions
        Where S3..S6 stand along x, in m from the middle of the plate.
    gauge_noise
        Standard uncertainty of one tared gauge in N, for the uncertainty of the COF.
    contact_force
        Normal force in N from which a finger touches; it ceases to at 0.7 of it.
    """

    __slots__ = (
        "_filter",
        "_head",
        "_lateral",
        "_offsets",
        "_press",
        "_release",
        "_ring",
        "_sigma2",
        "_touching",
        "_x",
        "tared",
    )

    def __init__(
        self,
        lateral: Matrix,
        gauge_positions: tuple[float, float, float, float],
        gauge_noise: float,
        contact_force: float,
    ) -> None:
        self._ring: list[Forces] = []
        self._head = 0
        self._offsets: Forces = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self.tared = False
        """Whether the offsets were measured or set."""
        self._filter = PositionFilter()
        self._touching = False
        self.calibrate(lateral, gauge_positions, gauge_noise, contact_force)

    def calibrate(
        self,
        lateral: Matrix,
        gauge_positions: tuple[float, float, float, float],
        gauge_noise: float,
        contact_force: float,
    ) -> None:
        """Replace the parameters; tare, touch and position remain."""
        (xx, xy), (yx, yy) = lateral
        self._lateral = (xx, xy, yx, yy)
        self._x = gauge_positions
        self._sigma2 = gauge_noise * gauge_noise
        self._press = contact_force
        self._release = RELEASE * contact_force

    @property
    def offsets(self) -> Forces:
        """Zero of S1..S6 in N, -20..20; another zero ends a touch."""
        return self._offsets

    @offsets.setter
    def offsets(self, offsets: Forces) -> None:
        for gauge, offset in enumerate(offsets, 1):
            require(f"zero of S{gauge}", offset, -20.0, 20.0)
        self.tared = True
        if offsets == self._offsets:
            return
        self._offsets = offsets
        # What was felt before belongs to another zero: no touch, and no position to hold.
        self._touching = False
        self._filter = PositionFilter()

    def tare(self) -> Forces:
        """Take the `null` as the zero of S1..S6, and return it in N; raises as that does."""
        self.offsets = self.null()
        return self._offsets

    def null(self) -> Forces:
        """Return the mean of the last 64 raw samples of S1..S6 in N.

        Raises
        ------
        RuntimeError
            If fewer than 64 samples were seen.
        """
        if len(self._ring) < TARE_SAMPLES:
            raise RuntimeError(f"a tare needs {TARE_SAMPLES} samples, {len(self._ring)} were seen")
        s1, s2, s3, s4, s5, s6 = (
            math.fsum(gauge) / TARE_SAMPLES for gauge in zip(*self._ring, strict=True)
        )
        return (s1, s2, s3, s4, s5, s6)

    def update(self, gauges: Forces) -> Contact:
        """Return the contact for finite raw gauge forces in N; to be called once a tick."""
        ring = self._ring
        if len(ring) < TARE_SAMPLES:
            ring.append(gauges)
        else:
            head = self._head
            ring[head] = gauges
            self._head = (head + 1) % TARE_SAMPLES
        s1, s2, s3, s4, s5, s6 = gauges
        o1, o2, o3, o4, o5, o6 = self._offsets
        s1 -= o1
        s2 -= o2
        s3 -= o3
        s4 -= o4
        s5 -= o5
        s6 -= o6
        xx, xy, yx, yy = self._lateral
        Fx = xx * s1 + xy * s2
        Fy = yx * s1 + yy * s2
        Fn = s3 + s4 + s5 + s6
        line = self._filter
        if Fn < (self._release if self._touching else self._press):
            self._touching = False
            return Contact(Fx, Fy, Fn, 0.0, 0.0, line.position, 0.0, False)
        x3, x4, x5, x6 = self._x
        position = (x3 * s3 + x4 * s4 + x5 * s5 + x6 * s6) / Fn
        if self._touching:
            line.update(position)
        else:
            self._touching = True
            line.begin(position)
        mu = math.sqrt(Fx * Fx + Fy * Fy) / Fn
        # Four gauges make up Fn: sig_n^2 = 4 sig^2.
        u_mu = math.sqrt(self._sigma2 * (1.0 + 4.0 * mu * mu)) / Fn
        return tuple.__new__(Contact, (Fx, Fy, Fn, mu, u_mu, line.position, line.speed, True))
