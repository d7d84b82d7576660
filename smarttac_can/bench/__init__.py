"""The bench for lab scripts: a stimulator, its finger, and recordings.

Threads may share a bench. A call of several steps, such as a pair of COF, a mode or a change of the
finger, waits for its turn, and no other call comes between its steps. In a simulation and in
lockstep a call is executed between two cycles. Only one thread at a time may run the loop, by
`Stimulator.run`, `sample`, `tare` or `identify`, or in lockstep by `Events.within`. The call of a
second thread raises `BusyError`, and changes nothing. `Stimulator.close` disarms, and ends a run in
another thread with a `BenchError`. Textures, traces and read recordings are immutable.
"""

from smarttac_can.bench.calibration import Calibration, mean_gauges, weigh, write_calibration
from smarttac_can.bench.errors import (
    BusyError,
    FaultError,
    NotReadyError,
    NotRunningError,
    RunInterruptedError,
)
from smarttac_can.bench.events import Event, Events
from smarttac_can.bench.link import Reading
from smarttac_can.bench.plate_loads import Placing, Weighing, read_plan
from smarttac_can.bench.recording import Recording
from smarttac_can.bench.recording_file import (
    RecordedData,
    UnknownChannelError,
    make_recording,
    read_recording,
)
from smarttac_can.bench.self_test import selftest
from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.bench.textures import Texture, Tracking, track
from smarttac_can.bench.traces import Trace, read_csv, sha256, write_csv
from smarttac_can.canopen.master.errors import (
    BenchError,
    BusLostError,
    HeartbeatLostError,
    NodeNotFoundError,
    RefusedError,
    WrongDeviceError,
)
from smarttac_can.vocabulary.states import Law, Mode, State, VibrationLaw

__all__ = [
    "BenchError",
    "BusLostError",
    "BusyError",
    "Calibration",
    "Event",
    "Events",
    "FaultError",
    "HeartbeatLostError",
    "Law",
    "Mode",
    "NodeNotFoundError",
    "NotReadyError",
    "NotRunningError",
    "Placing",
    "Reading",
    "RecordedData",
    "Recording",
    "RefusedError",
    "RunInterruptedError",
    "State",
    "Stimulator",
    "Texture",
    "Trace",
    "Tracking",
    "UnknownChannelError",
    "VibrationLaw",
    "Weighing",
    "WrongDeviceError",
    "make_recording",
    "mean_gauges",
    "plate_od",
    "read_csv",
    "read_plan",
    "read_recording",
    "selftest",
    "sha256",
    "stimulator_od",
    "track",
    "weigh",
    "write_calibration",
    "write_csv",
]
