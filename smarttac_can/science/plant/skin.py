"""The skin between bone and plate: mass, spring, damper, and a friction that acts as it slides.

``mass v' = k (stretch - creep) + b (v_bone - v) - Ft``, ``stretch' = v_bone - v``,
``Ft' = (v F - |v| Ft)/L`` and ``creep' = (creep_ratio (stretch - creep) - creep)/creep_time``.

F is the friction of steady sliding by the friction map, and Ft the one that acts. At rest it grows
with the way of the skin by F/L, as in Dahl's model. While the skin slides at v, a change of F acts
with a first-order lag of cut-off ``v/(2 pi L)``. With L = 11.5 um that is the 13.8 Hz per mm/s that
ten fingers had at 20 to 100 mm/s and 0.2 to 0.6 N (Balasubramanian, Pool, Vardar 2025,
arXiv:2505.11162). If the lag were that of a state z with ``Ft = F z``, a change of F would act at
once.

By these equations a contact that rests would hold a stretch for ever when vibration lowers F below
Ft. So what Ft has above F decays with the time constant `Skin.release_time`, at rest, too. It takes
the skin some um until it slides, which ends it much sooner.

The moving mass and the stiffness that the same paper found to grow with speed, by 3.2e-5 kg and
4.0 N/m per mm/s, are not in: 1.9 g at 60 mm/s is twenty times the 0.1 g of a finger that does
not slide.

A step is Alexander's SDIRK of second order (SIAM J. Numer. Anal. 14, 1977, doi:10.1137/0714068):
two implicit stages of equal length, the second from a point beyond the first. F is its tangent over
speed and vibration at the start of the step, so the equation of a stage for the new v is quadratic
on each side of 0, monotone, and solved in closed form. The mean of Ft over a step has the weights
of the stages, so that the impulse of a step is right even if it is long beside ``L/v``.

A slide is stable at any length of a step. Where friction falls with speed more steeply than half of
what mass, spring and damper hold against it in a stage, that half is the slope of the tangent.
"""

from __future__ import annotations

from math import copysign, exp, sqrt
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
    creep_ratio: float
    """Ratio of the stretch that follows a force slowly to that of the spring k."""
    creep_time: float
    """Time constant in s of the former."""
    release_time: float
    """Time constant in s with which a contact loses the force that friction does not hold."""


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
    creep_kept: float
    """Share of the creep that a stage keeps."""
    creep_gained: float
    """Share of the stretch that creep gains in a stage."""
    excess_kept: float
    """Share that a step leaves of the force that friction does not hold."""


SkinState = tuple[float, float, float, float]
"""Sliding velocity in m/s, stretch and creep in m, friction force on the plate in N."""


def skin_of(subject: Subject) -> Skin:
    """Return the skin of a subject."""
    s = subject
    return Skin(
        s.skin_mass,
        s.skin_stiffness,
        s.skin_damping,
        s.relaxation_length,
        s.creep_ratio,
        s.creep_time,
        s.release_time,
    )


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
    mass, k, b, L, creep_ratio, creep_time, release_time = skin
    stage = GAMMA * duration
    kept = creep_time / (creep_time + stage * (1.0 + creep_ratio))
    gained = kept * creep_ratio * stage / creep_time
    give = b + stage * k * (1.0 - gained)
    limit = L / stage
    inertia = (mass + stage * give) * limit
    return SkinStep(
        stage,
        v_bone,
        mass,
        k,
        L,
        limit,
        give * v_bone,
        inertia,
        -0.5 * inertia / L,
        kept,
        gained,
        exp(-duration / release_time),
    )


def slide(
    step: SkinStep, friction: FrictionMap, bare: float, Ws: tuple[float, float], skin: SkinState
) -> tuple[SkinState, float]:
    """Return the skin after a step, and the mean of the friction force over the step in N.

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
    v0, stretch0, creep0, Ft0 = skin
    W0, W1 = Ws
    F, slope, per_W = sliding_friction(friction, bare, 0.5 * (W0 + W1), abs(v0))
    if bare == 0.0:
        Ft0 = 0.0
    elif abs(Ft0) > F:
        Ft0 = copysign(F + (abs(Ft0) - F) * step.excess_kept, Ft0)
    slope = max(slope, step.least_slope)
    change = per_W * (W1 - W0)
    F0 = F - slope * abs(v0) + (GAMMA - 0.5) * change
    # A tangent leaves the range of the friction, if the step is long.
    least, most = bare * friction.rho, bare * (1.0 + friction.rise)
    v, stretch, creep, Ft = _stage(step, (v0, stretch0, creep0, Ft0), (F0, slope, least, most))
    beyond = (
        v0 + BEYOND * (v - v0),
        stretch0 + BEYOND * (stretch - stretch0),
        creep0 + BEYOND * (creep - creep0),
        Ft0 + BEYOND * (Ft - Ft0),
    )
    first = Ft
    F0 += (1.0 - GAMMA) * change
    v, stretch, creep, Ft = _stage(step, beyond, (F0, slope, least, most))
    # The second stage starts beyond the first, where a contact may hold more than it ever does.
    bound = max(abs(Ft0), most)
    Ft = max(-bound, min(bound, Ft))
    return (v, stretch, creep, Ft), first + GAMMA * (Ft - first)


def _stage(
    step: SkinStep, start: SkinState, tangent: tuple[float, float, float, float]
) -> SkinState:
    """Return the skin after backward Euler.

    The tangent of the friction is ``F0 + slope |v|``, and is used between the last two numbers.
    """
    F0, slope, least, most = tangent
    duration, v_bone, mass, k, L, limit, pull, inertia, _, kept, gained, _ = step
    v, stretch, creep, Ft = start
    # (mass + h b + h^2 k) v + h Ft(v) = impulse, with u = |v|/limit the unknown,
    # and Ft(v) = (Ft +- u (F0 + slope |v|))/(1 + u).
    impulse = mass * v + duration * (k * ((1.0 - gained) * stretch - kept * creep) + pull)
    push = impulse - duration * Ft
    sign = 1.0 if push > 0.0 else -1.0
    ahead = sign * push
    q = inertia + duration * F0 - sign * impulse
    square = inertia + slope * L
    total = abs(q) + sqrt(q * q + 4.0 * square * ahead)
    # Of the two forms of the root, the one without cancellation.
    u = 2.0 * ahead / total if q > 0.0 else total / (2.0 * square)
    advance = sign * u
    v = advance * limit
    stretch += duration * (v_bone - v)
    Ft = (Ft + advance * max(least, min(most, F0 + slope * abs(v)))) / (1.0 + u)
    return v, stretch, kept * creep + gained * stretch, Ft
