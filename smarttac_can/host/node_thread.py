"""A node in a thread of this process, for buses that end at the process."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Final

from smarttac_can.host.bus import Bus
from smarttac_can.host.node import HostedNode
from smarttac_can.host.runner import run_node

_SWITCH_S: Final = 2e-4
"""Longest time in s for which another thread of Python delays a node; the default of 5 ms is five
cycles."""
_END_S: Final = 10.0


@contextmanager
def node_in_thread(node: HostedNode, bus: Bus, *, lockstep: bool = False) -> Iterator[None]:
    """Run a node until the block ends, and let the threads of this process switch more often.

    Parameters
    ----------
    node, bus, lockstep
        As for `run_node`, which closes the bus.

    Raises
    ------
    Exception
        At the end of the block: the error that ended the run.
    """
    stop = threading.Event()
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, _SWITCH_S))
    try:
        with ThreadPoolExecutor(max_workers=1, thread_name_prefix="node") as executor:
            running = executor.submit(run_node, node, bus, stop.is_set, lockstep=lockstep)
            try:
                yield
            finally:
                stop.set()
        running.result(timeout=_END_S)
    finally:
        sys.setswitchinterval(before)
