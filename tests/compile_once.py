"""The loop of a campaign, compiled once in a test run: other processes load it from the cache."""

import os
from importlib import import_module
from pathlib import Path

from smarttac_can.science.population.compiled import can_compile
from smarttac_can.studies.campaign.kept_loop import prepare


def compile_once() -> None:
    """Load the compiled loop, or compile it while the other processes wait."""
    if not can_compile():
        return
    fcntl = import_module("fcntl")  # Windows lacks it
    with Path(os.environ["NUMBA_CACHE_DIR"], "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert prepare() == ""
