"""The friction map: friction of a sliding finger from vibration, speed and force."""

from __future__ import annotations

from math import exp, pi
from math import pow as power
from typing import NamedTuple

from smarttac_can.science.plant.subjects import FORCE_REFERENCE, Subject

SPEED_FLOOR = 1e-12
"""Speed in m/s that avoids 0/0 in the effective vibration at rest, far below real speeds."""
VIBRATION_FLOOR = 1e-15
"""Vibration in m that avoids 0/0 in the slope over it."""
_REACH_GRID = 5


class FrictionMap(NamedTuple):
    """Coefficients of the friction of a subject."""

    at_reference: float
    """Friction in N at 0.5 N, without vibration and occlusion."""
    exponent: float
    occlusion: float
    v1_per_W: float
    """``mu0 pi f0`` in 1/s."""
    W0: float
    p: float
    rho: float
    rise: float
    """Stribeck ratio minus 1."""
    v_s: float
    """Stribeck speed in m/s."""


def friction_map(subject: Subject, f0: float) -> FrictionMap:
    """Return the friction map of a subject at a vibration frequency in Hz."""
    s = subject
    return FrictionMap(
        s.mu0 * FORCE_REFERENCE,
        s.exponent,
        s.occlusion,
        s.mu0 * (pi * f0),
        s.W0,
        s.p,
        s.rho,
        s.stribeck - 1.0,
        s.stribeck_speed,
    )


def bare_friction(friction: FrictionMap, Fn: float, occlusion: float) -> float:
    """Return the sliding friction without vibration, mu0(Fn, h) Fn, in N.

    As a force, ``k Fn^n (1 + occlusion h)``, it is finite without contact, too.

    Parameters
    ----------
    friction
        Friction map of the subject.
    Fn
        Normal force in N, 0 or more.
    occlusion
        Degree of occlusion h, 0..1.
    """
    relative = power(Fn / FORCE_REFERENCE, friction.exponent)
    return friction.at_reference * relative * (1.0 + friction.occlusion * occlusion)


def sliding_friction(
    friction: FrictionMap, bare: float, W: float, v: float
) -> tuple[float, float, float]:
    """Return the friction of a sliding finger in N, and its slopes over speed and vibration.

    The slopes are in N s/m and N/m.

    The vibration reduces it by the factor ``g = rho + (1 - rho) exp(-(We/W0)^p)``, rho..1, with
    ``We = W/(1 + v/v1)``, ``v1 = mu0 pi f0 W``. At low speed friction is higher, by up to the
    factor stribeck.

    Parameters
    ----------
    friction
        Friction map of the subject.
    bare
        Friction without vibration in N, 0 or more.
    W
        Vibration in m peak-to-peak, 0 or more.
    v
        Sliding speed in m/s, 0 or more.
    """
    _, _, _, v1_per_W, W0, p, rho, rise, v_s = friction
    v1 = v1_per_W * W
    per_speed = 1.0 / (v1 + v + SPEED_FLOOR)
    x = power(W * v1 * per_speed / W0, p)
    removable = (1.0 - rho) * exp(-x)
    r = v / v_s
    slow = 1.0 / (1.0 + r * r)
    s = bare * (1.0 + rise * slow)
    F = (rho + removable) * s
    fall = s * removable * p * x
    return (
        F,
        fall * per_speed - bare * (rho + removable) * rise * 2.0 * r / v_s * slow * slow,
        -fall * (2.0 / (W + VIBRATION_FLOOR) - v1_per_W * per_speed),
    )


def sliding_coefficient(
    subject: Subject, W: float, v: float, Fn: float, occlusion: float, *, f0: float
) -> float:
    """Return the COF of steady sliding; the arguments are as in the functions above, Fn > 0."""
    friction = friction_map(subject, f0)
    return sliding_friction(friction, bare_friction(friction, Fn, occlusion), W, v)[0] / Fn


def check_reach(
    subject: Subject,
    mu_low: float,
    mu_high: float,
    *,
    forces: tuple[float, float] = (0.4, 0.6),
    speeds: tuple[float, float] = (0.048, 0.072),
    W_max: float = 3e-6,
    f0: float = 43390.0,
) -> None:
    """Check that the friction of a subject can be brought to both references.

    For all forces, speeds and degrees of occlusion, ``mu(W_max) < 0.95 mu_low`` and
    ``mu(0) > 1.05 mu_high`` must hold.

    Parameters
    ----------
    subject
        The fingertip.
    mu_low, mu_high
        Lower and upper reference of the COF.
    forces
        Range of the normal force in N, above 0.
    speeds
        Range of the sliding speed in m/s.
    W_max
        Largest vibration that the controller commands, in m peak-to-peak.
    f0
        Frequency of the vibration in Hz.

    Raises
    ------
    ValueError
        A reference is out of reach; the message gives the COF that can be reached.
    """
    share = [number / (_REACH_GRID - 1) for number in range(_REACH_GRID)]
    corners = [
        (
            speeds[0] + (speeds[1] - speeds[0]) * by_speed,
            forces[0] + (forces[1] - forces[0]) * by_force,
            occlusion,
        )
        for by_speed in share
        for by_force in share
        for occlusion in (0.0, 1.0)
    ]
    lowest = max(sliding_coefficient(subject, W_max, *corner, f0=f0) for corner in corners)
    highest = min(sliding_coefficient(subject, 0.0, *corner, f0=f0) for corner in corners)
    if not lowest < 0.95 * mu_low:
        raise ValueError(f"{subject.name}: COF {lowest:.3f} is not below 0.95 x {mu_low:g}")
    if not highest > 1.05 * mu_high:
        raise ValueError(f"{subject.name}: COF {highest:.3f} is not above 1.05 x {mu_high:g}")
