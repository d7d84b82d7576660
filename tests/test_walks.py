"""How far a request walks: from room to room, and in calls of this package.

A room is the first folder below the package.
"""

import gc
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

import smarttac_can
from smarttac_can.bench import Stimulator
from smarttac_can.bench.can_link import CanLink

ROOT = f"{Path(smarttac_can.__file__).parent}/"


def walk(event: Callable[[], object]) -> list[str]:
    """Return the files of the package whose functions are called, in order."""
    files: list[str] = []

    def seen(frame, what, _argument):  # type: ignore[no-untyped-def]
        if what == "call" and frame.f_code.co_filename.startswith(ROOT):
            files.append(frame.f_code.co_filename.removeprefix(ROOT))

    sys.setprofile(seen)
    try:
        event()
    finally:
        sys.setprofile(None)
    return files


def moves(files: list[str]) -> int:
    rooms = [file.partition("/")[0] for file in files]
    return sum(one != other for one, other in pairwise(rooms))


@pytest.fixture(scope="module")
def bench() -> Iterator[Stimulator]:
    with Stimulator.simulate("bus") as bench:
        bench.finger.stroke(2, force=0.5, speed=50)
        bench.start_run()
        bench.tare()
        bench.cof = 0.35
        bench.mode = "friction"
        bench.run(0.3)
        yield bench


def test_a_set_point_changes_room_at_most_45_times(bench: Stimulator) -> None:
    files = walk(lambda: setattr(bench, "cof", 0.36))
    assert 2 <= moves(files) <= 45
    assert bench.cof == (0.36, 0.36)


def test_an_sdo_write_changes_room_at_most_15_times(bench: Stimulator) -> None:
    files = walk(lambda: bench._link.write("Setpoint.Amplitude", 1200))
    assert 2 <= moves(files) <= 15
    assert bench.amplitude == 1.2


@pytest.mark.sources
def test_a_driven_cycle_takes_at_most_221_calls_but_the_plant(
    bench: Stimulator,
) -> None:
    assert isinstance(bench._link, CanLink)
    sync = next(
        value.send_message
        for value in gc.get_referents(bench._link)
        if hasattr(value, "send_message")
    )
    for _ in range(2):
        sync(0x80, b"")
    files = walk(lambda: sync(0x80, b""))
    assert any("plant" in file for file in files)
    assert 100 < sum("plant" not in file for file in files) <= 221
