"""The nodes to the byte: every frame they send, and that they send no other.

A purposeful change of a transcript is written with
``pytest tests/instrument/nodes --write-golden``, and read before it is committed.
"""

from collections.abc import Callable
from pathlib import Path

import pytest
from line import Line, both_nodes, plate_alone, plate_inside, stimulator_alone
from transcript import written

GOLDEN = Path(__file__).parent / "golden"
LINES: dict[str, Callable[[], Line]] = {
    "plate_cycle": lambda: plate_alone()[0],
    "plate_period": lambda: plate_alone()[0],
    "plate_drive_tick": lambda: plate_alone()[0],
    "plate_hardware": lambda: plate_alone()[0],
    "stimulator_cycle": lambda: stimulator_alone()[0],
    "stimulator_lost_frames": lambda: stimulator_alone()[0],
    "stimulator_plate_inside": lambda: plate_inside()[0],
    "stimulator_public_sync": lambda: plate_inside()[0],
    "both_nodes": lambda: both_nodes()[0],
}


@pytest.mark.parametrize("name", LINES)
def test_golden(name: str, pytestconfig: pytest.Config) -> None:
    path = GOLDEN / f"{name}.txt"
    golden = path.read_text(encoding="ascii")
    line = LINES[name]()
    now = written(line.act, golden, line.frames)
    if pytestconfig.getoption("--write-golden"):
        path.write_text(now, encoding="ascii")
    else:
        assert now == golden


def test_no_golden_is_left_over() -> None:
    assert {path.stem for path in GOLDEN.iterdir()} == set(LINES)
