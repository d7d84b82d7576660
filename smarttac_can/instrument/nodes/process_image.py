"""Inputs and outputs of a cycle of the stimulator, in its object dictionary."""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter, mul
from typing import Final, NamedTuple

from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.scaling import QuantisedOnDemand, Quantiser
from smarttac_can.instrument.nodes.loop_frames import received_measurement
from smarttac_can.science.control.cascade import Cascade
from smarttac_can.vocabulary.signals import Drive, Measurement, Setpoint
from smarttac_can.vocabulary.states import STATE_SHIFT, State, Status

SENSORS: Final = (*(f"S{number}" for number in range(1, 7)), "W_d", "W_q", "Temperature")
"""Sensors of the plate, in the order of `Measured.counts`."""


class Measured(NamedTuple):
    """A measurement received from the plate."""

    si: Measurement
    """Measurement in SI units, for the controllers."""
    counts: tuple[int, ...]
    """The same values as integers, in the order of `SENSORS`."""
    tick: int
    """Tick count of 8 bits that the drive has to answer."""
    serial: int
    """Serial number of the plate."""


class MeasurementInput:
    """Convert measurements from the integers of the bus.

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
        """Return a measurement in SI units and as integers.

        Parameters
        ----------
        values
            Integers in the order of the bus; a check sum at the end is ignored.
        """
        counts = self._counts(values)
        s1, s2, s3, s4, s5, s6, W_d, W_q, temperature = map(mul, counts, self._si)
        saturation, tick, serial = self._others(values)
        si = (complex(W_d, W_q), (s1, s2, s3, s4, s5, s6), temperature, saturation)
        return tuple.__new__(Measured, (tuple.__new__(Measurement, si), counts, tick, serial))


class Setpoints:
    """Read the set-points from the object dictionary.

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


class DriveOutput:
    """Write the drive to the object dictionary.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._voltage = od["Drive.Voltage"]
        self._tick = od["Drive.Tick"]
        self._quantiser = Quantiser([self._voltage, od["Drive.Frequency"]])

    def write(self, drive: Drive, tick: int) -> None:
        """Write voltage and frequency, and the tick that they answer."""
        self._quantiser.write(drive)
        self._tick.value = tick

    def switch_off(self) -> None:
        """Write 0 V; the tick stays."""
        self._voltage.value = 0


CHANNELS: Final = ("force x", "force y", "normal force", "COF", "amplitude", "temperature")
"""Names of the channels 1 to 6."""
_NOT_VALID, _POSITIVE_OVERLOAD = 1, 2
_LATERAL_GAUGES, _NORMAL_GAUGES, _PICK_UP = 0b0000011, 0b0111100, 0b1000000
_COF: Final = CHANNELS.index("COF")
_SENSORS: Final = (
    _LATERAL_GAUGES,
    _LATERAL_GAUGES,
    _NORMAL_GAUGES,
    _LATERAL_GAUGES | _NORMAL_GAUGES,
    _PICK_UP,
    0,
)


class AnalogueInput:
    """Process values of the channels, and their status.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        sources = (
            "Contact.Force x",
            "Contact.Force y",
            "Contact.Normal force",
            "Contact.COF",
            "Vibration.Amplitude",
            "Plate temperature",
        )
        # The integers of the sources have the unit and the digits that the channels announce.
        for channel, source in zip(CHANNELS, sources, strict=True):
            od[f"AI input PV.AI input PV {channel}"].compute(od[source].read)
        self._status = [od[f"AI status.AI status {channel}"] for channel in CHANNELS]
        self.reset()

    def reset(self) -> None:
        """Clear the state of the last cycle."""
        self._shown: tuple[bool, int] | None = None

    def update(self, touching: bool, saturation: int) -> None:
        """Set the status of the channels, whether their values are valid.

        Parameters
        ----------
        touching
            Whether a finger touches; without a finger the COF is not valid.
        saturation
            Bits of the saturated sensors, as in `smarttac_can.vocabulary.signals.Measurement`.
        """
        if (touching, saturation) == self._shown:
            return
        self._shown = touching, saturation
        for entry, sensors in zip(self._status, _SENSORS, strict=True):
            entry.value = _NOT_VALID | _POSITIVE_OVERLOAD if saturation & sensors else 0
        if not touching:
            self._status[_COF].value |= _NOT_VALID


_VIBRATION: Final = ("W_d", "W_q", "Amplitude", "Amplitude reference", "Frequency", "Voltage")
_VOLTAGE: Final = _VIBRATION.index("Voltage")
_CONTACT: Final = (
    "Tangential force",
    "Normal force",
    "COF",
    "COF uncertainty",
    "COF reference",
    "Friction error",
    "Position",
    "Speed",
    "Force x",
    "Force y",
)
_TICK_MASK: Final = 0xFFFF


_LOOP_BITS: Final = 0b11111
# Plain integers: IntFlag arithmetic costs ten times as much.
_LIVE, _DRIVING, _TOUCHING, _LIMITED, _SATURATED, _FAULT = (int(bit) for bit in Status)


class ReadBack:
    """The read-only objects that follow the loop.

    The values of the last cycle are kept, and scaled only when an object is read.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._quantities = QuantisedOnDemand(
            [
                *(od[f"Vibration.{name}"] for name in _VIBRATION),
                *(od[f"Contact.{name}"] for name in _CONTACT),
                od["Plate temperature"],
            ]
        )
        self._touching = od["Contact.Touching"]
        self._mode = od["Mode display"]
        self._statusword = od["Statusword"]
        self._tick = od["Contact.Tick"]
        self._cycles = od["Cycle.Cycles"]
        self._analogue_input = AnalogueInput(od)
        self.reset()

    def reset(self) -> None:
        """Reset to the start of a run: no measurement, and the next tick is 0."""
        self._quantities.reset()
        self._touching.value = self._mode.value = 0
        self._analogue_input.reset()
        self._statusword.value &= ~_LOOP_BITS
        self._cycles.value = 0
        self._tick.value = _TICK_MASK

    def show_state(self, state: State) -> None:
        """Set the state bits of the statusword."""
        status = self._statusword.value & _LOOP_BITS | state << STATE_SHIFT
        if state is State.FAULT:
            status |= _FAULT
        self._statusword.value = status

    def show_off(self) -> None:
        """Show mode OFF and 0 V immediately, before the next cycle."""
        self._mode.value = 0
        row = self._quantities.row
        self._quantities.row = (*row[:_VOLTAGE], 0.0, *row[_VOLTAGE + 1 :])
        self._statusword.value &= ~_DRIVING

    def mark_stale(self) -> None:
        """Clear the live bit of the statusword; the next cycle sets it again."""
        self._statusword.value &= ~_LIVE

    def publish(self, measured: Measured, cascade: Cascade) -> None:
        """Publish the measurement of a cycle, and the controllers after it."""
        W, _, temperature, saturation = measured.si
        Fx, Fy, Fn, mu, u_mu, position, speed, touching = cascade.contact
        voltage, frequency = cascade.drive
        self._quantities.row = (
            W.real,
            W.imag,
            cascade.amplitude,
            cascade.W_ref,
            frequency,
            voltage,
            (Fx * Fx + Fy * Fy) ** 0.5,
            Fn,
            mu,
            u_mu,
            cascade.mu_ref,
            cascade.E * 0.01,  # % to 1
            position,
            speed,
            Fx,
            Fy,
            temperature,
        )
        self._touching.value = int(touching)
        self._mode.value = int(cascade.mode)
        self._tick.value = self._tick.value + (measured.tick - self._tick.value & 0xFF) & _TICK_MASK
        self._cycles.count()
        status = self._statusword.value & ~_LOOP_BITS | _LIVE
        if voltage > 0.0:
            status |= _DRIVING
        if touching:
            status |= _TOUCHING
        if cascade.limited:
            status |= _LIMITED
        if saturation:
            status |= _SATURATED
        self._statusword.value = status
        self._analogue_input.update(touching, saturation)
