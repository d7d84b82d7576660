"""Uncertainty budget of the coefficient of friction, as GUM 5.1.2 and 5.2.2 have it.

The measurement equation is ``mu = Ft/Fn``, so the sensitivity coefficients are ``dmu/dFt = 1/Fn``
and ``dmu/dFn = -mu/Fn``. Each component gives a standard uncertainty of Ft and of Fn, and their
correlation r:

    u^2(mu) = (u(Ft)^2 + mu^2 u(Fn)^2 - 2 r mu u(Ft) u(Fn))/Fn^2

Ft comes from one gauge, Fn from four that share it alike. What is independent in each of them adds
as squares: an absolute error counts twice in Fn, a relative one half. An error of the weights, or
of gravity, is the same in both (r = 1) and cancels.

A bound of a data sheet is taken as rectangular (GUM 4.3.7): its standard uncertainty is the bound
over the square root of 3.
"""

from __future__ import annotations

from math import hypot, sqrt
from typing import Final, NamedTuple

COVERAGE: Final = 2.0
"""Coverage factor of the expanded uncertainty, about 95 %."""
RELATIVE_OF_FOUR: Final = 0.5
"""Relative error of the sum of four alike gauges, beside that of each."""
HEAVIEST: Final = 2.0
"""Load in N at which the error of linearity is taken for the relative uncertainty of a sample."""
_ROOT3: Final = sqrt(3.0)


class Gauges(NamedTuple):
    """Standard uncertainties of a calibrated tribometer."""

    noise: float = 4.3e-3
    """Noise of one gauge in N."""
    repeatability: float = 98e-3 / (0.3 * 9.80665) / _ROOT3
    """Repeatability of a gauge as a fraction of its load [L, FSS1500: 98 mN at 300 g]."""
    sensitivity_t: float = 0.17 / _ROOT3
    """Relative error of Ft [L, FSS1500: 17 %]; a calibration replaces it."""
    sensitivity_n: float = 0.5 * 0.17 / _ROOT3
    """Relative error of Fn, of four gauges; a calibration replaces it."""
    weights: float = 1e-3
    """Relative error of the weights of the calibration, the same in Ft and Fn [A]."""
    drift: float = 41e-3 / 15.0 / _ROOT3
    """Drift of a gauge's null in N/K [L, FSS1500: 41 mN over 15 K]."""
    crosstalk: float = 0.0
    """Relative error of Ft by cross-talk, in the direction in which it is largest."""
    shift: float = 0.055 / 25.0 / _ROOT3
    """Shift of a gauge's sensitivity in 1/K [L, FSS1500: 5.5 % over 25 K]."""
    bow: float = 4.0 * 0.22 / 14.7**2 / _ROOT3
    """Curvature of a gauge in 1/N [L, FSS1500: 0.22 N over 14.7 N]."""


class Calibrated(NamedTuple):
    """What a calibration says of the uncertainty of the COF."""

    relative: float
    """Relative standard uncertainty at the temperature of the calibration, besides the noise."""
    shift: float
    """Relative standard uncertainty in 1/K away from that temperature."""
    drift: float
    """Standard uncertainty of a gauge's null in N/K away from that temperature."""
    temperature: float
    """Temperature of the calibration in degC."""


UNCALIBRATED: Final = Calibrated(0.0, 0.0, 0.0, 0.0)
"""No statement of a calibration: noise is all."""


class Component(NamedTuple):
    """Standard uncertainties of the forces from one cause."""

    Ft: float
    """Of Ft in N."""
    Fn: float
    """Of Fn in N."""
    correlation: float = 0.0
    """Correlation of both errors, -1..1."""

    def of_cof(self, mu: float, Fn: float) -> float:
        """Return the standard uncertainty of the COF from it, at a COF and normal force in N."""
        a, b = self.Ft, mu * self.Fn
        return sqrt(max(0.0, a * a + b * b - 2.0 * self.correlation * a * b)) / Fn


def components(gauges: Gauges, mu: float, Fn: float, warmer: float) -> dict[str, Component]:
    """Return the components of the budget by name.

    Parameters
    ----------
    gauges
        Standard uncertainties of the tribometer.
    mu
        Coefficient of friction.
    Fn
        Normal force in N, above 0.
    warmer
        Temperature of the plate above that of calibration and tare, in K.
    """
    g = gauges
    Ft = mu * Fn
    away = abs(warmer)
    return {
        "noise": Component(g.noise, 2.0 * g.noise),
        "repeatability": Component(g.repeatability * Ft, RELATIVE_OF_FOUR * g.repeatability * Fn),
        "sensitivity": Component(g.sensitivity_t * Ft, g.sensitivity_n * Fn),
        "weights": Component(g.weights * Ft, g.weights * Fn, 1.0),
        "drift": Component(g.drift * away, 2.0 * g.drift * away),
        "cross-talk": Component(g.crosstalk * Ft, 0.0),
        "temperature": Component(g.shift * away * Ft, RELATIVE_OF_FOUR * g.shift * away * Fn),
        "linearity": Component(g.bow * Ft * Ft, g.bow * Fn * Fn / 8.0),
    }


def budget(gauges: Gauges, mu: float, Fn: float, warmer: float = 0.0) -> dict[str, float]:
    """Return the standard uncertainties of the COF by component; parameters as `components`."""
    return {
        name: component.of_cof(mu, Fn)
        for name, component in components(gauges, mu, Fn, warmer).items()
    }


def combined(uncertainties: dict[str, float]) -> float:
    """Return the combined standard uncertainty of independent components."""
    return hypot(*uncertainties.values())


def stated(gauges: Gauges, temperature: float) -> Calibrated:
    """Return what a calibration at a temperature in degC says of each sample.

    Its relative uncertainty has repeatability, sensitivity and cross-talk, and the linearity of a
    load of 2 N with a COF of 1.
    """
    parts = budget(gauges, 1.0, HEAVIEST)
    names = ("repeatability", "sensitivity", "cross-talk", "linearity")
    return Calibrated(
        relative=hypot(*(parts[name] for name in names)),
        shift=gauges.shift * hypot(1.0, RELATIVE_OF_FOUR),
        drift=gauges.drift,
        temperature=temperature,
    )
