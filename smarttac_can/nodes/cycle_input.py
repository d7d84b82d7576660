"""What a cycle of the loop begins with: a measurement and set-points, by name and in SI units."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter, mul
from typing import Final, NamedTuple

from smarttac_can.nodes.loop_frames import received_measurement
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
    """Takes measurements as they cross a bus.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        entries = received_measurement(od).entries
        sensors = [od[f"Plate input.{name}"] for name in SENSORS]
        self._counts = itemgetter(*map(entries.index, sensors))
        self._si = [entry.si for entry in sensors]
        others = [
            od[f"Plate input.{name}"] for name in ("Saturation", "Tick", "Plate serial number")
        ]
        self._others = itemgetter(*map(entries.index, others))

    def measured(self, values: Sequence[int]) -> Measured:
        """Return a measurement in SI units, and as integers.

        Parameters
        ----------
        values
            In the order of the bus; a check at the end is ignored.
        """
        counts = self._counts(values)
        s1, s2, s3, s4, s5, s6, W_d, W_q, temperature = map(mul, counts, self._si)
        saturation, tick, serial = self._others(values)
        si = (complex(W_d, W_q), (s1, s2, s3, s4, s5, s6), temperature, saturation)
        return tuple.__new__(Measured, (tuple.__new__(Measurement, si), counts, tick, serial))


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
