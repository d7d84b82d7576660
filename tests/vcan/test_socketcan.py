"""Rules for every bus, on SocketCAN."""

from collections.abc import Iterator

import pytest
from bus_lines import Line, PythonCanLine
from every_bus import *  # noqa: F403
from processes import CHANNEL

from smarttac_can.host.python_can import PythonCanBus


@pytest.fixture
def line() -> Iterator[Line]:
    opened = PythonCanLine(lambda: PythonCanBus("socketcan", CHANNEL))
    yield opened
    opened.close()
