"""What a sans-IO CANopen node looks like to whoever runs it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final, Protocol

from smarttac_can.device.frame import Frame
from smarttac_can.device.port import Clock, Identifiers

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
        """Switch the power on; the boot-up message is among the frames."""

    def receive(self, frame: Frame) -> list[Frame]:
        """Take one frame from the bus; return what the node answers, in order."""

    def advance(self, microseconds: int) -> list[Frame]:
        """Let so many us pass for the node; return the frames that fell due, in order."""

    def segments(self, most: int) -> list[Frame]:
        """Return the next frames, at most so many, of transfers limited by the bus alone."""

    def shutdown(self) -> list[Frame]:
        """Leave the plate at 0 V; return the frames that tell the others."""


class HostedNode(Node, Protocol):
    """A node that runs on a bus which may be slow, by a clock that may be late."""

    @property
    def clock(self) -> Clock:
        """Device time: moved by `advance`, or by who runs the node in real time."""

    @property
    def ids(self) -> Identifiers:
        """CAN-IDs of SYNC, of what the node hears and of its urgent frames.

        A new object if they change.
        """

    def overtaken(self, frame: Frame) -> list[Frame]:
        """Take a frame that is overtaken, as `is_overtaken` says; return the answers."""

    def overdue(self) -> list[Frame]:
        """Act on deadlines that have passed, before the frames that wait are heard.

        The host calls it before timers and frames, late or not.
        """

    def transmit_failed(self) -> list[Frame]:
        """Record that an urgent frame could not be handed over in its cycle."""


class Connected(Protocol):
    """Somebody whose connection to the bus may fail, and come back."""

    def bus_off(self) -> list[Frame]:
        """Record that there is no bus; what is returned reaches nobody."""

    def bus_recovered(self) -> list[Frame]:
        """Record that the bus is there again; return what the node sends for it."""


class ConnectedNode(Node, Connected, Protocol):
    """A node whose connection to the bus may fail, and come back."""


def without_queue(node: Node) -> Callable[[Frame], list[Frame]]:
    """Make a `Node.receive` that answers with the segments as well, for a bus that takes all."""
    receive, segments = node.receive, node.segments

    def receive_all(frame: Frame) -> list[Frame]:
        frames = receive(frame)
        while more := segments(_AT_ONCE):
            frames = frames + more
        return frames

    return receive_all
