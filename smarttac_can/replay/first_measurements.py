"""The measurements that came as a node began to listen: a log does not say which it has heard."""

from __future__ import annotations

from collections import deque
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.device.mapping import Direction
from smarttac_can.nodes.loop_frames import DRIVE_TPDO, MEASUREMENT_RPDOS
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    PDO_COB_ID,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.replay.difference import mapped

Stamped = tuple[int, Frame]
"""A frame with a time of the log in us."""

_MOST: Final = 300
"""Frames that are kept: 100 measurements, more than a process that runs ever misses."""
_TICKS: Final = 1 << 8
"""A drive carries as many bits of the tick."""


class FirstMeasurements:
    """Holds measurements back from the start of a node until its first drive tells which it heard.

    The logger may have heard the start before a measurement that the node heard in front of it; and
    a filter of the node's bus may have dropped the first ones.

    Parameters
    ----------
    od
        Object dictionary of the stimulator.

    Attributes
    ----------
    open
        Whether they are held back.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._od = od
        self._held: deque[Stamped] = deque(maxlen=_MOST)
        self.open = False

    def begin(self) -> None:
        """Hold back what comes from now on."""
        self._held.clear()
        self.open = True

    def hold(self, time: int, frame: Frame) -> bool:
        """Take a frame, and tell whether it is held back: a measurement while it is not known."""
        held = self.open and frame.can_id in map(self._measured, MEASUREMENT_RPDOS)
        if held:
            self._held.append((time, frame))
        return held

    @property
    def undecided(self) -> bool:
        """Whether one is held back, so that it is not known what the node heard since."""
        return self.open and bool(self._held)

    def heard(self, drive: Frame) -> list[Stamped]:
        """Return what the node heard of them, from the measurement on that its drive answers.

        Empty, and nothing is decided, if there is none that the drive answers.
        """
        tick = self._tick(TPDO_MAPPING + DRIVE_TPDO - 1, Direction.TRANSMIT, drive)
        first = MEASUREMENT_RPDOS[0]
        mapping = RPDO_MAPPING + first - 1
        held = list(self._held)
        for place, (_, frame) in enumerate(held):
            if frame.can_id == self._measured(first) and tick == self._tick(
                mapping, Direction.RECEIVE, frame
            ):
                self.open = False
                return held[place:]
        return []

    def is_drive(self, frame: Frame) -> bool:
        """Tell whether a frame has the identifier of the drive."""
        return frame.can_id == self._can_id(TPDO_COMMUNICATION + DRIVE_TPDO - 1)

    def _measured(self, rpdo: int) -> int:
        return self._can_id(RPDO_COMMUNICATION + rpdo - 1)

    def _can_id(self, communication: int) -> int:
        return self._od.number(communication, PDO_COB_ID) & CAN_ID_MASK

    def _tick(self, index: int, direction: Direction, frame: Frame) -> int | None:
        """Return the tick that a PDO carries, as far as a drive does; None without one."""
        values = mapped(self._od, index, direction, frame)
        return next((raw % _TICKS for entry, raw in values if entry.name.endswith("Tick")), None)
