"""The two loops of the plate: amplitude by voltage, resonance by frequency."""

from __future__ import annotations

from smarttac_can.control.pi import PI, regulated

AMPLITUDE_MIN = 0.1e-6
"""Below this amplitude in m the resonance loop is frozen: the phase of W is noise."""
TANGENT_MAX = 2.0
"""Bound of W_q/W_d: beyond some 60 deg the tangent runs away and the angle hardly changes."""


def lost(W: complex, amplitude: float) -> bool:
    """Whether there is too little vibration to follow, or W_d <= 0, which no steady state has."""
    return amplitude < AMPLITUDE_MIN or W.real <= 0.0


def resonance_error(W: complex) -> float:
    """Return -W_q/W_d within its bound, of a vibration that is not lost."""
    error = -W.imag / W.real
    return TANGENT_MAX if error > TANGENT_MAX else -TANGENT_MAX if error < -TANGENT_MAX else error


class AmplitudeLoop:
    """C_W of the d axis: from the amplitude error to a voltage in 0..V_max.

    ``|W|`` is fed back. The paper's W_d equals it at resonance, but detuned as in Fig. 5 it would
    leave the amplitude 30 % too high.
    """

    __slots__ = ("V_max", "limited", "pi")

    def __init__(self, pi: PI, V_max: float) -> None:
        self.pi = pi
        self.V_max = V_max
        self.limited = False

    def step(self, W_ref: float, amplitude: float) -> float:
        """Return the voltage in V for an amplitude and its reference in m."""
        pi = self.pi
        voltage, pi.state, self.limited = regulated(
            pi.state, pi.Kp, pi.a, W_ref - amplitude, 0.0, self.V_max
        )
        return voltage


class ResonanceLoop:
    """C_omega of the q axis: W_q/W_d to 0 by a frequency in f_min..f_max.

    Without enough vibration, or with W_d <= 0, which no steady state has, the frequency is held.
    """

    __slots__ = ("f_max", "f_min", "frequency", "limited", "pi")

    def __init__(self, pi: PI, f_min: float, f_max: float) -> None:
        self.pi = pi
        self.f_min = f_min
        self.f_max = f_max
        self.frequency = f_min
        self.limited = False

    def preset(self, frequency: float) -> None:
        """Start from a frequency in Hz, kept within the limits."""
        self.frequency = min(max(frequency, self.f_min), self.f_max)
        self.limited = self.frequency != frequency
        self.pi.state = self.frequency

    def limit(self, f_min: float, f_max: float) -> None:
        """Take other limits; the frequency that is held is cut to them."""
        self.f_min = f_min
        self.f_max = f_max
        if not f_min <= self.frequency <= f_max:
            self.preset(self.frequency)

    def step(self, W: complex, amplitude: float) -> float:
        """Return the excitation frequency in Hz for a vibration and its modulus in m."""
        pi = self.pi
        if lost(W, amplitude):
            pi.state = self.frequency
            return self.frequency
        self.frequency, pi.state, self.limited = regulated(
            pi.state, pi.Kp, pi.a, resonance_error(W), self.f_min, self.f_max
        )
        return self.frequency
