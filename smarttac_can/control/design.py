"""Design of the two PI controllers by pole placement on the identified plate.

Held over a tick, the drive k takes effect after the dead time d, 0 <= d < Ts, until when drive
k-1 is in force. The plant of gain K and time constant tau is then exactly ::

    P(z) = (b0 z + b1) / (z (z - a)),           a = exp(-Ts/tau)
    b0 = K (1 - exp(-(Ts - d)/tau)),            b1 = K (exp(-(Ts - d)/tau) - a)

The zero of ``C(z) = Kp (z - a)/(z - 1)`` cancels the plant's pole; what remains to be placed is ::

    z^2 - (1 - Kp b0) z + Kp b1 = 0

A pole p asks for ``Kp = p (1 - p)/(b0 p + b1)``; the other one is then ``q = Kp b1/p``. p is the
slower of the two, and both are real, as long as p is not below the double pole ::

    p_c = 1 / (1 + sqrt(1 + b0/b1))

which is where ``(1 - Kp b0)^2 = 4 Kp b1``. A faster p is refused by the dead time: p_c is taken,
the fastest loop without overshoot. Without dead time b1 = 0, p_c = 0, ``Kp = (1-p)/(K (1-a))``.
"""

from __future__ import annotations

import math

from smarttac_can.control.pi import PI
from smarttac_can.vocabulary.model import PlateModel, require
from smarttac_can.vocabulary.signals import TICK

POLE_MAX = 0.95
"""Slowest closed-loop pole that may be asked for: 20 ms."""


def dominant_pole(tau: float, pole: float, dead_time: float) -> float:
    """Return the slower closed-loop pole reached when ``pole`` is asked for."""
    _, b0, b1 = _plant(tau, dead_time)
    return max(pole, 1.0 / (1.0 + math.sqrt(1.0 + b0 / b1))) if b1 > 0.0 else pole


def amplitude_pi(model: PlateModel, pole: float, dead_time: float = 0.0) -> PI:
    """Return the controller from amplitude error in m to voltage in V, eq. (6).

    Parameters
    ----------
    model
        Identified plate.
    pole
        Closed-loop pole wanted, 0..0.95.
    dead_time
        Time from the tick until the new drive is in force in s, 0 or more, below 1 ms.

    Raises
    ------
    ValueError
        If the pole or the dead time is out of its range.
    """
    return _pi(model.gain, model.tau, pole, dead_time)


def resonance_pi(model: PlateModel, pole: float, dead_time: float = 0.0) -> PI:
    """Return the controller from ``-W_q/W_d`` to the excitation frequency in Hz, eq. (7).

    The gain of eq. (7) is -tau in rad/s, hence -2 pi tau in Hz. Parameters and errors as for
    :func:`amplitude_pi`.
    """
    return _pi(-2.0 * math.pi * model.tau, model.tau, pole, dead_time)


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
    # Through expm1, so that no dead time gives b1 = 0 and not a rounding error.
    before = math.expm1(-dead_time / tau)
    b0 = 1.0 - math.exp(-(TICK - dead_time) / tau)
    b1 = -before * math.exp(-(TICK - dead_time) / tau)
    return a, b0, b1
