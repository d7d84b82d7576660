"""Fixtures for tests of your own bench code: a stimulator and its bus, without hardware.

Installed with the package; a test that takes ``stimulator`` gets one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from uuid import uuid4

import pytest

from smarttac_can.bench.open_link import plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.host.node_thread import node_in_thread
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.nodes.stimulator_node import StimulatorNode


@pytest.fixture
def smarttac_bus() -> Iterator[dict[str, Any]]:
    """Run a stimulator in lockstep, plate inside, as node 32 on a virtual bus of python-can.

    Yields
    ------
    dict
        Arguments for ``can.Bus`` or `Stimulator.connect`: interface and channel.
    """
    options: dict[str, Any] = {"interface": "virtual", "channel": f"smarttac-{uuid4().hex}"}
    node = StimulatorNode(stimulator_od(), PlateBlock(plate_od()), lockstep=True)
    # An error of the node is an error of the test.
    with node_in_thread(node, PythonCanBus(**options), lockstep=True):
        yield options


@pytest.fixture
def stimulator(smarttac_bus: dict[str, Any]) -> Iterator[Stimulator]:
    """Connect a `Stimulator` to ``smarttac_bus``: every run of a test gives the same numbers."""
    with Stimulator.connect(**smarttac_bus, lockstep=True) as bench:
        yield bench
