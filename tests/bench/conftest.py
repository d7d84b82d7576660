"""A look for what the tests of the bench leave behind, and a bus of real sockets."""

import os
import threading
from collections.abc import Iterator
from typing import Any

import can.interfaces.virtual
import psutil
import pytest


@pytest.fixture(autouse=True)
def leaves_nothing() -> Iterator[None]:
    threads = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= threads
    assert not can.interfaces.virtual.channels
    assert not psutil.Process().children()


@pytest.fixture
def multicast() -> dict[str, Any]:
    """Options of a bus for several processes; two test runs at once must not hear each other."""
    port = 40000 + os.getpid() % 20000
    return {"interface": "udp_multicast", "channel": "239.74.163.3", "port": port}


@pytest.fixture
def virtual(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Options of a bus for several threads."""
    return {"interface": "virtual", "channel": request.node.nodeid}
