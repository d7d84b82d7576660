"""The modules that a script loads by importing the bench."""

import os
import subprocess
import sys
from pathlib import Path

import smarttac_can

PROGRAM = """
import sys
from smarttac_can.bench import Stimulator

with Stimulator.simulate("local"):
    print(*sys.modules)
"""


def test_neither_matplotlib_nor_can_is_loaded_by_the_local_link() -> None:
    root = Path(smarttac_can.__file__).parents[1]
    loaded = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert "smarttac_can.bench" in loaded
    assert {"matplotlib", "canopen", "can", "h5py"}.isdisjoint(loaded)
