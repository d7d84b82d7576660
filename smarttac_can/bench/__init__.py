"""The bench: a stimulator as a person handles it, recordings, the paper's experiments."""

from smarttac_can.bench.errors import FaultError, NotReadyError, NotRunningError
from smarttac_can.bench.reading import Reading
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.traces import Trace
from smarttac_can.master.errors import (
    BenchError,
    BusLostError,
    HeartbeatLostError,
    NodeNotFoundError,
    RefusedError,
    WrongDeviceError,
)
from smarttac_can.vocabulary.modes import Law, Mode
from smarttac_can.vocabulary.states import State

__all__ = [
    "BenchError",
    "BusLostError",
    "FaultError",
    "HeartbeatLostError",
    "Law",
    "Mode",
    "NodeNotFoundError",
    "NotReadyError",
    "NotRunningError",
    "Reading",
    "RefusedError",
    "State",
    "Stimulator",
    "Trace",
    "WrongDeviceError",
]
