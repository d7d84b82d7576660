"""What the tools share that measure the loop by the clock: `bench_realtime`, `_sdo`, `_stops`."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final, NoReturn

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
    parser = argparse.ArgumentParser(description=(text or "").splitlines()[0])
    parser.add_argument("--realtime", type=int, help="SCHED_FIFO priority of the nodes, 1..99")
    parser.add_argument("--json", action="store_true", help="print JSON")
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


def results_of(tool: Path, *arguments: str) -> dict[str, Any]:
    """Run a tool of a working tree with the package of that tree, and return its JSON.

    Raises
    ------
    BenchError
        If it fails.
    """
    tree = tool.parents[1]
    done = subprocess.run(
        [sys.executable, str(tool), *arguments, "--json"],
        cwd=tree,
        env=os.environ | {"PYTHONPATH": str(tree)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise BenchError(f"{tool}: {(done.stderr.strip() or 'no word of it').splitlines()[-1]}")
    results: dict[str, Any] = json.loads(done.stdout)
    return results
