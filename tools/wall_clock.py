"""What the tools share that measure the loop by the clock: `bench_realtime`, `_sdo`, `_stops`."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Final, NoReturn

import harness

from smarttac_can.host.bus import BusError
from smarttac_can.master.errors import BenchError

_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
POLL_S: Final = 0.2
"""How often a tool that waits for a process looks after its loop."""


def own_bus(channel: str) -> dict[str, Any]:
    """Return the options of a bus on this computer; those of two runs at once are two."""
    return {
        "interface": "udp_multicast",
        "channel": channel,
        "port": 40000 + os.getpid() % 20000,
        "hop_limit": 0,  # what plain python-can sends stays on this computer as well
    }


def parser_of(text: str | None) -> argparse.ArgumentParser:
    """Return a parser with what all of these tools have; the text is that of the tool."""
    parser = harness.parser_of(text)
    parser.add_argument("--realtime", type=int, help="SCHED_FIFO priority of the nodes, 1..99")
    return parser


def received(pipe: Connection, meanwhile: Callable[[], None] = lambda: None) -> Any:
    """Receive something from a process of the tool, or raise its BenchError."""
    while not pipe.poll(POLL_S):
        meanwhile()
    try:
        what = pipe.recv()
    except EOFError:
        raise BenchError("a process that measures has ended") from None
    if isinstance(what, BenchError):
        raise what
    return what


def finished(measure: Callable[[], int]) -> int:
    """Measure, and return the exit code: 1 for what could not be measured, with the reason.

    A signal ends all processes that the tool has begun, and itself by 128 and the signal.
    """

    def leave(number: int, _frame: object) -> NoReturn:
        for ending in _ENDING:
            signal.signal(ending, signal.SIG_IGN)
        sys.exit(128 + number)

    for ending in _ENDING:
        signal.signal(ending, leave)
    try:
        return measure()
    except (BenchError, BusError) as error:
        print(f"Error: {error}", file=sys.stderr)
        return 1
