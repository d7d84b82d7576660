"""The frames of the loop: their PDOs, and what they carry in the order of the EDS mappings."""

from __future__ import annotations

from typing import Final

from smarttac_can.device.mapping import Direction, compile_mapping
from smarttac_can.nodes.frame_check import CheckedFrames
from smarttac_can.od.cia import RPDO_MAPPING, TPDO_MAPPING
from smarttac_can.od.dictionary import ObjectDictionary

MEASUREMENT_TPDOS: Final = (1, 2, 3)
"""PDOs in which the plate sends a measurement."""
MEASUREMENT_RPDOS: Final = (5, 6, 7)
"""PDOs in which the stimulator receives it."""
DRIVE_TPDO: Final = 5
"""PDO in which the stimulator sends a drive."""
DRIVE_RPDO: Final = 1
"""PDO in which the plate receives it."""
HARDWARE_RPDO: Final = 2
"""PDO in which the plate hears hardware that watches its power stage; not valid by default."""
PLATE_RPDOS: Final = (DRIVE_RPDO, HARDWARE_RPDO)
"""All that the plate has."""

LATCHED: Final = 0x80
"""Added to the node-ID of a drive's sender while it is in FAULT."""


def sent_measurement(plate: ObjectDictionary) -> CheckedFrames:
    """Return what the plate puts into a measurement."""
    return _mapped(plate, TPDO_MAPPING, MEASUREMENT_TPDOS, Direction.TRANSMIT)


def received_measurement(stimulator: ObjectDictionary) -> CheckedFrames:
    """Return where the stimulator finds a measurement."""
    return _mapped(stimulator, RPDO_MAPPING, MEASUREMENT_RPDOS, Direction.RECEIVE)


def sent_drive(stimulator: ObjectDictionary) -> CheckedFrames:
    """Return what the stimulator puts into a drive."""
    return _mapped(stimulator, TPDO_MAPPING, (DRIVE_TPDO,), Direction.TRANSMIT)


def received_drive(plate: ObjectDictionary) -> CheckedFrames:
    """Return where the plate finds a drive."""
    return _mapped(plate, RPDO_MAPPING, (DRIVE_RPDO,), Direction.RECEIVE)


def _mapped(
    od: ObjectDictionary, mapping: int, numbers: tuple[int, ...], direction: Direction
) -> CheckedFrames:
    return CheckedFrames(
        [
            entry
            for number in numbers
            for entry in compile_mapping(od, mapping + number - 1, direction).entries
        ]
    )
