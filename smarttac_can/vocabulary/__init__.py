"""Definitions shared by both ends of the bus: modes, states, words, watchdogs, faults, signals."""

from smarttac_can.vocabulary.faults import FaultCode, FaultKind
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.plate import Plate
from smarttac_can.vocabulary.signals import Contact, Drive, Measurement, Setpoint
from smarttac_can.vocabulary.states import (
    Control,
    IdentificationState,
    Law,
    Mode,
    State,
    Status,
    VibrationLaw,
)
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

__all__ = [
    "WATCHDOGS",
    "Contact",
    "Control",
    "Drive",
    "FaultCode",
    "FaultKind",
    "IdentificationState",
    "Law",
    "Measurement",
    "Mode",
    "Plate",
    "PlateModel",
    "Setpoint",
    "State",
    "Status",
    "VibrationLaw",
    "Watchdog",
]
