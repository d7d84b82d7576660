"""A discrete PI controller whose anti-windup is structural: ``C(z) = Kp (z - a)/(z - 1)``.

The law is ``u[k] = u[k-1] + Kp e[k] - Kp a e[k-1]``. The only state is what follows from the output
that was realised after all limits, so there is nothing that could wind up.
"""

from __future__ import annotations

from dataclasses import dataclass


def regulated(
    state: float, Kp: float, a: float, error: float, low: float, high: float
) -> tuple[float, float, bool]:
    """Return the output of a tick within its limits, the state after it, and whether it was cut.

    Parameters
    ----------
    state
        After the tick before; an output to start from makes the first one differ by ``Kp error``.
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


@dataclass(slots=True)
class PI:
    """A PI controller."""

    Kp: float
    """Gain in units of the output per unit of the error; negative for a plant of negative gain."""
    a: float
    """Zero, 0..1; placed on the plant's pole."""
    state: float = 0.0
    """After the last tick; an output put here is taken over from without a bump."""
