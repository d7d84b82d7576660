"""Buses, clocks, log files, process signals and the loop that runs a node on a bus."""

from __future__ import annotations

from typing import TYPE_CHECKING

from smarttac_can._faces import lazily

if TYPE_CHECKING:
    from smarttac_can.host.faulty_bus import Disturbance, FaultyBus, FrameFault
    from smarttac_can.host.front_ends import TimedFrontEnd
    from smarttac_can.host.log_file import CandumpWriter, read_candump
    from smarttac_can.host.process_signals import stop_on_signals
    from smarttac_can.host.python_can import PythonCanBus
    from smarttac_can.host.runner import node_in_thread, run_node

__all__ = [
    "CandumpWriter",
    "Disturbance",
    "FaultyBus",
    "FrameFault",
    "PythonCanBus",
    "TimedFrontEnd",
    "node_in_thread",
    "read_candump",
    "run_node",
    "stop_on_signals",
]

__getattr__ = lazily(
    __name__,
    {
        "CandumpWriter": "log_file",
        "read_candump": "log_file",
        "node_in_thread": "runner",
        "FaultyBus": "faulty_bus",
        "Disturbance": "faulty_bus",
        "FrameFault": "faulty_bus",
        "TimedFrontEnd": "front_ends",
        "stop_on_signals": "process_signals",
        "PythonCanBus": "python_can",
        "run_node": "runner",
    },
)
