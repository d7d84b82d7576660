"""Options, buses, and a look for leaks of any test."""

import gc
import os
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can.interfaces.virtual
import pytest
from compile_once import compile_once
from hypothesis import HealthCheck, settings
from read_once import read_once

from smarttac_can import build
from smarttac_can.bench import simulation

pytest.register_assert_rewrite("every_bus")
# How long an example takes is up to the machine and its other jobs.
settings.register_profile(
    "any pace", settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("any pace")
# A shell ignores Ctrl-C in its background jobs, and so would all that is tested here.
signal.signal(signal.SIGINT, signal.default_int_handler)


# Thousands of tests make the nodes of the project; tests/canopen/od reads EDS files.
simulation.load_eds = read_once  # type: ignore[attr-defined]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--write-golden",
        action="store_true",
        help="write what the nodes do now over the transcripts under tests/instrument/nodes/golden",
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if build() == "compiled":
        for item in items:
            if item.get_closest_marker("sources"):
                item.add_marker(
                    pytest.mark.skip(reason="of an interpreted part, which is compiled")
                )


def pytest_collection_finish() -> None:
    """Have the collector of garbage pass over imported objects: they live as long as the run."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def any_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a run in real time wait for all of its cycles: a busy machine misses many of them."""
    monkeypatch.setattr("smarttac_can.bench.can_link.GRACE_S", 60.0)


@pytest.fixture(autouse=True)
def leaves_nothing() -> Iterator[None]:
    threads = set(threading.enumerate())
    yield
    assert set(threading.enumerate()) <= threads
    assert not can.interfaces.virtual.channels
    if hasattr(os, "WNOHANG"):  # Windows has no children to wait for
        with pytest.raises(ChildProcessError):
            os.waitpid(-1, os.WNOHANG)


@pytest.fixture(scope="session", autouse=True)
def numba_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Have compiled loops kept in a folder of this test run, for all workers and processes."""
    run = tmp_path_factory.getbasetemp()
    folder = (run.parent if "PYTEST_XDIST_WORKER" in os.environ else run) / "numba"
    folder.mkdir(exist_ok=True)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)


@pytest.fixture(scope="session")
def compiled_once(numba_cache: None) -> None:
    """Have the loop of a campaign compiled once for all workers and their processes."""
    compile_once()


@pytest.fixture
def multicast() -> dict[str, Any]:
    """Options of a bus for several processes; two test runs at once must not hear each other."""
    with socket.socket(type=socket.SOCK_DGRAM) as nobodys:
        nobodys.bind(("", 0))
        port = nobodys.getsockname()[1]
    return {"interface": "udp_multicast", "channel": "239.74.163.3", "port": port}


@pytest.fixture
def without_privileges(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Have processes of this interpreter run without root's capabilities, on Linux."""
    if os.geteuid() == 0:
        wrapper = tmp_path / "python"
        wrapper.write_text(
            f'#!/bin/sh\nexec setpriv --bounding-set=-all --inh-caps=-all {sys.executable} "$@"\n'
        )
        wrapper.chmod(0o700)
        monkeypatch.setattr(sys, "executable", str(wrapper))


@pytest.fixture
def virtual(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Options of a bus for several threads."""
    return {"interface": "virtual", "channel": request.node.nodeid}
