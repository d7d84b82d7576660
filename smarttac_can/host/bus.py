"""What a node needs of a bus, and the errors a bus raises."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Protocol

from smarttac_can.device.frame import Frame

LogHook = Callable[[int, Frame], None]
"""Called with a time stamp in us and the frame, for every frame on the bus, in bus order."""


class BusError(Exception):
    """The bus cannot be opened, or carries no more frames."""


class QueueFullError(BusError):
    """The transmit queue takes no more frames for now; the bus itself may be well."""


class Bus(Protocol):
    """One party's connection to a CAN bus. Only `wait` waits.

    Each method raises BusError if the bus has failed.
    """

    def send(self, frame: Frame) -> None:
        """Hand a frame over to the bus, without waiting for it to be sent.

        Raises
        ------
        QueueFullError
            If the bus takes none for now.
        """

    def wait(self, timeout: float) -> None:
        """Wait until a frame of another party may be there, for so many s at most."""

    def read(self, frames: deque[Frame]) -> bool:
        """Append classical 11-bit frames of other parties that wait, oldest first.

        Returns
        -------
        bool
            Whether more may wait: a call takes some frames at most, as many as come within about a
            millisecond.
        """

    def block(self, can_ids: frozenset[int]) -> None:
        """Drop frames with these identifiers from now on, if the bus can do it for nothing.

        Others than these are let in again. A hint: the caller passes over what comes all the same.
        """

    def close(self) -> None:
        """Leave the bus and free its sockets and handles; may be called twice."""
