"""Parameters of the plate: resonator, thermal node and sensors.

Every number has its unit and its source: [P] the paper, [D] derived from the paper's numbers, [L]
literature or data sheet, [A] an assumption.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, Self

import numpy as np

TWO_PI = 2.0 * math.pi
LEAST_WINDOW: Final = 1e-6
"""Shortest window of a pick-up in s."""


def require(name: str, value: object, low: float, high: float) -> None:
    """Check that a number, or every element of an array, is within a closed range.

    Raises
    ------
    ValueError
        It is outside, NaN, or text. One line gives the name, the value and the bounds.
    """
    if isinstance(value, int | float):  # an array of one takes twenty times as long
        within = low <= value <= high
    elif np.asarray(value).dtype.kind in "SU":
        raise ValueError(f"{name} {value!r} is text, no number")
    else:
        numbers = np.asarray(value, dtype=np.float64)
        within = bool(np.all((numbers >= low) & (numbers <= high)))
    if not within:
        raise ValueError(f"{name} {value} is outside {low:g}..{high:g}")


def resonance_at(f0: float, slope: float, warmer: float) -> float:
    """Return the resonance in Hz at ``warmer`` K above the temperature of f0; slope in Hz/K."""
    return f0 + slope * warmer


def stiffness_of(mass: float, resonance: float) -> float:
    """Return the modal stiffness in N/m of a mass in kg with a resonance in Hz."""
    omega0 = TWO_PI * resonance
    return mass * omega0 * omega0


@dataclass(frozen=True, slots=True)
class ResonatorParameters:
    """The vibration mode of eq. (1), without a finger."""

    mass: float = 5e-3
    """Modal mass m in kg [A]: about half of the 10 g of a 76 x 41 x 1.2 mm3 aluminium plate."""
    f0: float = 43390.0
    """Resonance frequency in Hz at :attr:`reference_temperature` [P]."""
    f0_slope: float = -14.0
    """Change of the resonance frequency in Hz/K [P]: 43250 Hz at 30 degC."""
    reference_temperature: float = 20.0
    """Temperature in degC at which :attr:`f0` applies [P]."""
    softening: float = 0.0
    """Fall of the resonance with the amplitude in Hz/m peak-to-peak, -1e9..1e9. 0 is a linear plate
    [A]; piezo plates have about 60e6 to 150e6."""
    neighbour_share: float = 0.0
    """Ratio of the gain of a neighbouring mode to that of this one, -1..1; 0 for none [A]. The
    pick-up sees both modes; the finger is assumed to feel only this one."""
    neighbour_offset: float = 600.0
    """Resonance of the neighbouring mode minus that of this one in Hz, -5e3..5e3 [A]."""
    tau: float = math.sqrt(1.30**2 - 1.0) / (TWO_PI * 140.0)
    """Time constant 2m/d_s in s [D]: 30 % more voltage at 140 Hz of detuning, 0.944 ms."""
    gain: float = 50e-9
    """Vibration at resonance in m peak-to-peak per V [A]."""
    damping: float = field(init=False)
    """Modal damping d_s in N s/m."""
    conversion: float = field(init=False)
    """Electromechanical conversion N in N/V; the force, like W, is peak-to-peak."""

    def __post_init__(self) -> None:
        require("mass", self.mass, 1e-3, 1.0)
        require("f0", self.f0, 5e3, 1e6)
        require("f0_slope", self.f0_slope, -1e3, 1e3)
        require("reference_temperature", self.reference_temperature, -40.0, 125.0)
        require("softening", self.softening, -1e9, 1e9)
        require("neighbour_share", self.neighbour_share, -1.0, 1.0)
        require("neighbour_offset", self.neighbour_offset, -5e3, 5e3)
        require("tau", self.tau, 1e-5, 1.0)
        require("gain", self.gain, 1e-12, 1e-3)
        object.__setattr__(self, "damping", 2.0 * self.mass / self.tau)
        object.__setattr__(self, "conversion", self.gain * self.damping * TWO_PI * self.f0)

    def resonance(self, temperature: float) -> float:
        """Return the resonance frequency in Hz at rest, at a plate temperature in degC."""
        return resonance_at(self.f0, self.f0_slope, temperature - self.reference_temperature)

    def stiffness(self, temperature: float) -> float:
        """Return the modal stiffness c in N/m at a plate temperature in degC."""
        return stiffness_of(self.mass, self.resonance(temperature))


@dataclass(frozen=True, slots=True)
class ThermalParameters:
    """First-order thermal node of the plate, heated by its modal loss."""

    resistance: float = 12.0
    """Thermal resistance from plate to ambient in K/W [A]."""
    time_constant: float = 150.0
    """Thermal time constant in s [A]."""

    def __post_init__(self) -> None:
        require("resistance", self.resistance, 0.0, 1e3)
        require("time_constant", self.time_constant, 0.1, 1e5)


@dataclass(frozen=True, slots=True)
class SensorParameters:
    """Strain gauges, vibration pick-up and thermometer."""

    serial: int = 1
    """Serial number of the hardware, which seeds the individual data of each gauge."""
    path_frequency: float = 100.0
    """Natural frequency of the force path, flexure and filter, in Hz [A]."""
    path_damping: float = 0.7
    """Damping ratio of the force path [A]."""
    crosstalk: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.04), (-0.03, 1.02))
    """(S1, S2) = crosstalk (Fx, Fy) [A]."""
    node_x: float = 28e-3
    """Distance in m of S3..S6 from the middle along the plate's 76 mm [A]."""
    null: float = 1.2
    """Bound of the output of a gauge without load in N [L, FSS1500]."""
    drift: float = 41e-3 / 15.0
    """Bound of the null shift of a gauge in N/K [L, FSS1500: 41 mN over 15 K]."""
    drift_temperature: float = 20.0
    """Temperature in degC at which a gauge has its null [A]."""
    linearity: float = 0.22
    """Bound of the bow of a gauge in N over :attr:`span` [L, FSS1500: 1.5 % of it]; its slope at
    no load is calibrated [A]."""
    span: float = 14.7
    """Span of a gauge in N [L, FSS1500]."""
    sensitivity: float = 0.0
    """Bound of the error of a gauge's sensitivity, as a fraction, 0..0.5; 0 for gauges that are
    trimmed [A]. See :meth:`data_sheet`."""
    sensitivity_shift: float = 0.0
    """Bound of the shift of a gauge's sensitivity in 1/K, 0..0.01 [A]; 0 for none."""
    repeatability: float = 0.0
    """Bound of the repeatability of a gauge as a fraction of its load, 0..0.5; 0 for none [A]. Its
    error is normal, with the bound over the square root of 3 as standard deviation, and changes
    within about 1 s [A]."""
    gauge_noise: float = 4.3e-3
    """Standard deviation of a gauge in N [A]: u(mu) is 0.011 at Fn = 0.5 N and mu = 0.4."""
    pickup_noise: float = 1e-9
    """Standard deviation of the noise of each axis of the pick-up in m [A]."""
    pickup_window: float = 0.0
    """Time in s before the tick over which the pick-up averages, 1e-6..0.001; 0 for none [A]."""
    pickup_lag: float = 0.0
    """Time constant in s of the low-pass filter after the pick-up's demodulator, 0..0.01 [A]."""
    temperature_noise: float = 5e-3
    """Standard deviation of the noise of the thermometer in K [A]."""
    gauge_resolution: float = 1e-4
    """Step of the gauge converter in N [A]."""
    pickup_resolution: float = 1e-10
    """Step of the converter of each axis of the pick-up in m [A]."""
    temperature_resolution: float = 1e-2
    """Step of the thermometer in K [A]."""
    full_scale: int = 32767
    """Range of the converters of gauges and pick-up, as +- this number of steps [A]."""

    def __post_init__(self) -> None:
        require("serial", self.serial, 0, 2**32 - 1)
        require("path_frequency", self.path_frequency, 1.0, 1e5)
        require("path_damping", self.path_damping, 0.05, 0.99)
        require("crosstalk", self.crosstalk, -2.0, 2.0)
        (a, b), (c, d) = self.crosstalk
        require("crosstalk determinant", abs(a * d - b * c), 0.1, 8.0)
        require("node_x", self.node_x, 1e-3, 38e-3)
        for name in ("null", "linearity", "span"):
            require(name, getattr(self, name), 0.0, 100.0)
        require("drift", self.drift, 0.0, 1.0)
        require("drift_temperature", self.drift_temperature, -40.0, 125.0)
        require("sensitivity", self.sensitivity, 0.0, 0.5)
        require("sensitivity_shift", self.sensitivity_shift, 0.0, 0.01)
        require("repeatability", self.repeatability, 0.0, 0.5)
        require("gauge_noise", self.gauge_noise, 0.0, 1.0)
        require("pickup_noise", self.pickup_noise, 0.0, 1e-6)
        least_window = LEAST_WINDOW if self.pickup_window else 0.0
        require("pickup_window", self.pickup_window, least_window, 1e-3)
        require("pickup_lag", self.pickup_lag, 0.0, 1e-2)
        require("temperature_noise", self.temperature_noise, 0.0, 10.0)
        require("gauge_resolution", self.gauge_resolution, 1e-9, 1.0)
        require("pickup_resolution", self.pickup_resolution, 1e-15, 1e-6)
        require("temperature_resolution", self.temperature_resolution, 1e-9, 1.0)
        require("full_scale", self.full_scale, 1, 2**31 - 1)

    @classmethod
    def data_sheet(cls, serial: int = 1, sensitivity: float = 0.17) -> Self:
        """Return sensors with gauges as their data sheet has them [L, FSS1500].

        Their sensitivity shifts by up to 5.5 % over 25 K, and repeats to 98 mN at 300 g. By default
        a gauge has its nominal sensitivity at any temperature and load.

        Parameters
        ----------
        serial
            Serial number of the hardware.
        sensitivity
            Bound of the error of the sensitivity, 17 % before the amplifiers are trimmed.
        """
        return cls(
            serial=serial,
            sensitivity=sensitivity,
            sensitivity_shift=0.055 / 25.0,
            repeatability=98e-3 / (0.3 * 9.80665),
        )


@dataclass(frozen=True, slots=True)
class ContactParameters:
    """Effects between the mode and the friction under the finger; none by default."""

    film_lag: float = 0.0
    """Time constant in s with which the squeeze film follows the vibration, 0..0.1 [A]."""
    ripple: float = 0.0
    """Change of the amplitude under a moving finger, as a fraction of W, 0..0.5 [A]. A contact of
    about 7 mm over nodes 8 mm apart leaves 0.08 to 0.11 of the mode shape."""
    node_distance: float = 8e-3
    """Distance between nodes along x in m [A]."""

    def __post_init__(self) -> None:
        require("film_lag", self.film_lag, 0.0, 0.1)
        require("ripple", self.ripple, 0.0, 0.5)
        require("node_distance", self.node_distance, 1e-3, 0.1)


@dataclass(frozen=True, slots=True)
class PlateParameters:
    """All parameters of the plate, without the finger."""

    resonator: ResonatorParameters = field(default_factory=ResonatorParameters)
    thermal: ThermalParameters = field(default_factory=ThermalParameters)
    sensors: SensorParameters = field(default_factory=SensorParameters)
    contact: ContactParameters = field(default_factory=ContactParameters)
