"""What can go wrong between master and device, and in the message what to do about it."""

from __future__ import annotations

from typing import Any


class BenchError(Exception):
    """Anything the bench cannot do; the message has what to do about it.

    Attributes
    ----------
    trace
        What was recorded until then, if it ended a run of the bench; None otherwise.
    """

    trace: Any = None


class NodeNotFoundError(BenchError):
    """No device answers at the node-ID."""


class WrongDeviceError(BenchError):
    """A device answers, but it is not the one the EDS describes."""


class RefusedError(BenchError):
    """The device refused to read or write an object; the message has the abort code's text.

    Attributes
    ----------
    code
        Abort code; 0 where LSS refused.
    """

    def __init__(self, text: str, code: int = 0) -> None:
        super().__init__(text)
        self.code = code


class HeartbeatLostError(BenchError):
    """A node that sent heartbeats has fallen silent."""


class BusLostError(BenchError):
    """The bench's own connection to the bus has failed."""
