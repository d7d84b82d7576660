"""Emergency error codes of stimulator and plate."""

from __future__ import annotations

from enum import IntEnum


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
