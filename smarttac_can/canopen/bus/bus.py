"""The interface of a bus to a node, and the errors of a bus."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Protocol

from smarttac_can.canopen.device.frame import Frame

LogHook = Callable[[int, Frame], None]
"""Function called with a time stamp in us and a frame, for each frame in bus order."""


class BusError(Exception):
    """The bus cannot be opened, or has failed."""


class QueueFullError(BusError):
    """The transmit queue accepts no frames at present; the bus itself may be in order."""


class Bus(Protocol):
    """One party's connection to a CAN bus. Only `wait` waits.

    Each method raises BusError if the bus has failed.
    """

    def send(self, frame: Frame) -> None:
        """Hand a frame over to the bus, without waiting for it to be sent.

        Raises
        ------
        QueueFullError
            If the bus accepts no frame at present.
        """

    def wait(self, timeout: float) -> bool:
        """Wait until a frame of another party may be there, for `timeout` s at most.

        Returns
        -------
        bool
            False if no frame was there until the end of that time.
        """

    def read(self, frames: deque[Frame]) -> bool:
        """Append waiting classical 11-bit frames of other parties, oldest first.

        Returns
        -------
        bool
            Whether more frames may wait: a call reads as many as about a millisecond allows.
        """

    def block(self, can_ids: frozenset[int]) -> None:
        """Drop frames with these identifiers from now on, if the bus can do so at no cost.

        Identifiers of earlier calls pass again. It is a hint: the caller ignores such frames, too.
        """

    def close(self) -> None:
        """Leave the bus and free its sockets and handles; may be called twice."""
