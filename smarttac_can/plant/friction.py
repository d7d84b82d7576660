"""The friction map: how vibration, speed and force make the friction of a sliding finger."""

from __future__ import annotations

import math

from smarttac_can.plant.mathematics import Float, Mathematics
from smarttac_can.plant.subjects import FORCE_REFERENCE, Subject

SPEED_FLOOR = 1e-12
"""In m/s: keeps 0/0 out of the effective vibration at rest, far below any speed that matters."""


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


def reduction(
    m: Mathematics[Float], subject: Subject[Float], W: Float, v: Float, f0: float
) -> Float:
    """Return g, the share of the bare friction left by the vibration, rho..1.

    ``g = rho + (1 - rho) exp(-(We/W0)^p)`` with ``We = W/(1 + v/v1)``, ``v1 = mu0 pi f0 W``.

    Parameters
    ----------
    m
        Mathematics of the other arguments.
    subject
        The fingertip.
    W
        Vibration in m peak-to-peak, 0 or more.
    v
        Sliding speed in m/s, 0 or more.
    f0
        Frequency of the vibration in Hz.
    """
    v1 = subject.mu0 * (math.pi * f0) * W
    We = W * v1 / (v1 + v + SPEED_FLOOR)
    rho = subject.rho
    return rho + (1.0 - rho) * m.exp(-m.power(We / subject.W0, subject.p))


def stribeck(subject: Subject[Float], v: Float) -> Float:
    """Return the factor by which friction is higher at a sliding speed v in m/s, 1..stribeck."""
    r = v / subject.stribeck_speed
    return 1.0 + (subject.stribeck - 1.0) / (1.0 + r * r)


def sliding_coefficient(
    m: Mathematics[Float],
    subject: Subject[Float],
    W: Float,
    v: Float,
    Fn: Float,
    occlusion: Float,
    f0: float,
) -> Float:
    """Return the COF of a steady slide; the arguments are those of the functions above, Fn > 0."""
    bare = bare_friction(m, subject, Fn, occlusion)
    return bare * reduction(m, subject, W, v, f0) * stribeck(subject, v) / Fn
