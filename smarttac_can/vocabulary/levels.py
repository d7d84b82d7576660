"""Levels: how near each watchdog that measures or counts is to a fault, 1.0."""

from __future__ import annotations

from math import inf
from typing import Final

from smarttac_can.vocabulary.watchdogs import Watchdog

COUNTED: Final = (
    Watchdog.HEARTBEAT,
    Watchdog.MEASUREMENT,
    Watchdog.SETPOINT,
    Watchdog.SYNC_LOST,
    Watchdog.SYNC_IRREGULAR,
    Watchdog.VOLTAGE,
    Watchdog.AMPLITUDE,
    Watchdog.TEMPERATURE,
    Watchdog.NORMAL_FORCE,
    Watchdog.LATERAL_FORCE,
    Watchdog.SATURATED,
    Watchdog.STUCK,
    Watchdog.GAUGES,
    Watchdog.PICKUP,
    Watchdog.RESONANCE,
    Watchdog.DOUBLE,
    Watchdog.UNSEEN,
    Watchdog.MISSED_TIME,
)
"""Those that measure or count, so that it can be told how near a fault is; others are events."""
PLATE_COUNTED: Final = ("deadline", "wrong checks", "temperature", "voltage")
"""What the plate watches itself, where the same holds."""


def level(value: float, limit: float) -> float:
    """Return how near a value is to its limit, 1.0; any value above 0 is beyond a limit of 0."""
    if limit:
        return value / limit
    return inf if value > 0 else 0.0
