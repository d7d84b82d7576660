"""Model of the plate in the controllers: eq. (6) and (7), with the effect of finger and warmth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

_ROUNDING = 1e-15
LOAD_FORCE: Final = 0.5
"""Normal force in N for which the load of a model is given."""
_GROWTH: Final = 2.0 / 3.0
"""Exponent with which a Hertz contact, and its damping, grow with the force."""
F0_SLOPE: Final = -14.0
"""Change of the resonance in Hz/K; paper, section on Fig. 5."""
GAIN_MIN = 1e-9
"""Least gain in m peak-to-peak per V that the controllers accept."""
TAU_MIN = 1e-4
"""Shortest time constant in s that the controllers accept: a tenth of a tick."""


def require(name: str, value: float, low: float, high: float) -> None:
    """Check that a number is within ``low..high``.

    Raises
    ------
    ValueError
        The number is outside, or NaN; the message names the value and its bounds.
    """
    # A bound computed as an integer times a unit may be off by the last bit.
    if not low - _ROUNDING * abs(low) <= value <= high + _ROUNDING * abs(high):
        raise ValueError(f"{name} {value:g} is outside {low:g}..{high:g}")


def contact_load(Fn: float) -> float:
    """Return the contact at a normal force in N relative to that at 0.5 N; 0 without a force."""
    return float((Fn / LOAD_FORCE) ** _GROWTH) if Fn > 0.0 else 0.0


def decay_rate(load: float, tau: float, contact: float) -> float:
    """Return 1/tau in 1/s for a contact of `contact_load`, with a bare tau and the load."""
    return (1.0 + load * contact) / tau


@dataclass(frozen=True, slots=True)
class PlateModel:
    """First-order model of the unloaded plate near its resonance.

    In the frame of the drive voltage ``tau W' = -(1 + j tau dw) W + gain V`` with dw the angular
    frequency above resonance: eq. (6) and (7) of the paper are its real and imaginary part.
    """

    gain: float = 50e-9
    """W/V at resonance, ``N/(d_s w0)``, in m peak-to-peak per V, 1e-9..1e-6; an assumption."""
    tau: float = math.sqrt(1.30**2 - 1.0) / (2.0 * math.pi * 140.0)
    """Time constant ``2m/d_s`` in s, 1e-4..1e-2; 0.944 ms from the 30 % of Fig. 6 at 140 Hz."""
    f0: float = 43390.0
    """Resonance frequency in Hz, 1e3..1e6; 43390 Hz at 20 degC in the paper."""

    load: float = 0.87
    """Damping that a finger of 0.5 N adds, relative to that of the bare plate, 0..5. An assumption:
    the mean of the simulated fingertips."""
    temperature: float = 20.0
    """Temperature in degC at which f0 was measured, -40..125."""
    softening: float = 0.0
    """Fall of the resonance from f0 with the amplitude in Hz/m peak-to-peak, -1e9..1e9."""

    def __post_init__(self) -> None:
        require("gain", self.gain, GAIN_MIN, 1e-6)
        require("tau", self.tau, TAU_MIN, 1e-2)
        require("f0", self.f0, 1e3, 1e6)
        require("load", self.load, 0.0, 5.0)
        require("temperature", self.temperature, -40.0, 125.0)
        require("softening", self.softening, -1e9, 1e9)

    @property
    def quality(self) -> float:
        """Quality factor ``Q = pi f0 tau``."""
        return math.pi * self.f0 * self.tau

    def decay_rate(self, contact: float) -> float:
        """Return 1/tau in 1/s for a contact of `contact_load`.

        The gain is proportional to tau: ``kappa = K/tau``, the force per volt over the mass, is
        constant.
        """
        return decay_rate(self.load, self.tau, contact)

    def load_of_press(self, V: float, W: complex, Fn: float) -> float:
        """Return the load from one press in steady state.

        Parameters
        ----------
        V
            Voltage in V.
        W
            Vibration W_d + jW_q under the finger in m, with any detuning.
        Fn
            Normal force in N, above 0.

        Notes
        -----
        It follows from the real part of ``kappa V/W = 1/tau + j (w - w0)``.
        """
        square = W.real * W.real + W.imag * W.imag
        return (self.gain * V * W.real / square - 1.0) / contact_load(Fn)
