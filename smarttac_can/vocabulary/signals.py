"""The values exchanged between plate and controller, in SI units.

They are small and immutable, and do not depend on the bus: the object dictionary scales them to
integers, the PDOs named at the end carry them, and the nodes keep the tick counts that pair a drive
with its measurement.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

TICK: Final = 1e-3
"""Period Ts of the loop in s: 1 ms."""


class Drive(NamedTuple):
    """Command of the controller to the power stage, in force until the next drive."""

    voltage: float
    """Amplitude of the supply voltage V_q in V, 0 or more (V_d = 0 by choice of the frame)."""
    frequency: float
    """Excitation frequency in Hz."""


class Measurement(NamedTuple):
    """Measurement of the plate in one tick."""

    W: complex
    """Vibration W_d + jW_q in m peak-to-peak, in the frame of the drive voltage."""
    gauges: tuple[float, float, float, float, float, float]
    """Raw strain-gauge forces S1..S6 in N: S1, S2 lateral, S3..S6 normal at the nodes."""
    temperature: float
    """Plate temperature in degC."""
    saturated: int
    """Bit mask of sensors at the end of their range: bits 0..5 for S1..S6, 6 for the pick-up."""


PICKUP_SATURATED: Final = 1 << 6
"""Bit of the pick-up in `Measurement.saturated`."""
MeasurementFields = tuple[complex, tuple[float, float, float, float, float, float], float, int]
"""Fields of a `Measurement`, as compiled steps pass plain tuples."""


class Contact(NamedTuple):
    """State of the finger, as measured by the tribometer."""

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
"""Fields of a `Contact`."""


class Setpoint(NamedTuple):
    """Set-points of the user for the cascade; the mode determines which ones are used."""

    voltage: float
    """Voltage in V, in mode open loop."""
    frequency: float
    """Excitation frequency in Hz: fixed, or the start of the resonance loop."""
    amplitude: float
    """Vibration amplitude in m peak-to-peak; nominal amplitude of the law ``nominal``."""
    mu_left: float
    """Reference of the coefficient of friction left of the boundary, above 0."""
    mu_right: float
    """Reference of the coefficient of friction right of the boundary, above 0."""
    boundary: float
    """Position of the boundary in m."""


TARE_SAMPLES = 64
"""Number of samples averaged by a tare: the zero has an eighth of the noise of a sample."""
KNOWN_WINDOW_MN: Final = 60
"""Window in mN for nulls of a known plate: 41 mN of drift over 15 K by the data sheet, and more."""
UNKNOWN_WINDOW_MN: Final = 1500
"""Window in mN while no null is known: 1.2 N and a drift over 60 K by the data sheet, and more."""
TICK_US: Final = round(TICK * 1e6)
"""Period of the loop in us."""
SHORT_DEADLINE_MS: Final = 3
"""Deadline in ms of measurements and drives if every cycle is in time: in lockstep, or with
real-time privileges. One lost cycle is accepted, a second one in a row is not."""

MEASUREMENT_TPDOS: Final = (1, 2, 3)
"""PDOs in which the plate sends a measurement."""
MEASUREMENT_RPDOS: Final = (5, 6, 7)
"""PDOs in which the stimulator receives it."""
DRIVE_TPDO: Final = 5
"""PDO in which the stimulator sends a drive."""
DRIVE_RPDO: Final = 1
"""PDO in which the plate receives it."""
HARDWARE_RPDO: Final = 2
"""PDO in which the plate receives hardware that supervises its stage; not valid by default."""
PLATE_RPDOS: Final = (DRIVE_RPDO, HARDWARE_RPDO)
"""All RPDOs of the plate."""


def null_window(window: float, nulls: Iterable[float]) -> float:
    """Return the window in mN within which a zero may be off its null.

    Parameters
    ----------
    window
        ``Gauge null.Window`` in mN; 0 for the one that suits the nulls.
    nulls
        ``Gauge null.Null of S1`` to ``S6``, in any unit; all 0 before a calibration.
    """
    return window or (KNOWN_WINDOW_MN if any(nulls) else UNKNOWN_WINDOW_MN)
