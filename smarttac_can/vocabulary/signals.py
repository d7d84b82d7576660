"""The values that cross between plate and controller, in SI units.

They are small, frozen and know nothing of the bus: scaling to integers happens at the object
dictionary, and the tick counts that pair a drive with its measurement belong to the nodes.
"""

from __future__ import annotations

from typing import Final, NamedTuple

TICK: Final = 1e-3
"""Period Ts of the loop in s: 1 ms."""


class Drive(NamedTuple):
    """What the controller asks of the power stage, in force until the next drive."""

    voltage: float
    """Amplitude of the supply voltage V_q in V, 0 or more (V_d = 0 by choice of the frame)."""
    frequency: float
    """Excitation frequency in Hz."""


class Measurement(NamedTuple):
    """What the plate reports once a tick."""

    W: complex
    """Vibration W_d + jW_q in m peak-to-peak, in the frame of the drive voltage."""
    gauges: tuple[float, float, float, float, float, float]
    """Raw strain-gauge forces S1..S6 in N: S1, S2 lateral, S3..S6 normal at the nodes."""
    temperature: float
    """Plate temperature in degC."""
    saturated: int
    """Bit mask of sensors at the end of their range: bits 0..5 for S1..S6, 6 for the pick-up."""


MeasurementFields = tuple[complex, tuple[float, float, float, float, float, float], float, int]
"""The fields of a `Measurement`: compiled steps hand on plain tuples."""


class Contact(NamedTuple):
    """The finger as the tribometer sees it."""

    Fx: float
    """Force in x in N, tared and free of cross-talk."""
    Fy: float
    """Force in y in N, tared and free of cross-talk."""
    Fn: float
    """Normal force in N."""
    mu: float
    """Coefficient of friction Ft/Fn; 0 while the finger does not touch."""
    u_mu: float
    """Standard uncertainty of mu; 0 while the finger does not touch."""
    position: float
    """Centre of pressure along x in m from the middle of the plate; holds its last value."""
    speed: float
    """Filtered rate of change of position in m/s."""
    touching: bool
    """Whether Fn is above the contact force."""


ContactFields = tuple[float, float, float, float, float, float, float, bool]
"""The fields of a `Contact`."""


class Setpoint(NamedTuple):
    """What the user asks of the cascade; which of them count depends on the mode."""

    voltage: float
    """Voltage in V, mode open loop."""
    frequency: float
    """Excitation frequency in Hz: fixed, or where the resonance loop starts from."""
    amplitude: float
    """Vibration amplitude in m peak-to-peak; the nominal amplitude of the law ``nominal``."""
    mu_left: float
    """Coefficient of friction asked for left of the boundary, above 0."""
    mu_right: float
    """Coefficient of friction asked for right of the boundary, above 0."""
    boundary: float
    """Position of the boundary in m."""


TARE_SAMPLES = 64
"""Samples a tare is the mean of: the noise of the zero is an eighth of that of a sample."""
KNOWN_WINDOW_MN: Final = 60
"""Of the nulls of a known plate: 41 mN of drift over 15 K by the gauges' data sheet, and some."""
TICK_US: Final = round(TICK * 1e6)
"""Period of the loop in us."""
SHORT_DEADLINE_MS: Final = 3
"""Deadline of measurements and drives where every cycle is in time: in lockstep, and with the
privileges for real time. One lost cycle passes, a second in a row does not."""
