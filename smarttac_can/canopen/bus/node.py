"""The interface of a sans-IO CANopen node to its host."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final, Protocol

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.port import Clock, Identifiers

_AT_ONCE: Final = 127


def is_overtaken(frame: Frame, newer: Iterable[Frame]) -> bool:
    """Return whether a newer frame has the same identifier, RTR bit and length."""
    can_id, data, rtr = frame
    size = len(data)
    for other in newer:
        if other.can_id == can_id and other.rtr == rtr and len(other.data) == size:
            return True
    return False


class Node(Protocol):
    """A CANopen node without clock, bus or thread: frames and time in, frames out."""

    def start(self) -> list[Frame]:
        """Switch the power on; the returned frames contain the boot-up message."""

    def receive(self, frame: Frame) -> list[Frame]:
        """Receive a frame from the bus; return the answers of the node, in order."""

    def advance(self, microseconds: int) -> list[Frame]:
        """Advance the time of the node; return the frames of due timers, in order."""

    def segments(self, most: int) -> list[Frame]:
        """Return the next frames, at most `most`, of transfers that are limited only by the bus."""

    def shutdown(self) -> list[Frame]:
        """Leave the plate at 0 V; return the frames that report it."""


class Connected(Protocol):
    """A party whose connection to the bus may fail and recover."""

    def bus_off(self) -> list[Frame]:
        """Record that the bus is lost; the returned frames are not sent."""

    def bus_recovered(self) -> list[Frame]:
        """Record that the bus is back; return the frames that the node sends for it."""


class HostedNode(Node, Connected, Protocol):
    """A node for a bus that may be slow or fail, and a clock that may be late."""

    @property
    def clock(self) -> Clock:
        """Device time: moved by `advance`, or in real time by the host."""

    @property
    def ids(self) -> Identifiers:
        """CAN-IDs of SYNC, of received frames and of urgent frames of the node.

        A new object if they change.
        """

    def overtaken(self, frame: Frame) -> list[Frame]:
        """Receive a frame that is superseded, as `is_overtaken` tells; return the answers."""

    def overdue(self) -> list[Frame]:
        """Act on elapsed deadlines before waiting frames are received.

        The host calls it before timers and frames, even when it is on time.
        """

    def transmit_failed(self) -> list[Frame]:
        """Record that an urgent frame could not be handed over in its cycle."""


def without_queue(node: Node) -> Callable[[Frame], list[Frame]]:
    """Return a `Node.receive` that also returns all segments, for a bus of unlimited speed."""
    receive, segments = node.receive, node.segments

    def receive_all(frame: Frame) -> list[Frame]:
        frames = receive(frame)
        while more := segments(_AT_ONCE):
            frames = frames + more
        return frames

    return receive_all
