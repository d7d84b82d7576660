"""Rules for every bus, on the ones that need no kernel's CAN."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from bus_lines import Line, LocalLine, PythonCanLine
from every_bus import *  # noqa: F403

from smarttac_can.host.python_can import PythonCanBus


@pytest.fixture(params=["local", "virtual", "udp_multicast"])
def line(request: pytest.FixtureRequest, multicast: dict[str, Any]) -> Iterator[Line]:
    lines: dict[str, Callable[[], Line]] = {
        "local": LocalLine,
        "virtual": lambda: PythonCanLine(lambda: PythonCanBus("virtual", "toy")),
        "udp_multicast": lambda: PythonCanLine(lambda: PythonCanBus(**multicast)),
    }
    opened = lines[request.param]()
    yield opened
    opened.close()
