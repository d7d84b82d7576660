"""What a script loads that imports the bench."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import smarttac_can


@pytest.mark.parametrize(
    "program",
    [
        "import smarttac_can.bench",
        "from smarttac_can.bench import Stimulator\nwith Stimulator.simulate('local'): pass",
    ],
    ids=["import", "local link"],
)
def test_neither_matplotlib_nor_can_is_loaded(program: str) -> None:
    root = Path(smarttac_can.__file__).parents[1]
    loaded = subprocess.run(
        [sys.executable, "-c", f"{program}\nimport sys; print(*sys.modules)"],
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert "smarttac_can.bench" in loaded
    assert {"matplotlib", "canopen", "can", "h5py"}.isdisjoint(loaded)
