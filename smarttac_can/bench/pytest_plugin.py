"""Fixtures for tests of your own bench code: a stimulator and its bus, without hardware.

Installed with the package; a test that takes ``stimulator`` gets one.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any
from uuid import uuid4

import pytest

from smarttac_can.bench.open_link import plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.host.runner import run_node
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.stimulator_node import StimulatorNode

_START_S = 10.0


@pytest.fixture
def smarttac_bus() -> Iterator[dict[str, Any]]:
    """A virtual bus of python-can with a stimulator in lockstep, node-ID 32, plate inside.

    Yields
    ------
    dict
        Arguments for ``can.Bus`` or `Stimulator.connect`: interface and channel.
    """
    options: dict[str, Any] = {"interface": "virtual", "channel": f"smarttac-{uuid4().hex}"}
    node = StimulatorNode(stimulator_od(), PlateBlock(plate_od()))
    bus = PythonCanBus(**options)
    stop = threading.Event()
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="stimulator") as executor:
        running = executor.submit(run_node, node, bus, stop.is_set, lockstep=True)
        try:
            yield options
        finally:
            stop.set()
        # An error of the node is an error of the test.
        running.result(timeout=_START_S)


@pytest.fixture
def stimulator(smarttac_bus: dict[str, Any]) -> Iterator[Stimulator]:
    """A connected `Stimulator` on ``smarttac_bus``: the same numbers at every run of a test."""
    with Stimulator.connect(**smarttac_bus, lockstep=True) as bench:
        yield bench
