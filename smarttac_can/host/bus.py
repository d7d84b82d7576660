"""What a node needs of a bus, and the errors a bus raises."""

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
    """One party's connection to a CAN bus; only `receive` waits, and no longer than it may."""

    def send(self, frame: Frame) -> None:
        """Hand a frame over to the bus, without waiting for it to be sent.

        Raises
        ------
        QueueFullError
            If the bus takes none for now.
        BusError
            If it takes none at all.
        """

    def receive(
        self, timeout: float, patience: float = 0.0, *, every: bool = False
    ) -> Frame | None:
        """Return the next frame of another party that is listened to.

        Parameters
        ----------
        timeout
            Longest wait for a frame in s; 0 takes what is there.
        patience
            How long, in s, it may take to pass over frames that are there and not listened to.
        every
            Whether a frame that is not listened to is returned, too.

        Returns
        -------
        Frame or None
            None if no such frame came in time.

        Raises
        ------
        BusError
            If the bus has failed.
        """

    def listen_to(self, can_ids: frozenset[int]) -> None:
        """Pass over frames with other identifiers from now on; at first none are.

        Frames that wait already, and those that were passed to nobody yet, are judged by the new
        identifiers, so that a frame may follow the one that makes it wanted at once. In a flood a
        bus may drop frames before that, by the identifiers of that time.
        """

    def close(self) -> None:
        """Leave the bus and free its sockets and handles; may be called twice.

        Raises
        ------
        BusError
            If the driver fails at it.
        """
