"""Emergency error codes of the nodes, and the faults that the simulated plate can have."""

from __future__ import annotations

from enum import IntEnum
from typing import Final


class FaultCode(IntEnum):
    """Emergency error codes of the watchdogs, by the classes of CiA 301, table 26."""

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
"""Sensor numbers. 1..6 are the gauges S1..S6; PICKUP is the pick-up with both axes."""


class FaultKind(IntEnum):
    """Kinds of faults. The unit of a value is that of its sensor: mN, nm or 0.01 K."""

    NONE = 0
    """No fault."""
    STUCK = 1
    """The sensor repeats its last reading."""
    SATURATED = 2
    """The sensor is at the end of its range, at the negative one for a value below 0."""
    OFFSET = 3
    """The value is added to the reading of the sensor."""
    GAIN = 4
    """The gain of the sensor is the value in 0.1 %, for the pick-up before its converter."""
    DEAD = 5
    """The sensor reads 0."""
    NOISE = 6
    """White noise with the value as its standard deviation is added to the noise of the sensor."""
    SPIKE = 7
    """The value is added to the reading of the sensor for one tick."""
    RESONANCE_SHIFT = 8
    """The resonance is shifted up by the value in Hz, as by a crack or a loose mount."""
    QUALITY = 9
    """The quality factor is reduced to the value in 0.1 %."""
    TEMPERATURE = 10
    """The temperature of plate and environment is the value in 0.01 degC."""
    SLAM = 11
    """The normal force of the finger increases by the value in mN."""
    STAGE_STUCK = 12
    """The power stage keeps the value in 10 mV, whatever voltage above 0 V is commanded."""


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
"""Ranges of values of the kinds that do not accept all values up to `_MOST`."""
_MOST: Final = 1_000_000


def last_sensor(kind: FaultKind) -> int:
    """Return the highest number of a sensor that a kind takes; only a gain is for both axes."""
    return PICKUP if kind in (FaultKind.GAIN, FaultKind.NONE) else THERMOMETER


def value_range(kind: FaultKind) -> tuple[int, int]:
    """Return the lowest and the highest valid value of a kind."""
    return _RANGES.get(kind, (-_MOST, _MOST))
