"""Predictive vibration control: one step of a complex plate that is learned on the way.

With ``lambda = -1/tau + j (w0 - w)`` and ``kappa = K/tau`` the plate of eq. (6) and (7) is, in the
frame of the drive voltage, ``W' = lambda W + kappa V``. Held over a time h it moves exactly to ::

    e^(lambda h) W + kappa phi(lambda, h) V,        phi(lambda, h) = (e^(lambda h) - 1)/lambda

The drive of tick k takes force after the dead time d, with W where the drive before has brought it.
Of all voltages that one is put out which brings ``|W|`` to its reference a tick later.
"""

from __future__ import annotations

from cmath import exp as exp_j
from math import sqrt
from typing import Final

from smarttac_can.control.belief import (
    PRIOR,
    TWO_PI,
    Belief,
    PlateNow,
    Span,
    believed,
    fade,
    learn,
)
from smarttac_can.vocabulary.model import PlateModel, contact_load
from smarttac_can.vocabulary.signals import TICK, Contact, Drive

LEAST_POLE: Final = 0.1
"""Share of an error that is left on purpose: margin for a dead time that was told wrongly."""
CAUTION: Final = 1.0
"""Standard uncertainties of what a volt does by which a step is held back."""
F0_SLOPE: Final = -14.0
"""Change of the resonance in Hz/K; paper, section on Fig. 5."""
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
    kappa, rate, w0 = plate
    if dead_time > 0.0:
        turn = complex(-rate, w0 - span.w_before)
        e = exp_j(turn * dead_time)
        W = e * W + kappa * span.V_before * (e - 1.0) / turn
    turn = complex(-rate, w0 - span.w)
    e = exp_j(turn * TICK)
    phi = (e - 1.0) / turn
    by_turn = (TICK * e - phi) / (turn * phi)
    pole = _held_back(belief, -rate * by_turn.real, -by_turn.imag)
    goal = pole * abs(W) + (1.0 - pole) * W_ref
    free, per_volt = e * W, kappa * phi
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


class PredictiveLoop:
    """Amplitude and resonance by one law; it learns in every mode, whoever drives.

    Parameters
    ----------
    model
        The unloaded plate, what a finger adds, and the temperature at which it was identified.
    dead_time
        Time from the tick until the new drive is in force in s, 0 or more, below 1 ms.

    Attributes
    ----------
    belief
        What it has learned, against the model.
    plate
        The plate it works with.
    """

    __slots__ = (
        "_W",
        "_contact",
        "_dead_time",
        "_drive",
        "_held",
        "_kappa",
        "_model",
        "_rate",
        "_temperature",
        "belief",
        "plate",
    )

    def __init__(self, model: PlateModel, dead_time: float) -> None:
        self._model = model
        self._dead_time = dead_time
        self._kappa = model.gain / model.tau
        self._rate = model.decay_rate(0.0)
        self._contact = 0.0
        self._temperature: float | None = None
        self._W = 0j
        self._drive: Drive | None = None
        self._held = True
        self.belief = PRIOR
        self.plate = PlateNow(self._kappa, self._rate, TWO_PI * model.f0)

    @property
    def resonance(self) -> float:
        """Resonance in Hz where it is believed to be; at first the frequency in force."""
        if self._held and self._drive is not None:
            return self._drive.frequency
        return self.plate.w0 / TWO_PI

    def observe(self, W: complex, drive: Drive, contact: Contact, temperature: float) -> None:
        """Learn from the measurement of a tick.

        Parameters
        ----------
        W
            Vibration in m.
        drive
            The drive in force, which answered the tick before.
        contact
            The finger.
        temperature
            Of the plate in degC; one that no plate has is not believed.
        """
        rate = self._rate
        model = self._now(contact, temperature)
        before = self._drive
        self._held = before is None
        if before is not None and abs(W) > LEARN_MIN:
            span = Span(
                before.voltage,
                TWO_PI * before.frequency,
                drive.voltage,
                TWO_PI * drive.frequency,
            )
            faded = fade(self.belief, (self._rate - rate) / rate)
            self.belief = learn(faded, model, self._dead_time, self._W, span, W)
        self.plate = believed(model, self.belief)
        self._drive, self._W = drive, W

    def interrupt(self) -> None:
        """Take note that a tick is missing: what comes next does not follow from what was."""
        self._drive = None

    def voltage(self, W_ref: float, frequency: float) -> float:
        """Return the voltage in V, before its limits.

        After a single measurement it is the one in force: two are needed to know what it does.

        Parameters
        ----------
        W_ref
            Reference of ``|W|`` in m.
        frequency
            Excitation frequency in Hz that goes out with it.
        """
        drive = self._drive
        if drive is None:
            return 0.0
        if self._held:
            return drive.voltage
        span = Span(drive.voltage, TWO_PI * drive.frequency, 0.0, TWO_PI * frequency)
        return voltage_for(self.plate, self.belief, self._dead_time, self._W, span, W_ref)

    def _now(self, contact: Contact, temperature: float) -> PlateNow:
        """Return what the model makes of force and temperature."""
        model = self._model
        if -_WARMEST < temperature < _WARMEST:
            if self._temperature is None:
                self._temperature = temperature
            self._temperature += _TEMPERATURE_SHARE * (temperature - self._temperature)
        warmer = 0.0 if self._temperature is None else self._temperature - model.temperature
        pressing = contact_load(contact.Fn) if contact.touching else 0.0
        self._contact += _FORCE_SHARE * (pressing - self._contact)
        self._rate = model.decay_rate(self._contact)
        return PlateNow(self._kappa, self._rate, TWO_PI * (model.f0 + F0_SLOPE * warmer))
