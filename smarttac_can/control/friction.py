"""The outer loop C_mu: from the friction error to the amplitude reference, eq. (8) and (9)."""

from __future__ import annotations

from typing import Final

from smarttac_can.vocabulary.states import Law

_MEASURED: Final = int(Law.MEASURED)
"""Looking a member up costs more than a step of the law."""
_ACCUMULATE: Final = int(Law.ACCUMULATE)


def relative_error(mu: float, mu_ref: float) -> float:
    """Return E of eq. (8) in %: by how much the COF is above its reference, above 0."""
    return 100.0 * (mu - mu_ref) / mu_ref


def limited_step(slope: float, step_max: float, E: float) -> float:
    """Return dW in m for a friction error in %, eq. (9).

    Parameters
    ----------
    slope
        Step in m per % of friction error; 0.04 um in the paper.
    step_max
        Largest step in m; 1 um in the paper. The prose around eq. (9) gives the same sign at both
        ends; the equation, which is followed here, does not.
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
        Of `Law`: what the step is added to.
    dW
        Step in m, of `limited_step`.
    amplitude
        Measured ``|W|`` in m; base of the law ``measured``.
    W_ref
        The reference of the tick before in m; base of ``accumulate``.
    W_nominal
        The user's amplitude in m; base of ``nominal``.
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
        Whether it was.
    position, boundary
        In m.
    half
        Half of the width in m of the band in which the side does not change.
    """
    return not position < boundary - half if right else position > boundary + half
