"""The vibration mode of eq. (1), solved exactly in the frame of the drive voltage."""

from __future__ import annotations

import cmath
import math


class Resonator:
    """State of the mode: envelope W = W_d + jW_q in m peak-to-peak, and its rate of change.

    ``m W" + (d + 2jmw) W' + (c - m w^2 + jwd) W = jN V_q`` has constant coefficients while the
    drive and the load are constant, so a step is the product with a matrix exponential: both
    second-order terms of eq. (4), (5) are kept, at any detuning, with no step-size error.

    Parameters
    ----------
    mass
        Modal mass m in kg, above 0.
    """

    __slots__ = ("W", "_equilibrium", "_mass", "_omega", "_phi", "rate")

    def __init__(self, mass: float) -> None:
        self.W = 0j
        self.rate = 0j
        self._mass = mass
        self._omega = 0.0
        self._phi = (1 + 0j, 0j, 0j, 1 + 0j)
        self._equilibrium = 0j

    def drive(
        self, duration: float, omega: float, force: float, damping: float, stiffness: float
    ) -> None:
        """Set what is constant over the coming steps.

        Parameters
        ----------
        duration
            Length of one step in s.
        omega
            Angular frequency w of the drive in rad/s.
        force
            N V_q in N peak-to-peak.
        damping
            d in N s/m, plate and finger; below 2 sqrt(c m).
        stiffness
            c in N/m, plate and finger.
        """
        if omega != self._omega:
            # The frame turns at another speed: W stays, its rate in the new frame does not.
            self.rate += 1j * (self._omega - omega) * self.W
            self._omega = omega
        mass = self._mass
        decay = 0.5 * damping / mass
        natural = math.sqrt(stiffness / mass - decay * decay)
        slow = complex(-decay, natural - omega)
        fast = complex(-decay, -natural - omega)
        e_slow = cmath.exp(slow * duration)
        e_fast = cmath.exp(fast * duration)
        scale = -0.5j / natural
        rise = (e_slow - e_fast) * scale
        self._phi = (
            (slow * e_fast - fast * e_slow) * scale,
            rise,
            -slow * fast * rise,
            (slow * e_slow - fast * e_fast) * scale,
        )
        self._equilibrium = 1j * force / complex(stiffness - mass * omega * omega, omega * damping)

    def steps(self, count: int) -> list[complex]:
        """Advance by so many durations of :meth:`drive`; return W after each."""
        p11, p12, p21, p22 = self._phi
        equilibrium = self._equilibrium
        W, rate = self.W, self.rate
        way = []
        for _ in range(count):
            deviation = W - equilibrium
            W = equilibrium + p11 * deviation + p12 * rate
            rate = p21 * deviation + p22 * rate
            way.append(W)
        self.W, self.rate = W, rate
        return way
