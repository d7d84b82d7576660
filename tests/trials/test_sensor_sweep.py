"""The sweep of sensor failures: its cells, its promise, and runs in which nothing fails."""

from __future__ import annotations

import pytest

from smarttac_can.trials import sensor_sweep
from smarttac_can.trials.sensor_sweep import (
    Cell,
    grid_cells,
    parse_cell,
    random_cells,
    run_cell,
)


def test_every_cell_can_be_run_alone_by_its_name() -> None:
    for cell in (*grid_cells(), *random_cells(500, 3)):
        assert parse_cell(str(cell)) == cell


@pytest.mark.parametrize("text", ["gain=1", "mode=NONE", "failure=d:gone:1", "force=much", "x"])
def test_a_cell_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"none of|is not|no number"):
        parse_cell(text)


def test_a_cell_does_not_depend_on_the_cells_before_it() -> None:
    cells = random_cells(12, 5)
    alone = []
    for cell in cells:
        sensor_sweep._fresh_bench.cache_clear()
        sensor_sweep._identified_bench.cache_clear()
        alone.append(run_cell(cell))
    assert [run_cell(cell) for cell in reversed(cells)] == alone[::-1]


def test_a_sound_plate_is_within_the_promise() -> None:
    result = run_cell(Cell(failure="d:gain:1", identified="sound"))
    assert (result.ended_by, result.violation) == ("", "")
    assert 2.9 < result.peak_um < 3.1
