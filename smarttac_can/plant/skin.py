"""The skin between bone and plate: mass, spring, damper, and friction of the Dahl type.

``skin_mass v' = k stretch + b (v_bone - v) - F z``, ``stretch' = v_bone - v``,
``z' = (v - |v| z)/relaxation_length``. A step is implicit (backward Euler) in all three. The
equation for the new v is monotone and quadratic on each side of 0, so it is solved in closed form.

F is that of the v before the step, so its dependence on v is explicit. While F is constant a step
is stable at any length. A full slide (z = 1) is stable only while
``dF/dv < 2 skin_mass/step + b + k step/2``; beyond that v swings from step to step.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from smarttac_can.plant.subjects import Subject


class Skin(NamedTuple):
    """The skin of a fingertip."""

    mass: float
    """In kg."""
    k: float
    """Stiffness in N/m."""
    b: float
    """Damping in N s/m."""
    L: float
    """Relaxation length in m."""


SkinStep = tuple[float, float, float, float, float, float, float, float]
"""What is constant over steps of equal length."""


def skin_of(subject: Subject) -> Skin:
    """Return the skin of a subject."""
    s = subject
    return Skin(s.skin_mass, s.skin_stiffness, s.skin_damping, s.relaxation_length)


def skin_step(skin: Skin, duration: float, v_bone: float, bare: float) -> SkinStep:
    """Prepare steps.

    Parameters
    ----------
    skin
        The skin.
    duration
        Length of a step in s.
    v_bone
        Velocity of the finger's bone in m/s.
    bare
        Friction without vibration in N, 0 or more; 0 is a lifted finger.
    """
    mass, k, b, L = skin
    give = b + duration * k
    inertia = (mass + duration * give) * L / duration
    touches = 1.0 if bare > 0.0 else 0.0
    return duration, v_bone, mass, k, L, give * v_bone, inertia, touches


def slide(
    step: SkinStep, v: float, stretch: float, z: float, F: float
) -> tuple[float, float, float, float]:
    """Return velocity, stretch and friction state after a step, and the friction force in N.

    Parameters
    ----------
    step
        Of `skin_step`.
    v
        Sliding velocity in m/s.
    stretch
        In m.
    z
        Friction state, -1..1.
    F
        Friction in N at full slide, 0 or more.
    """
    duration, v_bone, mass, k, L, pull, inertia, touches = step
    # (mass + h b + h^2 k) v + h F z(v) = impulse, with u = |v| h/L the unknown.
    impulse = mass * v + duration * (k * stretch + pull)
    hold = duration * F
    push = impulse - hold * z
    sign = 1.0 if push > 0.0 else -1.0
    ahead = sign * push
    q = inertia + hold - sign * impulse
    total = abs(q) + sqrt(q * q + 4.0 * inertia * ahead)
    # Of the two forms of the root, the one without cancellation.
    u = 2.0 * ahead / total if q > 0.0 else total / (2.0 * inertia)
    advance = sign * u
    v = advance * L / duration
    z = (z + advance) / (1.0 + u) * touches
    return v, stretch + duration * (v_bone - v), z, F * z
