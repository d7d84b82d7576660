"""The outer loop C_mu: amplitude reference from the friction error, eq. (8) and (9)."""

from __future__ import annotations

from typing import Final

from smarttac_can.vocabulary.states import Law

_MEASURED: Final = int(Law.MEASURED)
"""Module constant, as looking up an enumeration member takes longer than a step of the law."""
_ACCUMULATE: Final = int(Law.ACCUMULATE)


def relative_error(mu: float, mu_ref: float) -> float:
    """Return E of eq. (8) in %: the relative deviation of the COF from its reference, above 0."""
    return 100.0 * (mu - mu_ref) / mu_ref


def limited_step(slope: float, step_max: float, E: float) -> float:
    """Return dW in m for a friction error in %, eq. (9).

    Parameters
    ----------
    slope
        Step in m per % of friction error; 0.04 um in the paper.
    step_max
        Largest step in m; 1 um in the paper. The text around eq. (9) gives the same sign at both
        ends; the equation, which is used here, does not.
    E
        Friction error in %.
    """
    dW = slope * E
    return step_max if dW > step_max else -step_max if dW < -step_max else dW


def asked_amplitude(law: int, dW: float, amplitude: float, W_ref: float, W_nominal: float) -> float:
    """Return the next amplitude reference in m, before its limits.

    Parameters
    ----------
    law
        Number of `Law`, which determines to what the step is added.
    dW
        Step in m from `limited_step`.
    amplitude
        Measured ``|W|`` in m, the base of the law ``measured``.
    W_ref
        Reference of the tick before in m, the base of ``accumulate``.
    W_nominal
        User's amplitude in m, the base of ``nominal``.
    """
    if law == _MEASURED:
        return amplitude + dW
    if law == _ACCUMULATE:
        return W_ref + dW
    return W_nominal + dW


def is_right(right: bool, position: float, boundary: float, half: float) -> bool:
    """Return whether the finger is right of the boundary.

    Parameters
    ----------
    right
        Whether it was right of the boundary before.
    position, boundary
        Positions of finger and boundary in m.
    half
        Half of the hysteresis in m: within this distance of the boundary the side does not change.
    """
    return not position < boundary - half if right else position > boundary + half
