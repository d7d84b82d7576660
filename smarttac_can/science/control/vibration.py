"""The inner loops: C_W from amplitude to voltage, C_omega from phase to frequency.

Both are ``C(z) = Kp (z - a)/(z - 1)``, that is ``u[k] = u[k-1] + Kp e[k] - Kp a e[k-1]``. Their
only state is computed from the output after all limits, so they cannot wind up.

C_W controls ``|W|``. The paper's W_d equals it at resonance, but with the detuning of Fig. 5 the
amplitude would stay 30 % too high. C_omega controls ``W_q/W_d`` to 0, its value at resonance.
Without enough vibration, or with W_d <= 0, which no steady state has, it holds the frequency.
"""

from __future__ import annotations

from enum import IntFlag
from typing import Final

AMPLITUDE_MIN = 0.1e-6
"""Amplitude in m below which the resonance loop is frozen, as the phase of W is noise."""
TANGENT_MAX = 2.0
"""Bound of W_q/W_d: above about 60 deg the tangent grows fast while the angle hardly changes."""
DETUNED_SHARE: Final = 0.75
"""Fraction of the amplitude limit to which the reference is reduced off resonance: when the
resonance is found, the vibration overshoots by up to 29 %. The pick-up ends 9 % above the limit."""
_DETUNED: Final = 0.5
"""Tangent of the phase above which it is off resonance: 27 degrees, 80 Hz."""


class Limit(IntFlag):
    """Limits that were active in a tick."""

    VOLTAGE = 1
    AMPLITUDE = 2
    FREQUENCY = 4


# Plain integers, as IntFlag arithmetic takes ten times as long.
VOLTAGE, AMPLITUDE, FREQUENCY = (int(limit) for limit in Limit)


def regulated(
    state: float, Kp: float, a: float, error: float, low: float, high: float
) -> tuple[float, float, bool]:
    """Return the output of a PI within its limits, its new state, and whether it was limited.

    Parameters
    ----------
    state
        State after the tick before. If it is an output to start from, the first output differs by
        ``Kp error`` from it.
    Kp, a
        Gain and zero.
    error
        Error of the tick.
    low, high
        Limits of the output.
    """
    output = state + Kp * error
    limited = True
    if output < low:
        output = low
    elif output > high:
        output = high
    else:
        limited = False
    return output, output - Kp * a * error, limited


def lost(W: complex, amplitude: float) -> bool:
    """Return whether the vibration is too small, or W_d <= 0, which no steady state has."""
    return amplitude < AMPLITUDE_MIN or W.real <= 0.0


def resonance_error(W: complex) -> float:
    """Return -W_q/W_d within its bound, for a vibration that is not lost."""
    error = -W.imag / W.real
    return TANGENT_MAX if error > TANGENT_MAX else -TANGENT_MAX if error < -TANGENT_MAX else error


def allowed_amplitude(
    W_ref: float, W_max: float, W: complex, amplitude: float, tracked: bool
) -> float:
    """Return an amplitude reference in m within its limits.

    Parameters
    ----------
    W_ref, W_max
        Reference and its limit in m; a NaN reference becomes the limit.
    W, amplitude
        Vibration and its modulus in m.
    tracked
        Whether the frequency follows the resonance.
    """
    if not 0.0 <= W_ref <= W_max:
        W_ref = 0.0 if W_ref < 0.0 else W_max
    if W_ref > DETUNED_SHARE * W_max and tracked and amplitude > AMPLITUDE_MIN:
        # The resonance loop has not found the resonance yet.
        detuned = abs(W.imag) > _DETUNED * W.real
        return DETUNED_SHARE * W_max if detuned else W_ref
    return W_ref


def cut_voltage(V: float, V_max: float) -> float:
    """Return a voltage in V cut to 0..V_max; -0 and below become 0, NaN stays NaN."""
    return 0.0 if V <= 0.0 else V_max if V_max < V else V


def in_limits(V: float, f: float, V_max: float, f_min: float, f_max: float) -> bool:
    """Return whether a drive in V and Hz is within its limits; False for NaN."""
    return 0.0 <= V <= V_max and f_min <= f <= f_max
