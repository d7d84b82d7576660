"""The sweep of sensor failures: its cells, its promise, and runs in which nothing fails."""

from __future__ import annotations

from dataclasses import replace

import pytest

from smarttac_can.trials import sensor_sweep
from smarttac_can.trials.sensor_sweep import (
    IDENTIFIED,
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
        sensor_sweep._bench.cache_clear()
        sensor_sweep._identification.cache_clear()
        alone.append(run_cell(cell))
    assert [run_cell(cell) for cell in reversed(cells)] == alone[::-1]


@pytest.mark.parametrize("identified", IDENTIFIED)
def test_a_cell_comes_to_the_same_twice(identified: str) -> None:
    # A gauge that fails is in the zeros of the tare, which a device keeps.
    cell = parse_cell(
        "failure=S5:offset:13894:2/4,onset=before,mode=OPEN_LOOP,dead_time=546,cycles=250,seed=59258"
    )
    cell = replace(cell, identified=identified)
    assert run_cell(cell) == run_cell(cell)


def test_the_identification_of_a_cell_is_in_force() -> None:
    bench = sensor_sweep._bench()
    resonance = bench.block.od["Model.Resonance"]
    run_cell(Cell(identified="sound"))
    assert resonance.value != resonance.default
    run_cell(Cell())
    assert resonance.value == resonance.default


def test_a_sound_plate_is_within_the_promise() -> None:
    result = run_cell(Cell(failure="d:gain:1", identified="sound"))
    assert (result.ended_by, result.violation) == ("", "")
    assert 2.9 < result.peak_um < 3.1
