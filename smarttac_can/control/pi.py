"""A discrete PI controller whose anti-windup is structural."""

from __future__ import annotations


class PI:
    """PI controller ``C(z) = Kp (z - a)/(z - 1)``.

    The law is ``u[k] = u[k-1] + Kp e[k] - Kp a e[k-1]``. :meth:`compute` asks for an output and
    changes nothing; :meth:`update` hands back the output that was realised after all limits. The
    only state is what follows from the realised output, so there is nothing that could wind up.

    Parameters
    ----------
    Kp
        Gain in units of the output per unit of the error; negative for a plant of negative gain.
    a
        Zero, 0..1; placed on the plant's pole.
    """

    __slots__ = ("Kp", "_state", "a")

    def __init__(self, Kp: float, a: float) -> None:
        self.Kp = Kp
        self.a = a
        self._state = 0.0

    def compute(self, error: float) -> float:
        """Return the output this error asks for, before limits."""
        return self._state + self.Kp * error

    def update(self, error: float, realised: float) -> None:
        """Close the tick with the output that was really put out for this error."""
        self._state = realised - self.Kp * self.a * error

    def preset(self, output: float) -> None:
        """Take over from an output: the next one differs from it by ``Kp error``, no more."""
        self._state = output
