"""What a watch over the frames of the loop works with."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from smarttac_can.device.timer import Clock
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.watchdogs import Watchdog


class Watching(NamedTuple):
    """The node around a watch."""

    od: ObjectDictionary
    """Object dictionary of ``stimulator.eds``."""
    clock: Clock
    """Device time."""
    deadline_ms: Callable[[], int]
    """Returns how long the loop may be without a measurement, and so without SYNC."""
    trip: Callable[[Watchdog], None]
    """Called with a watchdog whose fault comes."""
    settle: Callable[[Watchdog], None]
    """Called with one whose fault goes."""
