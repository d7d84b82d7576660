"""Bounds of the vibration: what the drive makes of the plate at most, and at least.

In the frame of the drive voltage a plate with gain K, time constant tau, resonance w0 and a finger
that multiplies its damping by D follows ``W' = lambda W + (K/tau) V`` with ``lambda = -D/tau +
j (w0 - w)``, so that it settles at ``K V/sqrt(D^2 + (tau (w0 - w))^2)``. Two bounds follow from it:

* **From above**, which takes nothing from the pick-up: the least D that any finger has at the
  measured normal force, and of all resonances that model, thermometer and finger leave possible the
  one nearest to the drive. What this bound may reach limits the voltage before it goes out.
* **From below**, what the pick-up has to read at least: the largest D, and the resonance that is
  farthest away.

Neither waits until the vibration has settled: a friction loop may drive in pulses that are shorter.
Before an identification nobody knows where the resonance is. The bound from above then takes it to
be where the drive is, and the one from below takes the phase that the pick-up reads.

`follow` steps the bounds with a measurement, `put_out` with the drive that answers it. A drive is
taken to be in force from its measurement to the next one, whatever the dead time is. The
comparisons with the model take the larger or the lesser of two voltages in turn, so that a drive
may take effect anywhere in its cycle. Where drives were late, the bounds take the largest and the
least of those that may be in force.
"""

from __future__ import annotations

from builtins import complex  # mypyc finds it by name in a named tuple
from cmath import exp as exp_j
from collections.abc import Callable
from math import exp, nan, pi, sqrt
from typing import Final, NamedTuple

from smarttac_can.nodes.hard_caps import AMPLITUDE_TRIP_MAX
from smarttac_can.vocabulary.model import F0_SLOPE, contact_load
from smarttac_can.vocabulary.signals import TICK, Contact, Drive, Measurement

LEAST_LOAD: Final = 0.40
MOST_LOAD: Final = 1.60
"""Damping that a finger adds at 0.5 N, over that of the bare plate, at least and at most; an
assumption wider than all fingertips of the simulation, 0.47 to 1.32."""
MOST_STIFFENING: Final = 12.0
"""By how many Hz a finger of 0.5 N raises the resonance at most; an assumption wider than the
8.8 Hz of the simulation."""
THERMOMETER_UNCERTAINTY: Final = 1.0
"""Uncertainty of the thermometer in K. At 140 Hz off the resonance a kelvin is 4 % of the
vibration."""
_F0_UNCERTAINTY: Final = 2.0
"""Uncertainty in Hz of a resonance that was identified."""
_RESONANCE_UNCERTAINTY: Final = _F0_UNCERTAINTY - F0_SLOPE * THERMOMETER_UNCERTAINTY
"""Uncertainty in Hz of the resonance of an identified plate without a finger."""
_FORCE_UNCERTAINTY: Final = 0.05
"""Uncertainty of the normal force in N: noise, and drift since the tare."""
_FORCE_TOLERANCE: Final = 0.1
"""The same as a fraction: slope and bow of the gauges."""
_PHASE_FROM: Final = 20e-9
"""Vibration in m from which its phase shows the detuning: noise is 1 nm."""
_PHASE_MIN: Final = 0.05
"""Cosine of the phase, at least; at the ends of the frequency range it is 0.13."""
_HOP: Final = 10.0
"""Change in Hz from one drive to the next after which the vibration turns to a new phase, perhaps
through 0."""
_TURNING_CYCLES: Final = 8
"""How long that takes, in cycles: the phase shows nothing until then."""
_TWO_PI: Final = 2.0 * pi
ROUNDING: Final = 1.0 + 1e-9
"""A bound that a voltage was cut to may miss its limit by the last bits."""


class BoundPlan(NamedTuple):
    """What the bounds follow from: limits, model and data sheet, in SI units."""

    identified: bool
    """Whether the resonance is known."""
    limit: float
    """Of the bound from above under a finger, in m peak-to-peak."""
    bare_limit: float
    """The same without contact, at most 3.27 um: the pick-up ends there."""
    gain: float
    """Of the model in m/V."""
    tau: float
    """Of the model in s."""
    decay: float
    """What is left after a tick of a vibration of the model."""
    most_gain: float
    """Largest that is believed, in m/V: a written model may be that of a plate whose pick-up reads
    too little."""
    believed_tau: float
    """Of the model, within the tolerance of the data sheet, in s."""
    f0: float
    """Resonance of the model in Hz."""
    found_at: float
    """Temperature in degC at which it was that."""
    softest: float
    """By how many Hz it falls until the vibration is at its limit; a plate that stiffens has less
    than 0."""


class Response(NamedTuple):
    """What a tick makes of a vibration at one frequency."""

    left: complex
    """What is left of a vibration."""
    per_volt: complex
    """What a volt adds, in m/V."""


class InForce(NamedTuple):
    """The drives that may be in force until the next measurement."""

    drive: Drive
    """As it went out last."""
    turning: int
    """Cycles for which the vibration may still turn to the phase of another frequency."""
    most: float
    """Largest voltage in V that may be in force."""
    least: float
    """Least one."""
    most_before: float
    """The largest one in the cycle before."""
    least_before: float
    """The least one then."""
    held_most: float
    """Largest voltage in V of the drives that a late one leaves in force."""
    held_least: float
    """Least one."""
    late: bool
    """Whether the last drive is late."""
    response: Response
    """The larger one of those that may be in force."""
    held: Response
    """That of the drives that a late one leaves in force."""


class Vibration(NamedTuple):
    """The vibration that follows from the drives, in m peak-to-peak."""

    most: complex
    """Bound from above. `cut` keeps it within its limit, unless drives come late."""
    E: float
    """At the bare resonance: no detuning and no finger makes the plate vibrate more."""
    E_least: float
    """The same of the least voltage that may be in force."""
    least: float
    """Bound from below."""
    damping: float
    """Least damping of plate and finger over that of the plate."""
    touching: bool
    """Whether a finger was felt."""
    low: float
    """Lowest frequency in Hz that the resonance may have."""
    high: float
    """Highest one."""


def bound_plan(si: Callable[[str], float], *, identified: bool) -> BoundPlan:
    """Return what the bounds follow from.

    Parameters
    ----------
    si
        Returns the value of an object of ``stimulator.eds`` in SI units.
    identified
        Whether the model is that of an identification.
    """
    limit = si("Limit.Amplitude by drive")
    tolerance = si("Model.Data sheet tolerance")
    gain, tau = si("Model.Gain per volt"), si("Model.Tau")
    sheet_tau = si("Model.Data sheet tau")
    least, most = (1.0 - tolerance) * sheet_tau, (1.0 + tolerance) * sheet_tau
    return BoundPlan(
        identified=identified,
        limit=limit,
        bare_limit=min(AMPLITUDE_TRIP_MAX, limit),
        gain=gain,
        tau=tau,
        decay=exp(-TICK / tau),
        most_gain=max(gain, (1.0 - tolerance) * si("Model.Data sheet gain per volt")),
        believed_tau=min(max(tau, least), most),
        f0=si("Model.Resonance"),
        found_at=si("Model.Temperature"),
        softest=si("Model.Softening") * limit,
    )


def still(plan: BoundPlan) -> Vibration:
    """Return the vibration of a plate at rest, without a finger."""
    return Vibration(0j, 0.0, 0.0, 0.0, 1.0, False, plan.f0, plan.f0)


_NOTHING: Final = Response(0j, 0j)
UNDRIVEN: Final = InForce(
    Drive(0.0, nan), 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False, _NOTHING, _NOTHING
)
"""Before the first drive."""


def follow(
    plan: BoundPlan,
    before: Vibration,
    in_force: InForce,
    measurement: Measurement,
    contact: Contact,
    ticks: int,
) -> Vibration:
    """Return the vibration at a measurement.

    Parameters
    ----------
    before
        At the measurement before.
    in_force
        The drives since then.
    measurement
        Its temperature counts, and only for the bound from below the phase of the pick-up.
    contact
        The finger in this cycle.
    ticks
        Since the measurement before, 1 or more.
    """
    bound, E, E_least, least, _, _, low, high = before
    drive, _, V_most, V_least, V_most_before, V_least_before, _, _, _, response, _ = in_force
    Fn = contact.Fn if contact.Fn > 0.0 else 0.0
    touching = contact.touching
    decay = plan.decay**ticks
    driven = plan.gain * max(V_most, V_most_before)
    E = driven + (E - driven) * decay
    driven = plan.gain * V_least
    E_least = driven + (E_least - driven) * decay
    # What a reading of that may stand for at most, and below at least.
    most_contact = contact_load((1.0 + _FORCE_TOLERANCE) * Fn + _FORCE_UNCERTAINTY)
    least_contact = 0.0
    if touching:
        least_contact = contact_load((1.0 - _FORCE_TOLERANCE) * Fn - _FORCE_UNCERTAINTY)
    damping = 1.0 + MOST_LOAD * most_contact
    voltage = min(V_least, V_least_before)
    driven = 0.0
    # Without a voltage there may have been no drive yet, and so no frequency.
    if voltage > 0.0:
        if plan.identified:
            share = _least_share(plan, low, high, drive.frequency, damping)
        else:
            share = _read_share(measurement.W)
        driven = plan.gain * voltage * share / damping
    least = driven + (least - driven) * exp(-(ticks * TICK) * damping / plan.tau)
    left, per_volt = response
    for _ in range(ticks):
        bound = left * bound + per_volt * V_most
    f0 = plan.f0 + F0_SLOPE * (measurement.temperature - plan.found_at)
    return tuple.__new__(
        Vibration,
        (
            bound,
            E,
            E_least,
            least,
            1.0 + LEAST_LOAD * least_contact,
            touching,
            f0 - _RESONANCE_UNCERTAINTY - max(plan.softest, 0.0),
            f0 - min(plan.softest, 0.0) + _RESONANCE_UNCERTAINTY + MOST_STIFFENING * most_contact,
        ),
    )


def put_out(
    plan: BoundPlan, vibration: Vibration, in_force: InForce, drive: Drive, late: bool
) -> tuple[InForce, Drive]:
    """Cut the voltage of a drive, and note it as in force.

    If the drive is late, it comes into force during the next cycle, or never. The drives before it
    may then stay in force until one in time has come, and for the cycle in which that comes.

    Parameters
    ----------
    plan, vibration
        Limits and model, and the vibration at the measurement that is answered.
    in_force
        What may have been in force until then.
    drive
        What is to go out.
    late
        Whether the plate gets it too late for this cycle.

    Returns
    -------
    tuple
        What may be in force until the next measurement, and the drive that goes out.
    """
    response = response_at(plan, vibration, drive.frequency)
    drive = cut(plan, vibration, response, drive)
    return noted(in_force, drive, response, late), drive


def response_at(plan: BoundPlan, vibration: Vibration, frequency: float) -> Response:
    """Return what a tick at a frequency in Hz makes of the bound from above."""
    off = 0.0
    if plan.identified:
        if frequency < vibration.low:
            off = vibration.low - frequency
        elif frequency > vibration.high:
            off = vibration.high - frequency
    turn = complex(-vibration.damping / plan.believed_tau, _TWO_PI * off)
    left = exp_j(turn * TICK)
    per_volt = plan.most_gain / plan.believed_tau * (left - 1.0) / turn
    return tuple.__new__(Response, (left, per_volt))


def cut(plan: BoundPlan, vibration: Vibration, response: Response, drive: Drive) -> Drive:
    """Return a drive with its voltage cut to what keeps the bound from above within its limit.

    That is 3.27 um, the end of the pick-up's range, without contact, and
    ``Limit.Amplitude by drive`` under a finger, which may damp more than the least.
    """
    V, f = drive
    left, per_volt = response
    limit = plan.limit if vibration.touching else plan.bare_limit
    free = left * vibration.most
    W = free + per_volt * V
    if W.real * W.real + W.imag * W.imag <= limit * limit:
        return drive
    over = free.real * free.real + free.imag * free.imag - limit * limit
    if over >= 0.0:
        return Drive(0.0, f)
    # |free + per_volt V|^2 = limit^2
    square = per_volt.real * per_volt.real + per_volt.imag * per_volt.imag
    half = free.real * per_volt.real + free.imag * per_volt.imag
    return Drive((sqrt(half * half - square * over) - half) / square, f)


def noted(in_force: InForce, drive: Drive, response: Response, late: bool) -> InForce:
    """Return what may be in force until the next measurement, as a drive has gone out."""
    was, turning, most, least, _, _, held_most, held_least, was_late, _, held = in_force
    V = drive.voltage
    turning = turning - 1 if turning > 0 else 0
    if abs(drive.frequency - was.frequency) > _HOP:
        turning = _TURNING_CYCLES
    V_most = V_least = V
    larger = response
    if late or was_late:
        V_most, V_least = max(V, held_most), min(V, held_least)
        if abs(held.per_volt) > abs(response.per_volt):
            larger = held
    held_most, held_least, held = (V_most, V_least, larger) if late else (V, V, response)
    return tuple.__new__(
        InForce,
        (
            drive, turning, V_most, V_least, most, least, held_most, held_least, late, larger, held,
        ),
    )  # fmt: skip


def _least_share(
    plan: BoundPlan, low: float, high: float, frequency: float, damping: float
) -> float:
    """Return which share of its vibration at resonance the plate has at least, 0..1."""
    off = max(abs(frequency - low), abs(frequency - high))
    x = _TWO_PI * off * plan.believed_tau / damping
    return 1.0 / sqrt(1.0 + x * x)


def _read_share(W: complex) -> float:
    """Return the same of an unknown plate, by the phase that the pick-up reads."""
    amplitude = abs(W)
    if amplitude > _PHASE_FROM and W.real > _PHASE_MIN * amplitude:
        return W.real / amplitude
    return 1.0
