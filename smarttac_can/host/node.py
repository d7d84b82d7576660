"""What a sans-IO CANopen node looks like to whoever runs it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

from smarttac_can.device.frame import Frame

_AT_ONCE: Final = 127


class Node(Protocol):
    """A CANopen node without clock, bus or thread: frames and time in, frames out."""

    def start(self) -> list[Frame]:
        """Switch the power on; the boot-up message is among the frames."""
        ...

    def receive(self, frame: Frame) -> list[Frame]:
        """Take one frame from the bus; return what the node answers, in order."""
        ...

    def advance(self, microseconds: int) -> list[Frame]:
        """Move the node's timers on; return what fell due, in order."""
        ...

    def segments(self, most: int) -> list[Frame]:
        """Return the next frames, at most so many, of what goes on as fast as the bus takes it."""
        ...

    def shutdown(self) -> list[Frame]:
        """Leave the plate at 0 V; return the frames that tell the others."""
        ...


def without_queue(node: Node) -> Callable[[Frame], list[Frame]]:
    """Make a `Node.receive` that has the segments among its answers: for a bus that takes all."""
    receive, segments = node.receive, node.segments

    def receive_all(frame: Frame) -> list[Frame]:
        frames = receive(frame)
        while more := segments(_AT_ONCE):
            frames = frames + more
        return frames

    return receive_all
