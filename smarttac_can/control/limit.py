"""What may cut off a drive, as bits."""

from __future__ import annotations

from enum import IntFlag


class Limit(IntFlag):
    """A limit that cut off what was asked for in this tick."""

    VOLTAGE = 1
    AMPLITUDE = 2
    FREQUENCY = 4


# Plain integers: IntFlag arithmetic costs ten times as much.
VOLTAGE, AMPLITUDE, FREQUENCY = (int(limit) for limit in Limit)
