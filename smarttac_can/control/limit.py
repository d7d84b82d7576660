"""What may cut off a drive, as bits."""

from __future__ import annotations

from enum import IntFlag
from typing import Final

from smarttac_can.control.vibration import AMPLITUDE_MIN

DETUNED_SHARE: Final = 0.75
"""Share of the amplitude limit up to which the reference goes off resonance: when the resonance is
found the vibration overshoots, by up to 29 %, and the pick-up ends 9 % above the limit."""
_DETUNED: Final = 0.5
"""Tangent of the phase from which it is off resonance: 27 degrees, 80 Hz."""


class Limit(IntFlag):
    """A limit that cut off what was asked for in this tick."""

    VOLTAGE = 1
    AMPLITUDE = 2
    FREQUENCY = 4


# Plain integers: IntFlag arithmetic costs ten times as much.
VOLTAGE, AMPLITUDE, FREQUENCY = (int(limit) for limit in Limit)


def allowed_amplitude(
    W_ref: float, W_max: float, W: complex, amplitude: float, tracked: bool
) -> float:
    """Return an amplitude reference in m within its limits.

    Parameters
    ----------
    W_ref, W_max
        Reference and its limit in m; a reference that is NaN becomes the limit.
    W, amplitude
        Vibration and its modulus in m.
    tracked
        Whether the resonance is.
    """
    if not 0.0 <= W_ref <= W_max:
        W_ref = 0.0 if W_ref < 0.0 else W_max
    if W_ref > DETUNED_SHARE * W_max and tracked and amplitude > AMPLITUDE_MIN:
        # The resonance loop still has to find the resonance.
        detuned = abs(W.imag) > _DETUNED * W.real
        return DETUNED_SHARE * W_max if detuned else W_ref
    return W_ref


def cut_voltage(V: float, V_max: float) -> float:
    """Return a voltage in V within 0..V_max; -0 and below become 0, NaN stays."""
    return 0.0 if V <= 0.0 else V_max if V_max < V else V


def in_limits(V: float, f: float, V_max: float, f_min: float, f_max: float) -> bool:
    """Whether a drive in V and Hz may go out; NaN may not."""
    return 0.0 <= V <= V_max and f_min <= f <= f_max
