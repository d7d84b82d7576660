"""The loop of a campaign, compiled once in a test run: numba keeps it for the other processes."""

import os
from functools import partial
from importlib import import_module
from pathlib import Path
from unittest import mock

from smarttac_can.science.population.compiled import can_compile
from smarttac_can.studies.campaign.runner import prepare


def compile_once() -> None:
    """Compile the loop in this process, or load the result of another one.

    It is in a folder of this test run alone: numba does not see that a function changed which the
    loop calls.
    """
    if not can_compile():
        return
    fcntl, numba = import_module("fcntl"), import_module("numba")  # Windows lacks the first
    folder = os.environ["NUMBA_CACHE_DIR"]
    with (
        mock.patch.object(numba.config, "CACHE_DIR", folder),
        mock.patch.object(numba, "njit", partial(numba.njit, cache=True)),
        Path(folder, "lock").open("w") as lock,
    ):
        fcntl.flock(lock, fcntl.LOCK_EX)
        prepare()
