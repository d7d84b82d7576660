"""The outer loop C_mu: from the friction error to the amplitude reference, eq. (8) and (9)."""

from __future__ import annotations

from typing import Final

from smarttac_can.vocabulary.modes import Law

_MEASURED: Final = int(Law.MEASURED)
"""Looking a member up costs more than a step of the law."""
_ACCUMULATE: Final = int(Law.ACCUMULATE)


def relative_error(mu: float, mu_ref: float) -> float:
    """Return E of eq. (8) in %: by how much the COF is above its reference, above 0."""
    return 100.0 * (mu - mu_ref) / mu_ref


def limited_step(slope: float, step_max: float, E: float) -> float:
    """Return dW in m for a friction error in %, eq. (9)."""
    dW = slope * E
    return step_max if dW > step_max else -step_max if dW < -step_max else dW


def asked_amplitude(law: int, dW: float, amplitude: float, W_ref: float, W_nominal: float) -> float:
    """Return the next amplitude reference in m; the arguments are those of `FrictionLaw`."""
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


class FrictionLaw:
    """Eq. (9) and one of the three laws.

    Parameters
    ----------
    law
        What the step is added to.
    slope
        Step in m per % of friction error; 0.04 um in the paper.
    step_max
        Largest step dW in m; 1 um in the paper. The prose around eq. (9) gives the same sign at
        both ends; the equation, which is followed here, does not.
    """

    __slots__ = ("_law", "_slope", "_step_max")

    def __init__(self, law: Law, slope: float, step_max: float) -> None:
        self._law = law
        self._slope = slope
        self._step_max = step_max

    def step(self, E: float) -> float:
        """Return dW in m for a friction error in %, eq. (9)."""
        return limited_step(self._slope, self._step_max, E)

    def reference(self, E: float, amplitude: float, W_ref: float, W_nominal: float) -> float:
        """Return the next amplitude reference in m, before its limits.

        Parameters
        ----------
        E
            Friction error in %.
        amplitude
            Measured ``|W|`` in m; base of the law ``measured``.
        W_ref
            The reference of the tick before in m; base of ``accumulate``.
        W_nominal
            The user's amplitude in m; base of ``nominal``.
        """
        dW = limited_step(self._slope, self._step_max, E)
        return asked_amplitude(self._law, dW, amplitude, W_ref, W_nominal)


class Boundary:
    """Which side of the boundary the finger is on; crossed once in spite of a noisy position.

    Parameters
    ----------
    hysteresis
        Width in m of the band around the boundary in which the side does not change.
    """

    __slots__ = ("_half", "right")

    def __init__(self, hysteresis: float) -> None:
        self._half = 0.5 * hysteresis
        self.right = False

    def place(self, position: float, boundary: float) -> None:
        """Decide anew, without hysteresis."""
        self.right = position > boundary

    def update(self, position: float, boundary: float) -> bool:
        """Return whether the finger is right of the boundary."""
        self.right = right = is_right(self.right, position, boundary, self._half)
        return right
