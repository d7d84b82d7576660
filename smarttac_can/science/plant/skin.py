"""The skin between bone and plate: mass, spring, damper, and friction of the Dahl type.

``skin_mass v' = k stretch + b (v_bone - v) - F(|v|) z``, ``stretch' = v_bone - v``,
``z' = (v - |v| z)/relaxation_length``. A step is Alexander's SDIRK of second order (SIAM J. Numer.
Anal. 14, 1977, doi:10.1137/0714068): two implicit stages of equal length, the second from a point
beyond the first. F is its tangent over speed and vibration at the start of the step, so the
equation of a stage for the new v is quadratic on each side of 0, monotone, and solved in closed
form.

A slide is stable at any length of a step. Where friction falls with speed more steeply than half of
what mass, spring and damper hold against it in a stage, that half is the slope of the tangent.
"""

from __future__ import annotations

from math import sqrt
from typing import Final, NamedTuple

from smarttac_can.science.plant.friction import FrictionMap, sliding_friction
from smarttac_can.science.plant.subjects import Subject

GAMMA: Final = 1.0 - sqrt(0.5)
"""Length of a stage as a fraction of the step."""
BEYOND: Final = 1.0 + sqrt(2.0)
"""Where the second stage starts: ``(1 - GAMMA)/GAMMA`` of the way that the first one covered."""


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


class SkinStep(NamedTuple):
    """What is constant over steps of equal length."""

    duration: float
    """Duration of a stage in s."""
    v_bone: float
    mass: float
    k: float
    L: float
    limit: float
    """Speed in m/s that covers L in a stage."""
    pull: float
    """Force in N of spring and damper at rest on a bone that moves."""
    inertia: float
    """What mass, spring and damper hold against ``u = |v|/limit``, in N s."""
    least_slope: float
    """Least slope of the friction over speed in N s/m that keeps a stage monotone."""


SkinState = tuple[float, float, float, float]
"""Sliding velocity in m/s, stretch in m, friction state z -1..1, friction force in N."""


def skin_of(subject: Subject) -> Skin:
    """Return the skin of a subject."""
    s = subject
    return Skin(s.skin_mass, s.skin_stiffness, s.skin_damping, s.relaxation_length)


def skin_step(skin: Skin, duration: float, v_bone: float) -> SkinStep:
    """Prepare steps.

    Parameters
    ----------
    skin
        The skin.
    duration
        Length of a step in s.
    v_bone
        Velocity of the finger's bone in m/s.
    """
    mass, k, b, L = skin
    stage = GAMMA * duration
    give = b + stage * k
    limit = L / stage
    inertia = (mass + stage * give) * limit
    least_slope = -0.5 * inertia / L
    return SkinStep(stage, v_bone, mass, k, L, limit, give * v_bone, inertia, least_slope)


def slide(
    step: SkinStep, friction: FrictionMap, bare: float, Ws: tuple[float, float], skin: SkinState
) -> SkinState:
    """Return the skin after a step.

    Parameters
    ----------
    step
        Of `skin_step`.
    friction
        Friction map of the subject.
    bare
        Friction without vibration in N, 0 or more; 0 is a lifted finger.
    Ws
        Vibration at the finger in m, before and after the step.
    skin
        The skin before the step.
    """
    v0, stretch0, z0, _ = skin
    W0, W1 = Ws
    F, slope, per_W = sliding_friction(friction, bare, 0.5 * (W0 + W1), abs(v0))
    slope = max(slope, step.least_slope)
    change = per_W * (W1 - W0)
    F0 = F - slope * abs(v0) + (GAMMA - 0.5) * change
    v, stretch, z = _stage(step, v0, stretch0, z0, F0, slope)
    F0 += (1.0 - GAMMA) * change
    v, stretch, z = _stage(
        step,
        v0 + BEYOND * (v - v0),
        stretch0 + BEYOND * (stretch - stretch0),
        z0 + BEYOND * (z - z0),
        F0,
        slope,
    )
    if bare == 0.0:
        return v, stretch, 0.0, 0.0
    # A tangent leaves the range of the friction, if the step is long.
    least, most = bare * friction.rho, bare * (1.0 + friction.rise)
    return v, stretch, z, max(least, min(most, F0 + slope * abs(v))) * z


def _stage(
    step: SkinStep, v: float, stretch: float, z: float, F0: float, slope: float
) -> tuple[float, float, float]:
    """Return v, stretch and z after backward Euler, with a friction of ``F0 + slope |v|``."""
    duration, v_bone, mass, k, L, limit, pull, inertia, _ = step
    # (mass + h b + h^2 k) v + h F(|v|) z(v) = impulse, with u = |v|/limit the unknown.
    impulse = mass * v + duration * (k * stretch + pull)
    hold = duration * F0
    steep = slope * L
    push = impulse - hold * z
    sign = 1.0 if push > 0.0 else -1.0
    ahead = sign * push
    q = inertia + hold + sign * (steep * z - impulse)
    square = inertia + steep
    total = abs(q) + sqrt(q * q + 4.0 * square * ahead)
    # Of the two forms of the root, the one without cancellation.
    u = 2.0 * ahead / total if q > 0.0 else total / (2.0 * square)
    advance = sign * u
    v = advance * limit
    # A step that is long beside the relaxation length would go beyond a full slide.
    z = max(-1.0, min(1.0, (z + advance) / (1.0 + u)))
    return v, stretch + duration * (v_bone - v), z
