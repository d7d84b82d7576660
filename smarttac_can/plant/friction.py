"""The friction map: how vibration, speed and force make the friction of a sliding finger."""

from __future__ import annotations

import math
from collections.abc import Callable

from smarttac_can.plant.mathematics import SCALAR, Float, Mathematics
from smarttac_can.plant.subjects import FORCE_REFERENCE, Subject

SPEED_FLOOR = 1e-12
"""In m/s: keeps 0/0 out of the effective vibration at rest, far below any speed that matters."""
_REACH_GRID = 5


def bare_friction(
    m: Mathematics[Float], subject: Subject[Float], Fn: Float, occlusion: Float
) -> Float:
    """Return the sliding friction without vibration, mu0(Fn, h) Fn, in N.

    Written as a force, ``k Fn^n (1 + occlusion h)``, it stays finite down to no contact.

    Parameters
    ----------
    m
        Mathematics of the other arguments.
    subject
        The fingertip.
    Fn
        Normal force in N, 0 or more.
    occlusion
        Degree of occlusion h, 0..1.
    """
    n = subject.exponent
    relative = m.power(Fn / FORCE_REFERENCE, n)
    return subject.mu0 * FORCE_REFERENCE * relative * (1.0 + subject.occlusion * occlusion)


def sliding_friction(
    m: Mathematics[Float], subject: Subject[Float], f0: float
) -> Callable[[Float, Float, Float], Float]:
    """Make the friction map of a subject: from bare friction, vibration and speed to a force in N.

    The vibration leaves the share ``g = rho + (1 - rho) exp(-(We/W0)^p)``, rho..1, with
    ``We = W/(1 + v/v1)``, ``v1 = mu0 pi f0 W``; at low speed friction is higher by up to the
    factor stribeck.

    Parameters
    ----------
    m
        Mathematics of the other arguments.
    subject
        The fingertip.
    f0
        Frequency of the vibration in Hz.

    Returns
    -------
    callable
        Of the bare friction in N, the vibration W in m peak-to-peak and the sliding speed v in m/s,
        all 0 or more.
    """
    # What follows from the subject alone is worked out here: the plate asks four times a tick.
    exp, power = m.exp, m.power
    v1_per_W = subject.mu0 * (math.pi * f0)
    W0, p, rho = subject.W0, subject.p, subject.rho
    rest = 1.0 - rho
    rise, v_s = subject.stribeck - 1.0, subject.stribeck_speed

    def friction(bare: Float, W: Float, v: Float) -> Float:
        v1 = v1_per_W * W
        We = W * v1 / (v1 + v + SPEED_FLOOR)
        r = v / v_s
        return bare * (rho + rest * exp(-power(We / W0, p))) * (1.0 + rise / (1.0 + r * r))

    return friction


def sliding_coefficient(
    m: Mathematics[Float],
    subject: Subject[Float],
    W: Float,
    v: Float,
    Fn: Float,
    occlusion: Float,
    *,
    f0: float,
) -> Float:
    """Return the COF of a steady slide; the arguments are those of the functions above, Fn > 0."""
    bare = bare_friction(m, subject, Fn, occlusion)
    return sliding_friction(m, subject, f0)(bare, W, v) / Fn


def check_reach(
    subject: Subject[float],
    mu_low: float,
    mu_high: float,
    *,
    forces: tuple[float, float] = (0.4, 0.6),
    speeds: tuple[float, float] = (0.048, 0.072),
    W_max: float = 3e-6,
    f0: float = 43390.0,
) -> None:
    """Refuse a subject whose friction cannot be brought to both references.

    Over all forces, speeds and degrees of occlusion, ``mu(W_max) < 0.95 mu_low`` and
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
        Largest vibration that the controller asks for, in m peak-to-peak.
    f0
        Frequency of the vibration in Hz.

    Raises
    ------
    ValueError
        If a reference is out of reach, with the COF that is.
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
    lowest = max(sliding_coefficient(SCALAR, subject, W_max, *corner, f0=f0) for corner in corners)
    highest = min(sliding_coefficient(SCALAR, subject, 0.0, *corner, f0=f0) for corner in corners)
    if not lowest < 0.95 * mu_low:
        raise ValueError(f"{subject.name}: COF {lowest:.3f} is not below 0.95 x {mu_low:g}")
    if not highest > 1.05 * mu_high:
        raise ValueError(f"{subject.name}: COF {highest:.3f} is not above 1.05 x {mu_high:g}")
