"""Design of the two PI controllers by pole placement on the identified plate.

The drive of tick k takes effect after the dead time d, 0 <= d < Ts; until then drive k-1 is in
force. Sampled once per tick, the plant with gain K and time constant tau is exactly ::

    P(z) = (b0 z + b1) / (z (z - a)),           a = exp(-Ts/tau)
    b0 = K (1 - exp(-(Ts - d)/tau)),            b1 = K (exp(-(Ts - d)/tau) - a)

The zero of ``C(z) = Kp (z - a)/(z - 1)`` cancels the plant's pole; what remains is ::

    z^2 - (1 - Kp b0) z + Kp b1 = 0

A pole p requires ``Kp = p (1 - p)/(b0 p + b1)``; the other pole is then ``q = Kp b1/p``. p is the
slower of the two, and both are real, if p is not below the double pole ::

    p_c = 1 / (1 + sqrt(1 + b0/b1))

at which ``(1 - Kp b0)^2 = 4 Kp b1``. The dead time does not allow a faster p; p_c is then used, the
fastest loop without overshoot. Without dead time b1 = 0, p_c = 0, ``Kp = (1-p)/(K (1-a))``.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

from smarttac_can.vocabulary.model import GAIN_MIN, TAU_MIN, PlateModel, contact_load, require
from smarttac_can.vocabulary.signals import TICK

POLE_MAX = 0.95
"""Slowest closed-loop pole that can be set: 20 ms."""
FORCE_STEP: Final = 0.05
"""Step of the table of gains in N; at 0.5 N it changes the time constant by 3 %."""
INVERTED_FORCE: Final = 1.0
"""Normal force in N for which the loop is inverted; at 0.5 or 2 N the gain at 100 Hz is then off by
5 % at most."""
ROWS: Final = 61
"""Rows of the table. The last one is for 3 N; above it the load grows slowly."""


class PI(NamedTuple):
    """A PI controller ``C(z) = Kp (z - a)/(z - 1)``."""

    Kp: float
    """Gain in units of the output per unit of the error; it has the sign of the plant."""
    a: float
    """Zero, 0..1; equal to the plant's pole."""


class Gains(NamedTuple):
    """Gains of both loops, which have the same zero."""

    amplitude: float
    """Kp of C_W in V/m."""
    resonance: float
    """Kp of C_omega in Hz."""
    a: float
    """Zero of both loops, 0..1."""


class Inverse(NamedTuple):
    """What an amplitude loop does, undone: the reference from the wanted amplitudes of 3 ticks."""

    new: float
    """Factor of the wanted amplitude of this tick."""
    last: float
    """Factor of that of the tick before."""
    older: float
    """Factor of that of the tick before this; the sum of all three is 1."""
    late: float
    """Time in s, beside a tick, by which the amplitude then follows."""


def dominant_pole(tau: float, pole: float, dead_time: float) -> float:
    """Return the slower closed-loop pole that results if ``pole`` is set."""
    _, b0, b1 = _plant(tau, dead_time)
    return max(pole, 1.0 / (1.0 + math.sqrt(1.0 + b0 / b1))) if b1 > 0.0 else pole


def amplitude_pi(model: PlateModel, pole: float, dead_time: float = 0.0) -> PI:
    """Return the controller from amplitude error in m to voltage in V, eq. (6).

    Parameters
    ----------
    model
        Identified plate.
    pole
        Closed-loop pole to be set, 0..0.95.
    dead_time
        Time from the tick until the new drive is in force in s, 0 or more, below 1 ms.

    Raises
    ------
    ValueError
        The pole or the dead time is out of its range.
    """
    return _pi(model.gain, model.tau, pole, dead_time)


@lru_cache
def amplitude_inverse(model: PlateModel, pole: float, dead_time: float) -> Inverse:
    """Return the inverse of the loop of `amplitude_pi` under a finger of `INVERTED_FORCE`.

    The loop is ``Kp (b0 z + b1)/(z^2 - (1 - Kp b0) z + Kp b1)``. Its inverse without the zero,
    which at some dead times rings or is unstable, leaves ``(b0 + b1/z)/(z (b0 + b1))``: a mean of
    two ticks. With 540 us its gain at 100 Hz is 0.96, that of the loop alone 0.75.

    Parameters
    ----------
    model, pole, dead_time
        As for `amplitude_pi`.
    """
    tau = max(1.0 / model.decay_rate(contact_load(INVERTED_FORCE)), TAU_MIN)
    _, b0, b1 = _plant(tau, dead_time)
    Kp, _ = _pi(1.0, tau, pole, dead_time)
    whole = Kp * (b0 + b1)
    return Inverse(1.0 / whole, (Kp * b0 - 1.0) / whole, Kp * b1 / whole, TICK * b1 / (b0 + b1))


def resonance_pi(model: PlateModel, pole: float, dead_time: float = 0.0) -> PI:
    """Return the controller from ``-W_q/W_d`` to the excitation frequency in Hz, eq. (7).

    The gain of eq. (7) is -tau in rad/s, or -2 pi tau in Hz. Parameters and errors are as for
    :func:`amplitude_pi`.
    """
    return _pi(_resonance_gain(model.tau), model.tau, pole, dead_time)


def _resonance_gain(tau: float) -> float:
    return -2.0 * math.pi * tau


def _pi(gain: float, tau: float, pole: float, dead_time: float) -> PI:
    require("pole", pole, 0.0, POLE_MAX)
    a, b0, b1 = _plant(tau, dead_time)
    p = dominant_pole(tau, pole, dead_time)
    Kp = p * (1.0 - p) / (b0 * p + b1) if b1 > 0.0 else (1.0 - p) / b0
    return PI(Kp / gain, a)


def _plant(tau: float, dead_time: float) -> tuple[float, float, float]:
    """Return a, b0, b1 for unit gain."""
    if not 0.0 <= dead_time < TICK:
        raise ValueError(f"dead_time {dead_time:g} is outside 0..{TICK:g}, the end excluded")
    a = math.exp(-TICK / tau)
    # With expm1, no dead time gives exactly b1 = 0.
    before = math.expm1(-dead_time / tau)
    b0 = 1.0 - math.exp(-(TICK - dead_time) / tau)
    b1 = -before * math.exp(-(TICK - dead_time) / tau)
    return a, b0, b1


@lru_cache(maxsize=16)
def designed(
    model: PlateModel, amplitude_pole: float, resonance_pole: float, dead_time: float
) -> tuple[Gains, tuple[Gains, ...]]:
    """Return the gains of both loops for the bare plate, and for the plate under a finger.

    Parameters
    ----------
    model
        Unloaded plate, with the load of a finger.
    amplitude_pole, resonance_pole, dead_time
        As for `amplitude_pi`.

    Returns
    -------
    bare, rows
        Gains for the bare plate, and those for the normal forces 0, 0.05 .. 3 N.
    """
    amplitude = amplitude_pi(model, amplitude_pole, dead_time)
    resonance = resonance_pi(model, resonance_pole, dead_time)
    rows = []
    for row in range(ROWS):
        tau = max(1.0 / model.decay_rate(contact_load(FORCE_STEP * row)), TAU_MIN)
        gain = max(model.gain * tau / model.tau, GAIN_MIN)
        Kp_W, a = _pi(gain, tau, amplitude_pole, dead_time)
        Kp_omega, _ = _pi(_resonance_gain(tau), tau, resonance_pole, dead_time)
        rows.append(Gains(Kp_W, Kp_omega, a))
    return Gains(amplitude.Kp, resonance.Kp, amplitude.a), tuple(rows)


def row_of(Fn: float, rows: int) -> int:
    """Return the row for a normal force in N, 0 without a finger, in a table with ``rows`` rows."""
    return min(int(Fn / FORCE_STEP + 0.5), rows - 1) if Fn > 0.0 else 0
