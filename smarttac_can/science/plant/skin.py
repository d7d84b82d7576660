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
from math import pow as power
from typing import Final, NamedTuple

from smarttac_can.science.plant.force_path import Propagator
from smarttac_can.science.plant.friction import SPEED_FLOOR, VIBRATION_FLOOR, FrictionMap
from smarttac_can.science.plant.resonator import Response
from smarttac_can.science.plant.subjects import Subject

GAMMA: Final = 1.0 - sqrt(0.5)
"""Length of a stage as a fraction of the step."""
BEYOND: Final = 1.0 + sqrt(2.0)
"""Where the second stage starts: ``(1 - GAMMA)/GAMMA`` of the way that the first one covered."""
_MIDDLE_TO_FIRST: Final = GAMMA - 0.5
"""From the middle of the step to the end of the first stage, as a fraction of the step."""
_FIRST_TO_SECOND: Final = 1.0 - GAMMA
_STAGES: Final = (False, True)
"""Whether a stage is the last one."""


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


Sliding = tuple[complex, complex, float, float, float, float, float, float, float]
"""Envelope of the vibration in m and its rate in m/s, vibration that acts on the skin in m, sliding
velocity in m/s, stretch and creep in m, friction force on the plate in N, and that force behind the
force path in N with its rate in N/s."""


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


def slide(  # noqa: PLR0915
    number: int,
    steps: tuple[Response, SkinStep, Propagator],
    contact: tuple[float, float, float, float],
    friction: FrictionMap,
    moving: Sliding,
) -> Sliding:
    """Return what moves after sub-steps of equal length: vibration, film, skin and force path.

    This is the innermost loop of the plant, so it calls no function of this package, and makes no
    tuple in a sub-step. Its parts are those of `resonator.vibrate`, `friction.sliding_friction` and
    `force_path.follow`.

    Parameters
    ----------
    number
        Number of sub-steps.
    steps
        A sub-step of the vibration, where ``(1, duration, 0, 1, 0)`` is a ramp; of `skin_step`;
        and one of the force path.
    contact
        Friction without vibration in N, 0 or more, where 0 is a lifted finger; ratio of the
        vibration at the finger to the envelope; lag of the squeeze film in sub-steps, and the share
        of its distance that it keeps in one.
    friction
        Friction map of the subject.
    moving
        What moves, before.
    """
    vibration, skin, path = steps
    p11, p12, p21, p22, equilibrium = vibration
    bare, shape, lag_steps, film_kept = contact
    _, _, _, v1_per_W, W_scale, p, rho, rise, v_s = friction
    (
        duration, v_bone, mass, k, L, limit, pull, inertia, least_slope, kept, gained, excess_kept,
    ) = skin  # fmt: skip
    yy, yr, ry, rr = path
    W, rate, acting, v, stretch, creep, Ft, Fx, Fx_rate = moving
    least, most, sprung = bare * rho, bare * (1.0 + rise), 1.0 - gained
    free = shape * abs(W)
    for _ in range(number):
        deviation = W - equilibrium
        W, rate = equilibrium + p11 * deviation + p12 * rate, p21 * deviation + p22 * rate

        # The film follows the vibration at the finger, a ramp, as a first-order lag.
        W0, free0, free = acting, free, shape * abs(W)
        late = lag_steps * (free - free0)
        acting = free - late + (W0 - free0 + late) * film_kept

        # Friction of steady sliding, and its tangent.
        mean, speed = 0.5 * (W0 + acting), abs(v)
        v1 = v1_per_W * mean
        per_speed = 1.0 / (v1 + speed + SPEED_FLOOR)
        x = power(mean * v1 * per_speed / W_scale, p)
        removable = (1.0 - rho) * exp(-x)
        r = speed / v_s
        slow = 1.0 / (1.0 + r * r)
        s = bare * (1.0 + rise * slow)
        F = (rho + removable) * s
        fall = s * removable * p * x
        per_W = -fall * (2.0 / (mean + VIBRATION_FLOOR) - v1_per_W * per_speed)
        slope = fall * per_speed - bare * (rho + removable) * rise * 2.0 * r / v_s * slow * slow
        slope = max(slope, least_slope)
        change = per_W * (acting - W0)

        if bare == 0.0:
            Ft = 0.0
        elif abs(Ft) > F:
            Ft = copysign(F + (abs(Ft) - F) * excess_kept, Ft)
        v0, stretch0, creep0, Ft0, first = v, stretch, creep, Ft, 0.0
        F0 = F - slope * speed + _MIDDLE_TO_FIRST * change
        for last in _STAGES:
            # Backward Euler: (mass + h b + h^2 k) v + h Ft(v) = impulse, with u = |v|/limit the
            # unknown, and Ft(v) = (Ft +- u (F0 + slope |v|))/(1 + u).
            impulse = mass * v + duration * (k * (sprung * stretch - kept * creep) + pull)
            push = impulse - duration * Ft
            sign = 1.0 if push > 0.0 else -1.0
            ahead = sign * push
            q = inertia + duration * F0 - sign * impulse
            square = inertia + slope * L
            total = abs(q) + sqrt(q * q + 4.0 * square * ahead)
            # Of the two forms of the root, the one without cancellation.
            u = 2.0 * ahead / total if q > 0.0 else total / (2.0 * square)
            v = sign * u * limit
            stretch += duration * (v_bone - v)
            creep = kept * creep + gained * stretch
            level = F0 + slope * abs(v)
            # A tangent leaves the range of the friction, if the step is long.
            level = most if level > most else least if level < least else level
            Ft = (Ft + sign * u * level) / (1.0 + u)
            if not last:
                first = Ft
                v = v0 + BEYOND * (v - v0)
                stretch = stretch0 + BEYOND * (stretch - stretch0)
                creep = creep0 + BEYOND * (creep - creep0)
                Ft = Ft0 + BEYOND * (Ft - Ft0)
                F0 += _FIRST_TO_SECOND * change
        # The second stage starts beyond the first, where a contact may hold more than it ever does.
        bound = abs(Ft0) if abs(Ft0) > most else most
        Ft = bound if Ft > bound else -bound if Ft < -bound else Ft

        # The force path gets the mean of the friction force over the sub-step.
        force = first + GAMMA * (Ft - first)
        behind = Fx - force
        Fx, Fx_rate = force + yy * behind + yr * Fx_rate, ry * behind + rr * Fx_rate
    return W, rate, acting, v, stretch, creep, Ft, Fx, Fx_rate
