"""Fixtures for tests of your own bench code: a stimulator and its bus, without hardware.

Installed with the package; a test that takes ``stimulator`` gets one. Nothing is imported before
one of them is used: pytest loads this file for everybody who has the package.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from smarttac_can.bench.stimulator import Stimulator


@pytest.fixture
def smarttac_bus() -> Iterator[dict[str, Any]]:
    """Run a stimulator in lockstep, plate inside, as node 32 on a virtual bus of python-can.

    Yields
    ------
    dict
        Arguments for ``can.Bus`` or `Stimulator.connect`: interface and channel.
    """
    from uuid import uuid4  # noqa: PLC0415 - see above

    from smarttac_can.bench.simulation import stimulator_with_plate  # noqa: PLC0415
    from smarttac_can.host.node_thread import node_in_thread  # noqa: PLC0415
    from smarttac_can.host.python_can import PythonCanBus  # noqa: PLC0415

    options: dict[str, Any] = {"interface": "virtual", "channel": f"smarttac-{uuid4().hex}"}
    # An error of the node is an error of the test.
    with node_in_thread(stimulator_with_plate(), PythonCanBus(**options), lockstep=True):
        yield options


@pytest.fixture
def stimulator(smarttac_bus: dict[str, Any]) -> Iterator[Stimulator]:
    """Connect a `Stimulator` to ``smarttac_bus``: every run of a test gives the same numbers."""
    from smarttac_can.bench.stimulator import Stimulator  # noqa: PLC0415 - see above

    with Stimulator.connect(**smarttac_bus, lockstep=True) as bench:
        yield bench
