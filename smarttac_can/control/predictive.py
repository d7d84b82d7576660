"""Predictive vibration control: one step of a complex plate that is learned on the way.

With ``lambda = -1/tau + j (w0 - w)`` and ``kappa = K/tau`` the plate of eq. (6) and (7) is, in the
frame of the drive voltage, ``W' = lambda W + kappa V``. Held over a time h it moves exactly to ::

    e^(lambda h) W + kappa phi(lambda, h) V,        phi(lambda, h) = (e^(lambda h) - 1)/lambda

The drive of tick k takes force after the dead time d, with W where the drive before has brought it.
Of all voltages that one is put out which brings ``|W|`` to its reference a tick later.
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
"""Share of an error that is left on purpose: margin for a wrong dead time."""
CAUTION: Final = 1.0
"""Standard uncertainties of what a volt does by which a step is held back."""
LEARN_MIN: Final = 20e-9
"""Vibration in m from which it learns: an offset of the pick-up, 5 nm, would be taken for a plate
that does not die down."""
_FORCE_SHARE: Final = 0.3
"""Share of a new normal force that is believed in a tick: its noise would be one of the voltage."""
_TEMPERATURE_SHARE: Final = 0.01
"""The same of the thermometer: a plate needs seconds, so what jumps is a fault."""
_WARMEST: Final = 150.0


def voltage_for(
    plate: PlateNow, belief: Belief, dead_time: float, W: complex, span: Span, W_ref: float
) -> float:
    """Return the voltage in V that brings ``|W|`` to its reference, before its limits.

    Parameters
    ----------
    plate, belief
        What is believed, and how surely.
    dead_time
        Time in s until the new drive is in force.
    W
        Vibration in m in this tick.
    span
        The drive until then; of the new one the angular frequency.
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
    # |free + per_volt V|^2 = goal^2; without a root, as near as it gets.
    square = per_volt.real * per_volt.real + per_volt.imag * per_volt.imag
    half = free.real * per_volt.real + free.imag * per_volt.imag
    root = half * half - square * (free.real * free.real + free.imag * free.imag - goal * goal)
    return (sqrt(root) - half) / square if root > 0.0 else -half / square


def _held_back(belief: Belief, by_rate: float, by_w0: float) -> float:
    """Return the share of an error to leave, from how unsure it is what a volt does.

    Parameters
    ----------
    belief
        With its covariance.
    by_rate, by_w0
        Derivatives of the logarithm of what a volt does; that by kappa is 1.
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
    """What is known before the first measurement: the model, and the dead time."""

    kappa: float
    """K/tau in m/(V s)."""
    tau: float
    """Of the bare plate in s."""
    load: float
    f0: float
    """In Hz."""
    temperature: float
    """In degC at which f0 applies."""
    softening: float
    """In rad/(s m)."""
    dead_time: float
    """Time from the tick until the new drive is in force in s, 0 or more, below 1 ms."""


class Learned(NamedTuple):
    """The law after a tick."""

    belief: Belief
    """Against the model."""
    plate: PlateNow
    """The plate it works with."""
    W: complex
    """Vibration of the tick in m."""
    drive: Drive
    """Which was in force then, if it follows anything."""
    follows: bool
    """Whether the next measurement follows from this one and the drives."""
    held: bool
    """Whether only one measurement was seen: two tell what a drive does."""
    rate: float
    """1/tau in 1/s of the model under the finger."""
    contact: float
    """Of `contact_load`, filtered."""
    temperature: float
    """Of the plate in degC, filtered; NaN before the first that was believed."""


def unlearned(prior: Prior) -> Learned:
    """Return the law before its first measurement."""
    rate = decay_rate(prior.load, prior.tau, 0.0)
    plate = PlateNow(prior.kappa, rate, TWO_PI * prior.f0, prior.softening)
    return Learned(PRIOR, plate, 0j, Drive(0.0, prior.f0), False, True, rate, 0.0, nan)


def observed(
    prior: Prior, learned: Learned, W: complex, drive: Drive, Fn: float, temperature: float
) -> Learned:
    """Return what is known after the measurement of a tick.

    Parameters
    ----------
    prior, learned
        What was known.
    W
        Vibration in m.
    drive
        The drive that answered the tick before. It is in force unless it was lost, as W then tells.
    Fn
        Normal force of the finger in N, 0 without contact.
    temperature
        Of the plate in degC; one that no plate has is not believed.
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
    """Return the law once a tick is missing: what comes next does not follow from what was."""
    belief, plate, W, drive, _, held, rate, contact, temperature = learned
    return Learned(belief, plate, W, drive, False, held, rate, contact, temperature)


def resonance_of(learned: Learned) -> float:
    """Return the resonance in Hz where it is believed to be; at first the frequency in force."""
    if learned.held and learned.follows:
        return learned.drive.frequency
    plate = learned.plate
    return (plate.w0 - plate.softening * abs(learned.W)) / TWO_PI


def asked_voltage(prior: Prior, learned: Learned, W_ref: float, frequency: float) -> float:
    """Return the voltage in V, before its limits.

    After a single measurement it is the one in force: two are needed to know what it does.

    Parameters
    ----------
    prior, learned
        What is known.
    W_ref
        Reference of ``|W|`` in m.
    frequency
        Excitation frequency in Hz that goes out with it.
    """
    if not learned.follows:
        return 0.0
    drive = learned.drive
    if learned.held:
        return drive.voltage
    span = Span(drive.voltage, TWO_PI * drive.frequency, 0.0, TWO_PI * frequency)
    return voltage_for(learned.plate, learned.belief, prior.dead_time, learned.W, span, W_ref)


def prior_of(model: PlateModel, dead_time: float) -> Prior:
    """Return what is known of a plate by its model."""
    m = model
    softening = TWO_PI * m.softening
    return Prior(m.gain / m.tau, m.tau, m.load, m.f0, m.temperature, softening, dead_time)
