"""Options, buses, and a look for what any test leaves behind."""

import os
import threading
from collections.abc import Iterator
from typing import Any

import can.interfaces.virtual
import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--write-golden",
        action="store_true",
        help="write what the nodes do now over the transcripts under tests/nodes/golden",
    )


@pytest.fixture(autouse=True)
def leaves_nothing() -> Iterator[None]:
    threads = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= threads
    assert not can.interfaces.virtual.channels
    with pytest.raises(ChildProcessError):
        os.waitpid(-1, os.WNOHANG)


@pytest.fixture
def multicast() -> dict[str, Any]:
    """Options of a bus for several processes; two test runs at once must not hear each other."""
    port = 40000 + os.getpid() % 20000
    return {"interface": "udp_multicast", "channel": "239.74.163.3", "port": port}


@pytest.fixture
def virtual(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Options of a bus for several threads."""
    return {"interface": "virtual", "channel": request.node.nodeid}
