"""Errors between master and device; their messages say what to do."""

from __future__ import annotations

from typing import Any


class BenchError(Exception):
    """An operation that the bench cannot do; the message says what to do.

    Attributes
    ----------
    trace
        Trace of the run of the bench that the error ended, or None.
    """

    trace: Any = None


class NodeNotFoundError(BenchError):
    """No device answers at the node-ID."""


class WrongDeviceError(BenchError):
    """A device answers, but it is not the one described by the EDS."""


class RefusedError(BenchError):
    """The device refused to read or write an object; the message has the text of the abort code.

    Attributes
    ----------
    code
        Abort code; 0 if LSS refused.
    """

    def __init__(self, text: str, code: int = 0) -> None:
        super().__init__(text)
        self.code = code


class HeartbeatLostError(BenchError):
    """The heartbeat of a node was received before, and is lost."""


class BusLostError(BenchError):
    """The connection of the bench itself to the bus has failed."""
