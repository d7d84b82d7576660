"""What a sans-IO CANopen node looks like to whoever runs it."""

from __future__ import annotations

from typing import Protocol

from smarttac_can.device.frame import Frame


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

    def shutdown(self) -> list[Frame]:
        """Leave the plate at 0 V; return the frames that tell the others."""
        ...
