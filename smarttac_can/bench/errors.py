"""What can go wrong at the bench, each with what to do about it in its message."""

from __future__ import annotations

from smarttac_can.bench.traces import Trace


class BenchError(Exception):
    """Anything the bench cannot do; the message says what to do about it."""


class NodeNotFoundError(BenchError):
    """No device answers at the node-ID."""


class WrongDeviceError(BenchError):
    """A device answers, but it is not the one the EDS describes."""


class RefusedError(BenchError):
    """The device refused to read or write an object; the message has the abort code's text."""


class HeartbeatLostError(BenchError):
    """A node that sent heartbeats has fallen silent."""


class NotRunningError(BenchError):
    """The control loop gives no cycles to record."""


class NotReadyError(BenchError):
    """The stimulator lacks something it needs before it may be armed."""


class FaultError(BenchError):
    """A watchdog has tripped, and the fault is latched.

    Attributes
    ----------
    trace
        What was recorded if it ended a run; None otherwise.
    """

    def __init__(self, text: str, trace: Trace | None = None) -> None:
        super().__init__(text)
        self.trace = trace


class BusLostError(BenchError):
    """The bench's own connection to the bus has failed."""
