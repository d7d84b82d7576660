"""Predictive vibration control: one step with a complex plate model that is learned meanwhile.

With ``lambda = -1/tau + j (w0 - w)`` and ``kappa = K/tau`` the plate of eq. (6) and (7) is, in the
frame of the drive voltage, ``W' = lambda W + kappa V``. A constant drive over a time h gives
exactly ::

    e^(lambda h) W + kappa phi(lambda, h) V,        phi(lambda, h) = (e^(lambda h) - 1)/lambda

The drive of tick k takes effect after the dead time d, at the W that the drive before has produced.
The law puts out the voltage that brings ``|W|`` to its reference one tick later.
"""

from __future__ import annotations

from math import isnan, nan, sqrt
from typing import Final, NamedTuple

from smarttac_can.control.belief import (
    PRIOR,
    TWO_PI,
    Belief,
    PlateNow,
    Span,
    believed,
    fade,
    first_lasting,
    learn,
    missed,
    part_before,
    part_of,
)
from smarttac_can.vocabulary.model import F0_SLOPE, PlateModel, contact_load, decay_rate
from smarttac_can.vocabulary.signals import TICK, Drive

LEAST_POLE: Final = 0.1
"""Fraction of an error that is left intentionally, as a margin for a wrong dead time."""
CAUTION: Final = 1.0
"""Factor by which the uncertainty of the response to a volt reduces a step."""
LEARN_MIN: Final = 20e-9
"""Vibration in m above which the law learns. Below it an offset of the pick-up, 5 nm, would look
like a plate whose vibration does not decay."""
_FORCE_SHARE: Final = 0.3
"""Filter factor of the normal force per tick, as its noise would become noise of the voltage."""
_TEMPERATURE_SHARE: Final = 0.01
"""Filter factor of the thermometer per tick. A plate needs seconds, so a jump is a fault."""
_WARMEST: Final = 150.0


def voltage_for(
    plate: PlateNow, belief: Belief, dead_time: float, W: complex, span: Span, W_ref: float
) -> float:
    """Return the voltage in V that brings ``|W|`` to its reference, before its limits.

    Parameters
    ----------
    plate, belief
        Estimated plate, and its uncertainty.
    dead_time
        Time in s until the new drive is in force.
    W
        Vibration in m in this tick.
    span
        Drive until then, and the angular frequency of the new one.
    W_ref
        Reference of ``|W|`` in m.
    """
    kappa = plate.kappa
    if dead_time > 0.0:
        forced = kappa * span.V_before
        part = part_before(plate, span.w_before, W, forced, dead_time)
        W = part.left * W + part.per_force * forced
    part = part_of(plate, span.w, abs(W), W_ref, TICK)
    by_turn = part.by_turn / part.per_force
    pole = _held_back(belief, -plate.rate * by_turn.real, -by_turn.imag)
    goal = pole * abs(W) + (1.0 - pole) * W_ref
    free, per_volt = part.left * W, kappa * part.per_force
    # |free + per_volt V|^2 = goal^2; without a root, the nearest value.
    square = per_volt.real * per_volt.real + per_volt.imag * per_volt.imag
    half = free.real * per_volt.real + free.imag * per_volt.imag
    root = half * half - square * (free.real * free.real + free.imag * free.imag - goal * goal)
    return (sqrt(root) - half) / square if root > 0.0 else -half / square


def _held_back(belief: Belief, by_rate: float, by_w0: float) -> float:
    """Return the fraction of an error to leave, from the uncertainty of the response to a volt.

    Parameters
    ----------
    belief
        Belief with its covariance.
    by_rate, by_w0
        Derivatives of the logarithm of the response to a volt; that with respect to kappa is 1.
    """
    variance = (
        belief.kk
        + by_rate * (2.0 * belief.kr + by_rate * belief.rr + 2.0 * by_w0 * belief.rw)
        + by_w0 * (2.0 * belief.kw + by_w0 * belief.ww)
    )
    unsure = CAUTION * sqrt(variance) if variance > 0.0 else 0.0
    pole = unsure / (1.0 + unsure)
    return pole if pole > LEAST_POLE else LEAST_POLE


class Prior(NamedTuple):
    """Knowledge before the first measurement: the model, and the dead time."""

    kappa: float
    """K/tau in m/(V s)."""
    tau: float
    """Time constant of the bare plate in s."""
    load: float
    f0: float
    """Resonance in Hz."""
    temperature: float
    """Temperature in degC at which f0 applies."""
    softening: float
    """Fall of the resonance with the amplitude in rad/(s m)."""
    dead_time: float
    """Time from the tick until the new drive is in force in s, 0 or more, below 1 ms."""


class Learned(NamedTuple):
    """State of the law after a tick."""

    belief: Belief
    """Differences from the model."""
    plate: PlateNow
    """Estimated plate."""
    W: complex
    """Vibration of the tick in m."""
    drive: Drive
    """Drive that was in force then; valid if `follows`."""
    follows: bool
    """Whether the next measurement follows from this one and the drives."""
    held: bool
    """Whether there was only one measurement; two are needed to know the effect of a drive."""
    rate: float
    """1/tau in 1/s of the model under the finger."""
    contact: float
    """Contact as in `contact_load`, filtered."""
    temperature: float
    """Plate temperature in degC, filtered; NaN before the first plausible one."""


def unlearned(prior: Prior) -> Learned:
    """Return the state before the first measurement."""
    rate = decay_rate(prior.load, prior.tau, 0.0)
    plate = PlateNow(prior.kappa, rate, TWO_PI * prior.f0, prior.softening)
    return Learned(PRIOR, plate, 0j, Drive(0.0, prior.f0), False, True, rate, 0.0, nan)


def observed(
    prior: Prior, learned: Learned, W: complex, drive: Drive, Fn: float, temperature: float
) -> Learned:
    """Return the state after the measurement of a tick.

    Parameters
    ----------
    prior, learned
        Model, and state after the tick before.
    W
        Vibration in m.
    drive
        Drive that answered the tick before. It is in force unless W shows that it was lost.
    Fn
        Normal force of the finger in N, 0 without contact.
    temperature
        Plate temperature in degC; an impossible value is ignored.
    """
    belief, _, W_before, before, follows, _, rate_before, contact, warmth = learned
    if -_WARMEST < temperature < _WARMEST:
        if isnan(warmth):
            warmth = temperature
        warmth += _TEMPERATURE_SHARE * (temperature - warmth)
    warmer = 0.0 if isnan(warmth) else warmth - prior.temperature
    contact += _FORCE_SHARE * (contact_load(Fn) - contact)
    rate = decay_rate(prior.load, prior.tau, contact)
    w0 = TWO_PI * (prior.f0 + F0_SLOPE * warmer)
    model = PlateNow(prior.kappa, rate, w0, prior.softening)
    if follows and abs(W) > LEARN_MIN:
        span = Span(
            before.voltage, TWO_PI * before.frequency, drive.voltage, TWO_PI * drive.frequency
        )
        faded = fade(belief, (rate - rate_before) / rate_before)
        if missed(faded, model, prior.dead_time, W_before, span, W):
            drive, span = before, first_lasting(span)
        belief = learn(faded, model, prior.dead_time, W_before, span, W)
    plate = believed(model, belief)
    return Learned(belief, plate, W, drive, True, not follows, rate, contact, warmth)


def interrupted(learned: Learned) -> Learned:
    """Return the state after a missing tick: the next measurement does not follow from this one."""
    belief, plate, W, drive, _, held, rate, contact, temperature = learned
    return Learned(belief, plate, W, drive, False, held, rate, contact, temperature)


def resonance_of(learned: Learned) -> float:
    """Return the estimated resonance in Hz; after a single measurement the frequency in force."""
    if learned.held and learned.follows:
        return learned.drive.frequency
    plate = learned.plate
    return (plate.w0 - plate.softening * abs(learned.W)) / TWO_PI


def asked_voltage(prior: Prior, learned: Learned, W_ref: float, frequency: float) -> float:
    """Return the voltage in V, before its limits.

    After a single measurement it is the voltage in force, as two are needed to know its effect.

    Parameters
    ----------
    prior, learned
        Model, and state after this tick.
    W_ref
        Reference of ``|W|`` in m.
    frequency
        Excitation frequency in Hz of the same drive.
    """
    if not learned.follows:
        return 0.0
    drive = learned.drive
    if learned.held:
        return drive.voltage
    span = Span(drive.voltage, TWO_PI * drive.frequency, 0.0, TWO_PI * frequency)
    return voltage_for(learned.plate, learned.belief, prior.dead_time, learned.W, span, W_ref)


def prior_of(model: PlateModel, dead_time: float) -> Prior:
    """Return the knowledge about a plate from its model."""
    m = model
    softening = TWO_PI * m.softening
    return Prior(m.gain / m.tau, m.tau, m.load, m.f0, m.temperature, softening, dead_time)
