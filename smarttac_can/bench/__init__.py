"""The bench: a stimulator as a person handles it, recordings, the paper's experiments."""

from smarttac_can.bench.errors import (
    BenchError,
    HeartbeatLostError,
    NodeNotFoundError,
    NotRunningError,
    RefusedError,
    WrongDeviceError,
)
from smarttac_can.bench.reading import Reading
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.traces import Trace
from smarttac_can.control.cascade import Mode
from smarttac_can.control.friction import Law

__all__ = [
    "BenchError",
    "HeartbeatLostError",
    "Law",
    "Mode",
    "NodeNotFoundError",
    "NotRunningError",
    "Reading",
    "RefusedError",
    "Stimulator",
    "Trace",
    "WrongDeviceError",
]
