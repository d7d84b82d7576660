"""What a cycle of the loop begins with: a measurement and set-points, by name and in SI units."""

from __future__ import annotations

from operator import mul
from typing import Final, NamedTuple

from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.signals import Measurement, Setpoint

SENSORS: Final = (*(f"S{number}" for number in range(1, 7)), "W_d", "W_q", "Temperature")
"""Sensors of the plate, in the order of `Measured.counts`."""


class Measured(NamedTuple):
    """A measurement as it has come from the plate."""

    si: Measurement
    """For the controllers."""
    counts: tuple[int, ...]
    """The same as integers, in the order of `SENSORS`."""
    tick: int
    """Tick count of 8 bits that the drive has to answer."""
    serial: int
    """Serial number of the plate."""


class MeasurementInput:
    """The measurement that stands in the object dictionary.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._sensors = [od[f"Plate input.{name}"] for name in SENSORS]
        self._si = [entry.si for entry in self._sensors]
        self._saturation = od["Plate input.Saturation"]
        self._tick = od["Plate input.Tick"]
        self._serial = od["Plate input.Plate serial number"]

    def read(self) -> Measured:
        """Return the measurement in SI units, and as integers."""
        counts = tuple([entry.value for entry in self._sensors])
        s1, s2, s3, s4, s5, s6, W_d, W_q, temperature = map(mul, counts, self._si)
        gauges = (s1, s2, s3, s4, s5, s6)
        si = (complex(W_d, W_q), gauges, temperature, self._saturation.value)
        measurement = tuple.__new__(Measurement, si)
        return tuple.__new__(Measured, (measurement, counts, self._tick.value, self._serial.value))


class Setpoints:
    """The set-points that stand in the object dictionary.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._entries = [
            od[f"Setpoint.{name}"]
            for name in ("Voltage", "Frequency", "Amplitude", "COF left", "COF right", "Boundary")
        ]
        self._counts: list[int] = []

    def read(self) -> Setpoint:
        """Return the set-points in SI units."""
        counts = [entry.value for entry in self._entries]
        if counts != self._counts:
            self._counts = counts
            self._setpoint = Setpoint(*[entry.si_value for entry in self._entries])
        return self._setpoint
