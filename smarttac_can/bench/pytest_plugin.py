"""Fixtures for tests of your own bench code: a stimulator and its bus, without hardware.

The plug-in is installed with the package: a test with the argument ``stimulator`` gets one. Imports
are inside the fixtures, because pytest loads this file for every user of the package.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
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
    from smarttac_can.host.python_can import PythonCanBus  # noqa: PLC0415
    from smarttac_can.host.runner import node_in_thread  # noqa: PLC0415

    options: dict[str, Any] = {"interface": "virtual", "channel": f"smarttac-{uuid4().hex}"}
    # An error of the node fails the test.
    with node_in_thread(stimulator_with_plate(), PythonCanBus(**options), lockstep=True):
        yield options


@pytest.fixture
def stimulator(smarttac_bus: dict[str, Any]) -> Iterator[Stimulator]:
    """Connect a `Stimulator` to ``smarttac_bus``; every run of a test gives the same numbers."""
    from smarttac_can.bench.stimulator import Stimulator  # noqa: PLC0415 - see above

    with Stimulator.connect(**smarttac_bus, lockstep=True) as bench:
        yield bench


@pytest.fixture
def make_stimulator() -> Iterator[Callable[..., Stimulator]]:
    """Create as many stimulators as a test needs, each on its own virtual bus, in lockstep.

    Yields
    ------
    callable
        ``make_stimulator(subject=1, seed=1, plate_inside=True, presets={})``: subject 1..9, seed of
        noise and finger, whether the plate is inside the stimulator, values by name that replace
        defaults, as in `Stimulator.simulate`. It returns a `Stimulator`, closed after the test, and
        raises ``ValueError`` or ``BenchError`` for an invalid preset.
    """
    from uuid import uuid4  # noqa: PLC0415 - see above

    from smarttac_can.bench.given import truth  # noqa: PLC0415
    from smarttac_can.bench.simulation import (  # noqa: PLC0415
        PLATE_ID,
        lockstep_nodes,
        raw_presets,
    )
    from smarttac_can.bench.stimulator import Stimulator  # noqa: PLC0415
    from smarttac_can.host.python_can import PythonCanBus  # noqa: PLC0415
    from smarttac_can.host.runner import node_in_thread  # noqa: PLC0415

    with ExitStack() as stack:

        def make(
            *,
            subject: int = 1,
            seed: int = 1,
            plate_inside: bool = True,
            presets: dict[str, int | str] | None = None,
        ) -> Stimulator:
            truth("plate_inside", plate_inside)
            drawn = raw_presets(presets or {}, seed=seed, subject=subject)
            options: dict[str, Any] = {"interface": "virtual", "channel": f"smarttac-{uuid4().hex}"}
            for node in lockstep_nodes(plate_inside=plate_inside, presets=drawn):
                stack.enter_context(node_in_thread(node, PythonCanBus(**options), lockstep=True))
            return stack.enter_context(
                Stimulator.connect(
                    **options, lockstep=True, plate_node_id=None if plate_inside else PLATE_ID
                )
            )

        yield make
