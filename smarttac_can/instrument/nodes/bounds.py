"""Bounds of the vibration: the most and the least amplitude that the sent drives can have made.

In the frame of the drive voltage a plate with gain K, time constant tau, resonance w0 and a finger
that multiplies its damping by D follows ``W' = lambda W + (K/tau) V`` with ``lambda = -D/tau +
j (w0 - w)``, so that it settles at ``K V/sqrt(D^2 + (tau (w0 - w))^2)``. Two bounds follow from it:

* The **bound from above** does not use the pick-up. It takes the least D that any finger has at the
  measured normal force. Model, thermometer and finger leave a range for the resonance; the bound
  takes the value of this range that is nearest to the drive frequency. The voltage is cut so that
  this bound stays within its limit, before the drive goes out.
* The **bound from below** is the least vibration that the pick-up has to read. It takes the largest
  D, and the resonance that is farthest from the drive frequency.

Both bounds follow the vibration while it builds up and decays, because a friction loop may drive in
pulses that are too short for the vibration to settle. Before an identification the resonance is
unknown: the bound from above then assumes that the plate is driven at its resonance, and the bound
from below uses the phase that the pick-up reads.

A finger that lifts takes its damping away at once, and the gauges show it some cycles later. Until
then the plate follows the voltage that it needed under the finger. The pick-up of a sound device
sees that; a third bound keeps what a lift can **release** without the pick-up:

* The *free* vibration is that of a plate without a finger under the same drives. A lift at any time
  makes at most this vibration.
* A falling force is extrapolated by `_FORCE_LEAD`, so that a lift is noticed within `_UNNOTICED`
  cycles. From then on the free vibration has to stay within the limit without contact.
* The squares of the free vibration in the cycles before that, where they are above this limit, are
  the energy that the lift can have released. They fill a leaky bucket, which loses `_FORGOTTEN` a
  cycle. The fuller it is, the less may be free while a finger touches. So any time of n cycles has
  at most ``_RELEASED_MAX + n _FORGOTTEN``, however fast the finger taps.
* After a reading beyond the range of the pick-up, the limit of the free vibration is that without
  contact for a while.

`follow` steps the bounds with a measurement, `cut_and_record` with the drive that answers it. The
bounds assume that a drive is in force from its measurement to the next one, whatever the dead time
is. In fact a drive may take effect anywhere in its cycle, so the comparisons with the model use the
larger or the smaller of two consecutive voltages. After late drives the bounds use the largest and
the smallest voltage of all drives that may be in force.
"""

from __future__ import annotations

from builtins import complex  # mypyc finds it by name in a named tuple
from cmath import exp as exp_j
from collections.abc import Callable
from math import exp, nan, pi, sqrt
from typing import Final, NamedTuple

from smarttac_can.instrument.nodes.hard_caps import AMPLITUDE_TRIP_MAX
from smarttac_can.vocabulary.model import F0_SLOPE, contact_load
from smarttac_can.vocabulary.signals import PICKUP_SATURATED, TICK, Contact, Drive, Measurement

LEAST_LOAD: Final = 0.40
MOST_LOAD: Final = 1.60
"""Least and largest damping that a finger of 0.5 N adds, relative to the damping of the bare plate.
An assumption wider than all fingertips of the simulation, 0.47 to 1.32."""
MOST_STIFFENING: Final = 12.0
"""Largest rise of the resonance in Hz by a finger of 0.5 N, assumed; simulated are up to 8.8."""
THERMOMETER_UNCERTAINTY: Final = 1.0
"""Uncertainty of the thermometer in K. 140 Hz off resonance, 1 K changes the vibration by 4 %."""
_GAIN_UNCERTAINTY: Final = 0.01
"""Uncertainty of an identified gain as a fraction of it; the bound from above adds it."""
_F0_UNCERTAINTY: Final = 2.0
"""Uncertainty of an identified resonance in Hz."""
_RESONANCE_UNCERTAINTY: Final = _F0_UNCERTAINTY - F0_SLOPE * THERMOMETER_UNCERTAINTY
"""Uncertainty in Hz of the resonance of an identified plate without a finger."""
_FORCE_UNCERTAINTY: Final = 0.05
"""Uncertainty of the normal force in N: noise, and drift since the tare."""
_FORCE_TOLERANCE: Final = 0.1
"""Uncertainty of the normal force as a fraction of it: slope and bow of the gauges."""
_FORCE_LEAD: Final = 3.0
"""Cycles by which a falling force is extrapolated. Flexure and filter of the gauges delay it by 2.2
ms; a lift is half over by then."""
_UNNOTICED: Final = 3
"""Most cycles in which a lift has released a vibration before it is noticed."""
_CALM: Final = 50
"""Cycles after a reading beyond its range in which a finger raises no limit: the laws ask for much
as the plate has just fallen, and may drive it beyond again."""
_RELEASE_MAX: Final = 8e-6
"""Largest free vibration in m while a finger touches, however rarely it lifts."""
_LOSS: Final = 9.85e7
"""Energy in J that a plate of 5 g with tau = 0.944 ms loses in a cycle, over the square of its
vibration in m2: ``m/tau (pi f0)^2 TICK``. The mass is an assumption."""
_RELEASED_MAX: Final = 0.08 / _LOSS
"""Largest content of the bucket in m2: 0.08 J."""
_FORGOTTEN: Final = 8e-6 / _LOSS
"""What the bucket loses in a cycle in m2: 8 mJ a second, so that 10 s hold 0.16 J at most."""
_PHASE_FROM: Final = 20e-9
"""Least vibration in m at which its phase shows the detuning. The noise is 1 nm."""
_PHASE_MIN: Final = 0.05
"""Least cosine of the phase that is used. At the ends of the frequency range it is 0.13."""
_HOP: Final = 10.0
"""Change of the drive in Hz after which the vibration turns to a new phase, maybe through 0."""
_TURNING_CYCLES: Final = 8
"""Cycles that this turn takes. During them the phase is not used."""
_TWO_PI: Final = 2.0 * pi
ROUNDING: Final = 1.0 + 1e-9
"""Rounding: a bound to which a voltage was cut may exceed its limit by the last bits."""


class BoundPlan(NamedTuple):
    """Parameters of the bounds: limits, model and data sheet, in SI units."""

    identified: bool
    """Whether the resonance was identified."""
    limit: float
    """Limit of the bound from above while a finger touches, in m peak-to-peak."""
    bare_limit: float
    """Limit of the bound from above without contact, in m peak-to-peak. At most 3.27 um, the end of
    the pick-up's range."""
    trip: float
    """Limit of the measured amplitude in m peak-to-peak."""
    gain: float
    """Gain of the model in m/V."""
    tau: float
    """Time constant of the model in s."""
    decay: float
    """Fraction of a vibration of the model that is left after a tick."""
    most_gain: float
    """Gain of the bound from above in m/V: that of the model with its uncertainty, but at least
    that of the data sheet minus its tolerance. A written model may come from a plate whose pick-up
    reads too little."""
    believed_tau: float
    """Time constant of the model, limited to the tolerance of the data sheet, in s."""
    f0: float
    """Resonance of the model in Hz."""
    found_at: float
    """Temperature in degC at which the model has this resonance."""
    softest: float
    """Fall of the resonance in Hz at the limit of the vibration; below 0 if the plate stiffens."""


class Response(NamedTuple):
    """Response of the vibration to one tick at one frequency."""

    left: complex
    """Factor of the vibration at the start of the tick."""
    per_volt: complex
    """Vibration in m that each volt adds."""


class InForce(NamedTuple):
    """The drives that may be in force until the next measurement."""

    drive: Drive
    """Drive sent last."""
    turning: int
    """Cycles for which the vibration may still turn to the phase of a new frequency."""
    most: float
    """Largest voltage in V that may be in force."""
    least: float
    """Smallest voltage in V that may be in force."""
    most_before: float
    """Largest voltage in V of the cycle before."""
    least_before: float
    """Smallest voltage in V of the cycle before."""
    held_most: float
    """Largest voltage in V of the drives that stay in force if the last drive is late."""
    held_least: float
    """Smallest voltage in V of these drives."""
    late: bool
    """Whether the last drive is late."""
    response: Response
    """Larger response of the drives that may be in force."""
    free: Response
    """Response of a plate without a finger to the last drive."""
    held: Response
    """Response of the drives that stay in force if the last drive is late."""


class Release(NamedTuple):
    """What lifts of a finger can have released, and what the next one may."""

    free: complex
    """Bound from above for a plate without a finger, whatever the gauges read, in m."""
    unnoticed: tuple[float, float]
    """Squares in m2 of the free vibration above its limit, in the last two cycles of a touch."""
    released: float
    """Content of the bucket in m2."""
    calm: int
    """Cycles for which a finger does not raise the limit."""
    limit: float
    """Largest free vibration in m while a finger touches: of it a lift fills the bucket to the
    brim."""


class Vibration(NamedTuple):
    """Vibration that follows from the drives, in m peak-to-peak."""

    most: complex
    """Bound from above. `cut` keeps it within its limit unless drives are late."""
    E: float
    """Vibration at the bare resonance for the largest voltages; detuning and fingers lower it."""
    E_least: float
    """Vibration at the bare resonance for the smallest voltages."""
    least: float
    """Bound from below."""
    damping: float
    """Least damping of plate and finger, relative to the damping of the plate."""
    touching: bool
    """Whether a finger touches for certain; False as soon as it may have lifted."""
    low: float
    """Lowest frequency in Hz that the resonance may have."""
    high: float
    """Highest frequency in Hz that the resonance may have."""
    Fn: float
    """Measured normal force in N."""
    beyond: bool
    """Whether the pick-up read more than it may, so that the plate gets 0 V in this cycle. A finger
    that lifts takes its damping away before the loops can follow. At 0 V the plate falls by two
    thirds a cycle, so that a sound one is within its range again before a count is full."""
    release: Release


def bound_plan(si: Callable[[str], float], *, identified: bool) -> BoundPlan:
    """Return the parameters of the bounds.

    Parameters
    ----------
    si
        Function that returns the value of an object of ``stimulator.eds`` in SI units.
    identified
        Whether the model comes from an identification.
    """
    limit = si("Limit.Amplitude by drive")
    tolerance = si("Model.Data sheet tolerance")
    gain, tau = si("Model.Gain per volt"), si("Model.Tau")
    believed = (1.0 + _GAIN_UNCERTAINTY) * gain if identified else gain
    sheet_tau = si("Model.Data sheet tau")
    least, most = (1.0 - tolerance) * sheet_tau, (1.0 + tolerance) * sheet_tau
    return BoundPlan(
        identified=identified,
        limit=limit,
        bare_limit=min(AMPLITUDE_TRIP_MAX, limit),
        trip=si("Limit.Amplitude trip"),
        gain=gain,
        tau=tau,
        decay=exp(-TICK / tau),
        most_gain=max(believed, (1.0 - tolerance) * si("Model.Data sheet gain per volt")),
        believed_tau=min(max(tau, least), most),
        f0=si("Model.Resonance"),
        found_at=si("Model.Temperature"),
        softest=si("Model.Softening") * limit,
    )


def still(plan: BoundPlan) -> Vibration:
    """Return the vibration of a plate at rest, without a finger."""
    release = Release(0j, (0.0, 0.0), 0.0, 0, plan.bare_limit)
    return Vibration(0j, 0.0, 0.0, 0.0, 1.0, False, plan.f0, plan.f0, 0.0, False, release)


def without_lifts(plan: BoundPlan, vibration: Vibration) -> Vibration:
    """Return the vibration with an empty bucket, for a new run."""
    release = Release(vibration.release.free, (0.0, 0.0), 0.0, 0, plan.bare_limit)
    return vibration._replace(release=release)


_NOTHING: Final = Response(0j, 0j)
UNDRIVEN: Final = InForce(
    Drive(0.0, nan), 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, False, _NOTHING, _NOTHING, _NOTHING
)
"""State before the first drive."""


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
        Vibration at the measurement before.
    in_force
        Drives since the measurement before.
    measurement
        Measurement of this cycle. Its temperature is used; the pick-up only for the phase of the
        bound from below, and to lower what is allowed.
    contact
        The finger in this cycle.
    ticks
        Ticks since the measurement before; 0 for another measurement of a tick.
    """
    bound, E, E_least, least, _, _, low, high, Fn_before, _, _ = before
    drive, _, V_most, V_least, V_most_before, V_least_before, _, _, _, response, _, _ = in_force
    beyond = bool(measurement.saturated & PICKUP_SATURATED) or abs(measurement.W) > plan.trip
    Fn = contact.Fn if contact.Fn > 0.0 else 0.0
    falling = _FORCE_LEAD * (Fn - Fn_before) / (ticks or 1) if Fn < Fn_before else 0.0
    least_Fn = (1.0 - _FORCE_TOLERANCE) * Fn - _FORCE_UNCERTAINTY + falling
    touching = contact.touching and least_Fn > 0.0
    decay = plan.decay**ticks
    driven = plan.gain * max(V_most, V_most_before)
    E = driven + (E - driven) * decay
    driven = plan.gain * V_least
    E_least = driven + (E_least - driven) * decay
    # Largest and smallest contact that the reading may stand for.
    most_contact = contact_load((1.0 + _FORCE_TOLERANCE) * Fn + _FORCE_UNCERTAINTY)
    least_contact = 0.0
    if touching:
        least_contact = contact_load(least_Fn)
    damping = 1.0 + MOST_LOAD * most_contact
    voltage = min(V_least, V_least_before)
    driven = 0.0
    # Without a voltage there may have been no drive yet, and then its frequency is NaN.
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
            Fn,
            beyond,
            _released(plan, before.release, in_force, (touching, beyond), ticks),
        ),
    )


def _released(
    plan: BoundPlan,
    before: Release,
    in_force: InForce,
    seen: tuple[bool, bool],
    ticks: int,
) -> Release:
    """Return what lifts can have released.

    ``seen`` are whether a finger touches for certain, and whether the pick-up reads too much; the
    other arguments are those of `follow`.
    """
    touching, beyond = seen
    free, unnoticed, released, calm, _ = before
    left, per_volt = in_force.free
    for _ in range(ticks):
        free = left * free + per_volt * in_force.most
    above = free.real * free.real + free.imag * free.imag
    above = ticks * above if above > plan.bare_limit * plan.bare_limit * ROUNDING else 0.0
    if touching:
        unnoticed = (above, unnoticed[0])
    else:
        released += above + unnoticed[0] + unnoticed[1]
        unnoticed = (0.0, 0.0)
    released = max(released - ticks * _FORGOTTEN, 0.0)
    calm = _CALM if beyond else max(calm - ticks, 0)
    limit = plan.bare_limit
    if not calm:
        room = max(_RELEASED_MAX - released, 0.0)
        limit = max(limit, min(sqrt(room / _UNNOTICED), _RELEASE_MAX))
    return tuple.__new__(Release, (free, unnoticed, released, calm, limit))


def cut_and_record(
    plan: BoundPlan, vibration: Vibration, in_force: InForce, drive: Drive, late: bool
) -> tuple[InForce, Drive]:
    """Cut the voltage of a drive, and record the drive as in force.

    If the drive is late, it comes into force during the next cycle or never. The drives before it
    may then stay in force until a drive arrives in time, and during that cycle too.

    Parameters
    ----------
    plan, vibration
        Limits and model; vibration at the measurement that is answered.
    in_force
        Drives that may have been in force until this drive.
    drive
        Drive to be sent.
    late
        Whether the drive reaches the plate too late for this cycle.

    Returns
    -------
    tuple
        State of the drives in force until the next measurement, and the drive to send.

    Notes
    -----
    Without contact the limit is at most 3.27 um, the end of the pick-up's range. While a finger
    touches it is ``Limit.Amplitude by drive``, as a finger may damp more than the bound assumes,
    and the free vibration has the limit of what a lift may release.
    """
    response = free = response_at(plan, vibration, drive.frequency, 1.0)
    limit = plan.bare_limit
    if vibration.touching:
        response = response_at(plan, vibration, drive.frequency, vibration.damping)
        drive = cut(response, vibration.most, plan.limit, drive)
        limit = vibration.release.limit
    drive = cut(free, vibration.release.free, limit, drive)
    return with_drive(in_force, drive, response, free, late), drive


def response_at(
    plan: BoundPlan, vibration: Vibration, frequency: float, damping: float
) -> Response:
    """Return the response of a bound from above to one tick at a frequency in Hz.

    The damping is relative to that of the plate.
    """
    off = 0.0
    if plan.identified:
        if frequency < vibration.low:
            off = vibration.low - frequency
        elif frequency > vibration.high:
            off = vibration.high - frequency
    turn = complex(-damping / plan.believed_tau, _TWO_PI * off)
    left = exp_j(turn * TICK)
    per_volt = plan.most_gain / plan.believed_tau * (left - 1.0) / turn
    return tuple.__new__(Response, (left, per_volt))


def cut(response: Response, vibration: complex, limit: float, drive: Drive) -> Drive:
    """Return a drive with its voltage cut so that a vibration in m stays within a limit in m."""
    V, f = drive
    left, per_volt = response
    free = left * vibration
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


def with_drive(
    in_force: InForce, drive: Drive, response: Response, free: Response, late: bool
) -> InForce:
    """Return the drives that may be in force until the next measurement, after a drive was sent."""
    was, turning, most, least, _, _, held_most, held_least, was_late, _, _, held = in_force
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
            drive, turning, V_most, V_least, most, least, held_most, held_least, late, larger,
            free, held,
        ),
    )  # fmt: skip


def _least_share(
    plan: BoundPlan, low: float, high: float, frequency: float, damping: float
) -> float:
    """Return the least vibration of the plate as a fraction of that at resonance, 0..1."""
    off = max(abs(frequency - low), abs(frequency - high))
    x = _TWO_PI * off * plan.believed_tau / damping
    return 1.0 / sqrt(1.0 + x * x)


def _read_share(W: complex) -> float:
    """Return this fraction for an unidentified plate, from the phase that the pick-up reads."""
    amplitude = abs(W)
    if amplitude > _PHASE_FROM and W.real > _PHASE_MIN * amplitude:
        return W.real / amplitude
    return 1.0
