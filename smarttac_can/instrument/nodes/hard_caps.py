"""Hard caps of voltage, amplitude and temperature: no EDS, master or controller can exceed them."""

from __future__ import annotations

from decimal import Decimal
from math import inf
from typing import Final, NamedTuple

from smarttac_can.canopen.od.data_types import SIGNED, UNSIGNED
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.units import EXACT, Quantity
from smarttac_can.vocabulary.states import LAWS, Mode

VOLTAGE_MAX: Final = 200.0
"""Cap of the power stage voltage in V. An assumption, as the paper gives no absolute voltage. The
default limit of 150 V makes 7.5 um at resonance, more than twice what the pick-up can follow; the
rest is reserve for a plate with a lower gain."""
AMPLITUDE_MAX: Final = 3e-6
"""Cap of the amplitude set-point in m, peak-to-peak. It leaves the overshoot of the loop within the
range of the pick-up. The paper goes to 2 um."""
AMPLITUDE_TRIP_MAX: Final = 3.27e-6
"""Cap of the trip limit of the amplitude in m, peak-to-peak. The pick-up ends at 3.2767 um."""
AMPLITUDE_BY_DRIVE_MAX: Final = 6e-6
"""Cap of the trip limit of the amplitude that follows from the drive, in m, peak-to-peak. Under the
paper's references the five simulated subjects need up to 4.65 um."""
TEMPERATURE_MAX: Final = 80.0
"""Cap of the plate temperature in degC. By their data sheet the gauges, FSS1500, may be used to
85 degC. It protects the plate; a fingertip tolerates less."""

_VOLTAGE: Final = Quantity(Decimal("10"), "mV")
_AMPLITUDE: Final = Quantity(Decimal("1"), "nm")
_PICKUP: Final = Quantity(Decimal("0.1"), "nm")
_GAIN: Final = Quantity(Decimal("1"), "pm")
_TEMPERATURE: Final = Quantity(Decimal("0.01"), "degC")


class Cap(NamedTuple):
    """Object that has to exist, with its unit and its range from 0 to a cap."""

    name: str
    unit: Quantity
    most: float = inf
    """Cap in SI units; inf for a value that is only compared with a limit, or defines one."""


STIMULATOR_CAPS: Final = (
    Cap("Setpoint.Voltage", _VOLTAGE, VOLTAGE_MAX),
    Cap("Setpoint.Amplitude", _AMPLITUDE, AMPLITUDE_MAX),
    Cap("Limit.Voltage", _VOLTAGE, VOLTAGE_MAX),
    Cap("Limit.Amplitude", _AMPLITUDE, AMPLITUDE_MAX),
    Cap("Limit.Amplitude trip", _AMPLITUDE, AMPLITUDE_TRIP_MAX),
    Cap("Limit.Amplitude by drive", _AMPLITUDE, AMPLITUDE_BY_DRIVE_MAX),
    Cap("Limit.Temperature", _TEMPERATURE, TEMPERATURE_MAX),
    Cap("Drive.Voltage", _VOLTAGE, VOLTAGE_MAX),
    Cap("Vibration.Voltage", _VOLTAGE, VOLTAGE_MAX),
    Cap("Plate input.W_d", _PICKUP),
    Cap("Plate input.W_q", _PICKUP),
    Cap("Plate input.Temperature", _TEMPERATURE),
    Cap("Model.Gain per volt", _GAIN),
    Cap("Model.Data sheet gain per volt", _GAIN),
)
"""Caps of ``stimulator.eds``."""
PLATE_CAPS: Final = (
    Cap("Drive.Voltage", _VOLTAGE, VOLTAGE_MAX),
    Cap("Stage.Voltage", _VOLTAGE, VOLTAGE_MAX),
    Cap("Stage read-back", _VOLTAGE),
    Cap("Limit.Voltage", _VOLTAGE, VOLTAGE_MAX),
    Cap("Limit.Temperature", _TEMPERATURE, TEMPERATURE_MAX),
    Cap("Vibration.W_d", _PICKUP),
    Cap("Vibration.W_q", _PICKUP),
    Cap("Vibration.Temperature", _TEMPERATURE),
)
"""Caps of ``plate.eds``."""


def require_caps(od: ObjectDictionary, caps: tuple[Cap, ...]) -> None:
    """Check that an object dictionary keeps the device within its caps.

    Raises
    ------
    ValueError
        An object is missing, is no integer or has another unit, or its limits or its default are
        outside 0..cap or depend on the node-ID. One line names the object, the value and the cap.
    """
    for cap in caps:
        try:
            entry = od[cap.name]
        except KeyError as error:
            raise ValueError(error.args[0]) from error
        _require_unit(entry, cap.unit)
        if cap.most < inf:
            _require_range(entry, cap)


def require_choices(od: ObjectDictionary) -> None:
    """Raise ValueError if an object accepts a mode or a law that does not exist."""
    for name, choices in (("Mode", Mode), *LAWS.items()):
        most = max(choices)
        if od[name].high > most:
            raise ValueError(f"{name} has the HighLimit {od[name].high}, above {most:d}")


def _require_unit(entry: Entry, unit: Quantity) -> None:
    if entry.data_type not in SIGNED and entry.data_type not in UNSIGNED:
        raise ValueError(f"{entry.name} is {entry.data_type.name}, not an integer")
    if entry.unit != unit:
        raise ValueError(f"{entry.name} has the unit [{entry.unit}], not [{unit}]")


def _require_range(entry: Entry, cap: Cap) -> None:
    if entry.per_node:
        raise ValueError(f"{entry.name} is capped, so it cannot depend on the node-ID")
    most = round(cap.most / entry.si)
    for what, raw in (
        ("LowLimit", entry.low),
        ("HighLimit", entry.high),
        ("DefaultValue", entry.default),
    ):
        if not 0 <= raw <= most:
            shown, highest = (EXACT.multiply(n, cap.unit.number) for n in (int(raw), most))
            raise ValueError(
                f"{entry.name} has the {what} {shown:f} {cap.unit.symbol}"
                f", outside the hard cap 0..{highest:f} {cap.unit.symbol}"
            )
