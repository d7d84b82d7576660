"""Emergency error codes of the nodes, and the faults that the simulated plate can have."""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class FaultCode(IntEnum):
    """What the watchdogs report, by the classes of CiA 301, table 26."""

    VOLTAGE = 0x3310
    STAGE = 0x3311
    TEMPERATURE = 0x4210
    SENSOR_SATURATED = 0x5210
    SENSOR_STUCK = 0x5211
    GAUGES_IMPLAUSIBLE = 0x5212
    PICKUP_IMPLAUSIBLE = 0x5213
    CONTROLLER = 0x6100
    MISSED_TIME = 0x6180
    CALIBRATION = 0x6320
    TRANSMIT_QUEUE = 0x8111
    HEARTBEAT_LOST = 0x8131
    BUS_OFF = 0x8141
    DOUBLE = 0x8150
    NMT_LEFT = 0x8180
    SYNC_LOST = 0x8241
    SYNC_IRREGULAR = 0x8242
    SYNC_COUNTER = 0x8243
    MEASUREMENT_LOST = 0x8251
    SETPOINT_LOST = 0x8252
    DRIVE_LOST = 0x8253
    NOT_ENABLED = 0x9010
    AMPLITUDE = 0xFF10
    RESONANCE = 0xFF11
    UNSEEN = 0xFF12
    NORMAL_FORCE = 0xFF20
    LATERAL_FORCE = 0xFF21


GAUGES: Final = 6
PICKUP_D, PICKUP_Q, THERMOMETER, PICKUP = 7, 8, 9, 10
"""Sensor numbers; 1..6 are the gauges S1..S6, the last is the pick-up with both axes."""


class FaultKind(IntEnum):
    """What breaks. The unit of a value is that of its sensor: mN, nm or 0.01 K."""

    NONE = 0
    """All is well."""
    STUCK = 1
    """The sensor repeats its last reading."""
    SATURATED = 2
    """The sensor is at the end of its range, the negative one for a value below 0."""
    OFFSET = 3
    """The sensor reads more by the value."""
    GAIN = 4
    """The sensor reads its value in 0.1 %; the pick-up loses or gains it before its converter."""
    DEAD = 5
    """The sensor reads 0."""
    NOISE = 6
    """The sensor has white noise whose standard deviation is the value on top of its own."""
    SPIKE = 7
    """The sensor reads more by the value, for one tick."""
    RESONANCE_SHIFT = 8
    """The resonance is higher by the value in Hz, as of a crack or a loose mount."""
    QUALITY = 9
    """The quality factor is the value in 0.1 % of what it was."""
    TEMPERATURE = 10
    """The plate and its surroundings have the value in 0.01 degC."""
    SLAM = 11
    """The finger presses harder by the value in mN."""
    STAGE_STUCK = 12
    """The power stage keeps the value in 10 mV whatever is asked for, above 0 V."""


SENSOR_KINDS: Final = range(FaultKind.STUCK, FaultKind.SPIKE + 1)
_RANGES: Final = {
    FaultKind.GAIN: (-10_000, 10_000),
    FaultKind.NOISE: (0, 1_000_000),
    FaultKind.RESONANCE_SHIFT: (-20_000, 20_000),
    FaultKind.QUALITY: (20, 1000),
    FaultKind.TEMPERATURE: (-4000, 20_000),
    FaultKind.SLAM: (0, 100_000),
    FaultKind.STAGE_STUCK: (0, 100_000),
}
"""Values of the kinds that do not take any value up to `_MOST`."""
_MOST: Final = 1_000_000


def value_range(kind: FaultKind) -> tuple[int, int]:
    """Return the lowest and the highest value that make sense for a kind."""
    return _RANGES.get(kind, (-_MOST, _MOST))
