"""The tribometer: contact of the finger from six strain gauges."""

from __future__ import annotations

from itertools import count
from math import fsum, sqrt
from typing import Final, NamedTuple

from smarttac_can.science.control.budget import UNCALIBRATED, Calibrated
from smarttac_can.vocabulary.signals import TARE_SAMPLES, TICK, ContactFields

Matrix = tuple[tuple[float, float], tuple[float, float]]
Forces = tuple[float, float, float, float, float, float]

RELEASE = 0.7
"""Fraction of the contact force below which a touch ends, so that noise does not split it."""
DETERMINANT_MIN = 0.1
"""Smallest determinant of the cross-talk, or of its inverse, to separate two loads."""
MEMORY = 0.95
"""Fading memory of the position filter: the weight of a sample halves in 14 ms."""


def calibration(crosstalk: Matrix) -> Matrix:
    """Return the inverse of the cross-talk matrix.

    Parameters
    ----------
    crosstalk
        Matrix with ``(S1, S2) = crosstalk (Fx, Fy)``, measured by loading the plate along x and
        along y.

    Raises
    ------
    ValueError
        The two loads cannot be separated, as the determinant is below 0.1.
    """
    (xx, xy), (yx, yy) = crosstalk
    determinant = xx * yy - xy * yx
    if not abs(determinant) >= DETERMINANT_MIN:
        raise ValueError(f"crosstalk determinant {determinant:g} is inside -0.1..0.1")
    return (
        (yy / determinant, -xy / determinant),
        (-yx / determinant, xx / determinant),
    )


_ALPHA: Final = 1.0 - MEMORY * MEMORY
_BETA: Final = (1.0 - MEMORY) ** 2
_BETA_RATE: Final = _BETA / TICK


FARTHEST: Final = 1e3
"""Bound in K of the distance from the temperature of the calibration."""


class Gauging(NamedTuple):
    """Coefficients of the forces from tared gauges."""

    xx: float
    xy: float
    yx: float
    yy: float
    x3: float
    x4: float
    x5: float
    x6: float
    sigma2: float
    """Variance of a gauge in N2."""
    relative2: float
    """Relative variance of the COF of a calibrated tribometer, in addition."""
    shift2: float
    """Growth of it with the square of the distance in K from the calibration, in 1/K2."""
    drift2: float
    """Variance of the drift of a gauge's null in N2/K2."""
    calibrated_at: float
    """Temperature of the calibration in degC."""
    press: float
    """Normal force in N above which a finger touches."""
    release: float
    """Normal force in N below which the touch ends."""


PositionTrack = tuple[bool, float, float, int]
"""Whether the finger touches, and the straight line through the positions of its touch: position in
m, which is kept afterwards, speed in m/s, and samples as far as the gains depend on them."""


def gauging_of(
    lateral: Matrix,
    gauge_positions: tuple[float, float, float, float],
    gauge_noise: float,
    contact_force: float,
    calibrated: Calibrated = UNCALIBRATED,
) -> Gauging:
    """Return the coefficients of the forces.

    Parameters
    ----------
    lateral
        Calibration ``(Fx, Fy) = lateral (S1, S2)``; see :func:`calibration`.
    gauge_positions
        Positions of S3..S6 along x, in m from the middle of the plate.
    gauge_noise
        Standard uncertainty of one tared gauge in N, for the uncertainty of the COF.
    contact_force
        Normal force in N above which a finger touches; the touch ends at 0.7 of it.
    calibrated
        What a calibration says of the uncertainty; by default noise is all.
    """
    (xx, xy), (yx, yy) = lateral
    variance = gauge_noise * gauge_noise
    thresholds = (contact_force, RELEASE * contact_force)
    relative, shift, drift, temperature = calibrated
    beside = (relative * relative, shift * shift, drift * drift, temperature)
    return Gauging(xx, xy, yx, yy, *gauge_positions, variance, *beside, *thresholds)


UNTOUCHED: Final[PositionTrack] = (False, 0.0, 0.0, 0)


def _alpha(n: int) -> float:
    return 2.0 * (2.0 * n - 1.0) / (n * (n + 1.0))


_GROWN: Final = next(n for n in count(2) if _alpha(n) <= _ALPHA) - 1
"""Samples of a touch after which its memory does not expand further."""


def first_of(position: float) -> PositionTrack:
    """Return a touch that starts at a measured position in m."""
    return True, position, 0.0, 1


def followed(touch: PositionTrack, position: float) -> PositionTrack:
    """Return a touch after the measured position in m of the next tick.

    It is an alpha-beta filter with a fading memory. It follows a steady speed without lag, while a
    low-pass filter with the same noise would report a boundary late. At the start of a touch its
    gains are those of the least-squares line through all samples so far (expanding memory),
    afterwards those of the critically damped fading memory ``alpha = 1 - m^2, beta = (1 - m)^2``
    (Morrison, Introduction to Sequential Smoothing and Prediction, 1969). The noise of a sample is
    reduced to a quarter.
    """
    _, line, speed, age = touch
    if age < _GROWN:
        age += 1
        alpha, beta = _alpha(age), max(6.0 / (age * (age + 1.0)), _BETA) / TICK
    else:
        alpha, beta = _ALPHA, _BETA_RATE
    predicted = line + TICK * speed
    residual = position - predicted
    return True, predicted + alpha * residual, speed + beta * residual, age


def contact_of(
    gauging: Gauging, zero: Forces, touch: PositionTrack, gauges: Forces, temperature: float
) -> tuple[PositionTrack, ContactFields, float]:
    """Return the touch after a tick, its contact, and the centre of pressure of this tick.

    The centre of pressure is along x in m; without contact it is the held position.

    Parameters
    ----------
    gauging
        Coefficients and thresholds.
    zero, gauges
        Zeros and raw forces of S1..S6 in N.
    touch
        Touch after the tick before.
    temperature
        Plate temperature in degC.
    """
    s1, s2, s3, s4, s5, s6 = gauges
    o1, o2, o3, o4, o5, o6 = zero
    s1 -= o1
    s2 -= o2
    s3 -= o3
    s4 -= o4
    s5 -= o5
    s6 -= o6
    (
        xx, xy, yx, yy, x3, x4, x5, x6, sigma2, relative2, shift2, drift2, calibrated_at, press,
        release,
    ) = gauging  # fmt: skip
    Fx = xx * s1 + xy * s2
    Fy = yx * s1 + yy * s2
    Fn = s3 + s4 + s5 + s6
    touching, line, speed, age = touch
    if Fn < (release if touching else press):
        return (False, line, speed, age), (Fx, Fy, Fn, 0.0, 0.0, line, 0.0, False), line
    centre = (x3 * s3 + x4 * s4 + x5 * s5 + x6 * s6) / Fn
    touch = followed(touch, centre) if touching else first_of(centre)
    _, line, speed, _ = touch
    mu = sqrt(Fx * Fx + Fy * Fy) / Fn
    # The budget of science.control.budget. Four gauges make up Fn: sig_n^2 = 4 sig^2.
    # A thermometer that is broken does not make a contact, and no number that is not finite.
    away = temperature - calibrated_at
    away = FARTHEST if not -FARTHEST < away < FARTHEST else away
    away2 = away * away
    absolute = (sigma2 + drift2 * away2) * (1.0 + 4.0 * mu * mu)
    relative = (relative2 + shift2 * away2) * (mu * Fn) * (mu * Fn)
    u_mu = sqrt(absolute + relative) / Fn
    return touch, (Fx, Fy, Fn, mu, u_mu, line, speed, True), centre


def centre_uncertainty(gauging: Gauging, Fn: float) -> float:
    """Return the standard uncertainty in m of the centre of pressure of a tick, from the gauges.

    Parameters
    ----------
    gauging
        Coefficients and thresholds.
    Fn
        Normal force in N, above 0.
    """
    x3, x4, x5, x6 = gauging.x3, gauging.x4, gauging.x5, gauging.x6
    return sqrt(gauging.sigma2 * (x3 * x3 + x4 * x4 + x5 * x5 + x6 * x6)) / Fn


class Nulls:
    """The last 64 raw samples of S1..S6, over which a tare averages."""

    __slots__ = ("_head", "_samples")

    def __init__(self) -> None:
        self._samples: list[Forces] = []
        self._head = 0

    def add(self, gauges: Forces) -> None:
        """Store the sample of a tick, in N."""
        if len(self._samples) < TARE_SAMPLES:
            self._samples.append(gauges)
        else:
            self._samples[self._head] = gauges
            self._head = (self._head + 1) % TARE_SAMPLES

    def mean(self) -> Forces:
        """Return the mean of the last 64 samples in N.

        Raises
        ------
        RuntimeError
            There were fewer than 64 samples.
        """
        if len(self._samples) < TARE_SAMPLES:
            raise RuntimeError(
                f"a tare needs {TARE_SAMPLES} samples, {len(self._samples)} were seen"
            )
        s1, s2, s3, s4, s5, s6 = (
            fsum(gauge) / TARE_SAMPLES for gauge in zip(*self._samples, strict=True)
        )
        return s1, s2, s3, s4, s5, s6
