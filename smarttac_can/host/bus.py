"""What a node needs of a bus, and the one error a bus raises."""

from __future__ import annotations

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
    """One party's connection to a CAN bus."""

    def send(self, frame: Frame) -> None:
        """Put a frame on the bus; raises BusError if it takes none."""
        ...

    def receive(self, timeout: float) -> Frame | None:
        """Return the next frame of another party, or None if none came within timeout s."""
        ...

    def close(self) -> None:
        """Leave the bus and free its sockets and handles; may be called twice.

        Raises BusError if the driver fails at it.
        """
        ...
