"""One tick of the plate with the finger on it, in plain functions of floats and named tuples.

`plate_step` moves plate, film, skin and finger by a tick, with the drives of that tick, and reads
the sensors at its end. Numba and mypyc compile it as it stands. The amplitude at the finger follows
``shape |W|`` with the lag of the squeeze film; its step is exact for a vibration that is a ramp.
"""

from __future__ import annotations

import math
from builtins import complex  # mypyc finds it by name in a named tuple
from collections.abc import Sequence
from typing import Final, NamedTuple

from smarttac_can.science.plant.force_path import Propagator, follow, propagator
from smarttac_can.science.plant.friction import (
    FrictionMap,
    bare_friction,
    friction_map,
)
from smarttac_can.science.plant.parameters import (
    TWO_PI,
    ContactParameters,
    PlateParameters,
    ResonatorParameters,
    resonance_at,
    stiffness_of,
)
from smarttac_can.science.plant.resonator import (
    Response,
    integral,
    rate_in_frame,
    response,
    vibrate,
)
from smarttac_can.science.plant.sensors import Sensing, readings
from smarttac_can.science.plant.skin import Skin, skin_of, skin_step, slide
from smarttac_can.science.plant.subjects import FORCE_REFERENCE, Subject
from smarttac_can.vocabulary.signals import TICK, Drive, MeasurementFields

SUBSTEPS: Final = 5
"""Sub-steps of a tick, by the convergence test."""
LEAST_RESONANCE: Final = 0.5
"""Fraction of the resonance at rest to which softening lowers it at most."""
HARDEST: Final = 10.0
"""Largest normal force of a finger in N."""
CONTACT_GROWTH: Final = 2.0 / 3.0
"""Exponent of the contact area, and with it the finger's load on the mode, over force [A]: that of
a sphere on a plane (Hertz)."""


Finger = tuple[float, float]
"""Position in m and normal force in N."""


class Segment(NamedTuple):
    """A part of a tick under one drive, in sub-steps of equal length."""

    number: int
    length: float
    """In s."""
    path: Propagator
    film_kept: float
    """Share of its distance from the vibration that the film keeps in a sub-step."""
    low_kept: float
    """Share of its distance from its input that the pick-up's filter keeps in a sub-step."""
    read: bool
    """Whether it is in the pick-up's window."""
    new: bool
    """Whether the new drive is in force."""


class ModeCoefficients(NamedTuple):
    """The vibration mode without a finger."""

    m: float
    conversion: float
    damping: float
    f0: float
    f0_slope: float
    reference_temperature: float
    softening: float
    neighbour_share: float
    neighbour_offset: float


class Fingertip(NamedTuple):
    """What is constant under the finger."""

    friction: FrictionMap
    skin: Skin
    film_lag: float


class Coefficients(NamedTuple):
    """Numbers that follow from plate and fingertip, and where they are."""

    mode: ModeCoefficients
    fingertip: Fingertip
    load_damping: float
    load_stiffness: float
    segments: tuple[Segment, Segment, Segment]
    window: float
    lag: float
    exact: bool
    """Whether the pick-up reads the mode as it is at the tick."""
    normal: Propagator
    ripple: float
    node_distance: float
    ambient: float
    resistance: float
    warming: float
    wetting: float


class PickUp(NamedTuple):
    """Neighbouring mode and what the pick-up sees, if it is not `Coefficients.exact`."""

    W: complex
    """Envelope of the neighbouring mode in m."""
    rate: complex
    low: complex
    """Both modes behind the filter in m."""
    sum: complex
    """Integral of that over the window in m s, so far."""
    seen: complex
    """What it reads in m, before its noise."""


class Motion(NamedTuple):
    """What moves within a tick."""

    W: complex
    rate: complex
    omega: float
    """Angular frequency of the frame in rad/s."""
    acting: float
    """Vibration that acts on the skin, in m."""
    v: float
    stretch: float
    creep: float
    Ft: float
    """Friction force on the plate in N."""
    Fx: float
    """Friction force behind the force path in N."""
    Fx_rate: float
    pickup: PickUp


class PlatePlan(NamedTuple):
    """Parameters of a step of the plate."""

    coefficients: Coefficients
    sensing: Sensing


class PlateState(NamedTuple):
    """The plate at a tick; forces and moment are those after the force path."""

    motion: Motion
    Fn: float
    Fn_rate: float
    moment: float
    moment_rate: float
    temperature: float
    occlusion: float


def coefficients(
    parameters: PlateParameters,
    subject: Subject,
    *,
    ambient: float,
    dead_time: float,
    sound_f0: float,
) -> Coefficients:
    """Return the coefficients of a plate and a fingertip.

    Parameters
    ----------
    parameters
        The plate.
    subject
        The fingertip.
    ambient
        Ambient temperature in degC.
    dead_time
        Time in s from the start of a tick until the new drive is in force.
    sound_f0
        Frequency in Hz at which the finger is vibrated; a broken plate resonates elsewhere.

    Raises
    ------
    ValueError
        Under a finger a mode would not oscillate.
    """
    p, mode, contact = parameters, parameters.resonator, parameters.contact
    sensors = p.sensors
    _require_oscillation(mode, contact, subject)
    return Coefficients(
        ModeCoefficients(
            mode.mass,
            mode.conversion,
            mode.damping,
            mode.f0,
            mode.f0_slope,
            mode.reference_temperature,
            mode.softening,
            mode.neighbour_share,
            mode.neighbour_offset,
        ),
        Fingertip(friction_map(subject, sound_f0), skin_of(subject), contact.film_lag),
        subject.load_damping,
        subject.load_stiffness,
        _segments(p, dead_time),
        sensors.pickup_window,
        sensors.pickup_lag,
        not (sensors.pickup_window or sensors.pickup_lag or mode.neighbour_share),
        propagator(TICK, sensors.path_frequency, sensors.path_damping),
        contact.ripple,
        contact.node_distance,
        ambient,
        p.thermal.resistance,
        -math.expm1(-TICK / p.thermal.time_constant),
        -math.expm1(-TICK / subject.occlusion_time),
    )


def _require_oscillation(
    mode: ResonatorParameters, contact: ContactParameters, subject: Subject
) -> None:
    load = (HARDEST / FORCE_REFERENCE) ** CONTACT_GROWTH * (1.0 + contact.ripple) ** 2
    damping = mode.damping + subject.load_damping * load
    lowest = LEAST_RESONANCE * (mode.f0 + min(mode.neighbour_offset, 0.0))
    most = 2.0 * TWO_PI * mode.mass * lowest
    if not damping < most:
        raise ValueError(
            f"damping {damping:.3g} N s/m under a finger of {HARDEST:g} N is not below {most:.3g}: "
            f"a mode of {mode.mass:g} kg at {lowest:.0f} Hz does not oscillate"
        )


def _segments(parameters: PlateParameters, dead_time: float) -> tuple[Segment, Segment, Segment]:
    """Divide a tick where the new drive takes force, and where the pick-up's window begins."""
    window = parameters.sensors.pickup_window
    begin = TICK - window
    if begin < dead_time:
        return (
            _segment(parameters, begin, new=False, read=False),
            _segment(parameters, dead_time - begin, new=False, read=True),
            _segment(parameters, TICK - dead_time, new=True, read=True),
        )
    return (
        _segment(parameters, dead_time, new=False, read=False),
        _segment(parameters, begin - dead_time, new=True, read=False),
        _segment(parameters, window, new=True, read=True),
    )


def _segment(parameters: PlateParameters, duration: float, *, new: bool, read: bool) -> Segment:
    """Divide a part of a tick of a duration in s."""
    number = math.ceil(SUBSTEPS * duration / TICK - 1e-9)
    length = duration / number if number else 0.0
    sensors = parameters.sensors
    return Segment(
        number,
        length,
        propagator(length, sensors.path_frequency, sensors.path_damping),
        lag_kept(length, parameters.contact.film_lag),
        lag_kept(length, sensors.pickup_lag),
        read,
        new,
    )


def at_rest(temperature: float) -> PlateState:
    """Return a plate that does not vibrate, without a finger, at a temperature in degC."""
    motion = Motion(
        0j, 0j, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, PickUp(0j, 0j, 0j, 0j, 0j)
    )  # fmt: skip
    return PlateState(motion, 0.0, 0.0, 0.0, 0.0, temperature, 0.0)


def plate_step(
    plan: PlatePlan,
    state: PlateState,
    drives: tuple[Drive, Drive],
    fingers: tuple[Finger, Finger],
    noise: Sequence[float],
) -> tuple[PlateState, MeasurementFields]:
    """Return the plate a tick later, and what its sensors report there.

    Parameters
    ----------
    plan, state
        The plate, and the tick before.
    drives
        For the dead time, and after it.
    fingers
        Position in m and normal force in N in the tick before and in this one.
    noise
        Of the sensors, as for `smarttac_can.science.plant.sensors.readings`.
    """
    state = _moved(plan.coefficients, state, drives, fingers)
    return state, measured(plan, state, noise)


def measured(plan: PlatePlan, state: PlateState, noise: Sequence[float]) -> MeasurementFields:
    """Return what the sensors report; the arguments are those of `plate_step`."""
    motion, Fn, _, moment, _, temperature, _ = state
    W = seen_W(plan.coefficients, motion)
    return readings(plan.sensing, noise, W, temperature, (motion.Fx, Fn, moment))


def seen_W(coefficients: Coefficients, motion: Motion) -> complex:
    """Return the vibration that the pick-up sees, before its noise and faults, in m."""
    return motion.W if coefficients.exact else motion.pickup.seen


def _moved(
    coefficients: Coefficients,
    state: PlateState,
    drives: tuple[Drive, Drive],
    fingers: tuple[Finger, Finger],
) -> PlateState:
    (
        mode, fingertip, load_damping, load_stiffness, segments, window, _, exact, normal,
        ripple, node_distance, ambient, resistance, warming, wetting,
    ) = coefficients  # fmt: skip
    _, _, damping, f0, f0_slope, reference_temperature, _, _, _ = mode
    motion, Fn_y, Fn_rate, moment, moment_rate, temperature, occlusion = state
    old, new = drives
    (x0, Fn0), (x1, Fn1) = fingers
    Fn = 0.5 * (Fn0 + Fn1)
    velocity = 0.5 * TWO_PI * f0 * abs(motion.W)
    target = ambient + resistance * (0.5 * damping * velocity * velocity)
    temperature += (target - temperature) * warming
    occlusion += ((1.0 if Fn > 0.0 else 0.0) - occlusion) * wetting
    load = (Fn / FORCE_REFERENCE) ** CONTACT_GROWTH
    shape = shape_at(0.5 * (x0 + x1), ripple, node_distance)
    load *= shape * shape
    resonance = resonance_at(f0, f0_slope, temperature - reference_temperature)
    loaded = (damping + load_damping * load, load_stiffness * load, resonance)
    sliding = (bare_friction(fingertip.friction, Fn, occlusion), (x1 - x0) / TICK, shape)
    for segment in segments:
        if segment.number:
            drive = new if segment.new else old
            motion = _advanced(coefficients, segment, motion, drive, loaded, sliding)
    if not exact:
        motion = _read(motion, window)
    Fn_y, Fn_rate = follow(normal, Fn_y, Fn_rate, Fn)
    moment, moment_rate = follow(normal, moment, moment_rate, 0.5 * (Fn0 * x0 + Fn1 * x1))
    return PlateState(motion, Fn_y, Fn_rate, moment, moment_rate, temperature, occlusion)


def _advanced(
    coefficients: Coefficients,
    segment: Segment,
    motion: Motion,
    drive: Drive,
    loaded: tuple[float, float, float],
    sliding: tuple[float, float, float],
) -> Motion:
    """Return what moves, after a part of a tick.

    Parameters
    ----------
    coefficients, segment, motion, drive
        The plate.
    loaded
        Damping of the mode under the finger in N s/m, stiffness of the finger in N/m, and resonance
        in Hz of the bare mode at rest.
    sliding
        Its friction without vibration in N, the velocity of its bone in m/s, and the shape of the
        mode where it is.
    """
    voltage, frequency = drive
    if TWO_PI * frequency != motion.omega:
        motion = _in_frame(motion, TWO_PI * frequency)
    number, length, phi, film_kept, _, _, _ = segment
    W, rate, omega, acting, v, stretch, creep, Ft, Fx, Fx_rate, pickup = motion
    bare, v_bone, shape = sliding
    friction, constants, film_lag = coefficients.fingertip
    mass, conversion, _, _, _, _, softening, beside, offset = coefficients.mode
    damping, c_finger, resonance = loaded
    exact = coefficients.exact
    force = conversion * voltage
    mode = _driven(mass, length, omega, force, damping, stiffness_of(mass, resonance) + c_finger)
    neighbour = mode
    if not exact:
        stiffness = stiffness_of(mass, resonance + offset) + c_finger
        neighbour = _driven(mass, length, omega, beside * force, damping, stiffness)
    skin = skin_step(constants, length, v_bone)
    contact = (bare, shape, film_lag / length, film_kept)
    # The mode is one for all sub-steps, unless it softens; only the pick-up reads between them.
    whole = exact and not softening
    at_once = number if whole else 1
    for _ in range(1 if whole else number):
        if softening:
            # Of second order: the stiffness of a sub-step is that of its mean amplitude.
            size = abs(W)
            softer = stiffness_of(mass, _fallen(resonance, softening * size)) + c_finger
            mode = _driven(mass, length, omega, force, damping, softer)
            mean = 0.5 * softening * (size + abs(vibrate(mode.step, W, rate)[0]))
            softer = stiffness_of(mass, _fallen(resonance, mean)) + c_finger
            mode = _driven(mass, length, omega, force, damping, softer)
        W0, rate0 = W, rate
        moving = (W, rate, acting, v, stretch, creep, Ft, Fx, Fx_rate)
        W, rate, acting, v, stretch, creep, Ft, Fx, Fx_rate = slide(
            at_once, (mode.step, skin, phi), contact, friction, moving
        )
        if not exact:
            moved = (W0, rate0, W, rate)
            pickup = _picked_up(coefficients, segment, pickup, omega, (mode, neighbour), moved)
    return Motion(W, rate, omega, acting, v, stretch, creep, Ft, Fx, Fx_rate, pickup)


def shape_at(x: float, ripple: float, node_distance: float) -> float:
    """Return ``1 + ripple cos(2 pi x/node_distance)`` at x in m from the middle of the plate.

    It is the ratio of the amplitude at the finger, averaged over the contact, to that at the
    pick-up.
    """
    return 1.0 + ripple * math.cos(TWO_PI * x / node_distance)


def lag_kept(duration: float, lag: float) -> float:
    """Return the share of its distance that a first-order lag keeps in a step, both in s."""
    return 1.0 + math.expm1(-duration / lag) if lag else 0.0


def _in_frame(motion: Motion, omega: float) -> Motion:
    """Return what moves, seen from the frame of a drive of another frequency in rad/s."""
    W, rate, before, acting, v, stretch, creep, Ft, Fx, Fx_rate, pickup = motion
    rate = rate_in_frame(W, rate, omega - before)
    W2, rate2, low, total, seen = pickup
    pickup = PickUp(W2, rate_in_frame(W2, rate2, omega - before), low, total, seen)
    return Motion(W, rate, omega, acting, v, stretch, creep, Ft, Fx, Fx_rate, pickup)


def _fallen(resonance: float, fall: float) -> float:
    """Return a resonance that softening has lowered, all in Hz."""
    return max(resonance - fall, LEAST_RESONANCE * resonance)


class _DrivenMode(NamedTuple):
    """A mode under a drive and a finger."""

    step: Response
    force: float
    """In N peak-to-peak."""
    damping: float
    stiffness: float


def _driven(
    mass: float, length: float, omega: float, force: float, damping: float, stiffness: float
) -> _DrivenMode:
    step = response(mass, length, omega, force, damping, stiffness)
    return _DrivenMode(step, force, damping, stiffness)


def _picked_up(
    coefficients: Coefficients,
    segment: Segment,
    pickup: PickUp,
    omega: float,
    modes: tuple[_DrivenMode, _DrivenMode],
    moved: tuple[complex, complex, complex, complex],
) -> PickUp:
    """Return what the pick-up sees after a sub-step, in which the main mode has moved."""
    length, mass, lag = segment.length, coefficients.mode.m, coefficients.lag
    mode, neighbour = modes
    W0, _, W, _ = moved
    W2, rate2, low0, total, seen = pickup
    loaded = (mode.damping, mode.stiffness)
    area = integral(moved, length, mass, omega, mode.force, loaded)
    W2_next, rate2_next = vibrate(neighbour.step, W2, rate2)
    loaded = (neighbour.damping, neighbour.stiffness)
    moved = (W2, rate2, W2_next, rate2_next)
    area += integral(moved, length, mass, omega, neighbour.force, loaded)
    change = W + W2_next - (W0 + W2)
    low = W + W2_next
    if lag:
        # The filter sees a ramp of the same mean.
        late = area / length + change * (0.5 - lag / length)
        low = late + (low0 - late + change) * segment.low_kept
    if segment.read:
        total += area - lag * (low - low0)
    return PickUp(W2_next, rate2_next, low, total, seen)


def _read(motion: Motion, window: float) -> Motion:
    """Return what moves once the pick-up has read: the mean over its window, if it has one."""
    W, rate, omega, acting, v, stretch, creep, Ft, Fx, Fx_rate, pickup = motion
    W2, rate2, low, total, _ = pickup
    pickup = PickUp(W2, rate2, low, 0j, total / window if window else low)
    return Motion(W, rate, omega, acting, v, stretch, creep, Ft, Fx, Fx_rate, pickup)
