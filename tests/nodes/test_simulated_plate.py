"""The simulated plate behind its objects: whose finger it is, and how that moves."""

import pytest

from smarttac_can.bench.simulation import plate_od
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.plant.finger import Lifted, Stroke, Trajectory

RECORDING = Trajectory([(0.0, 0.0, 0.8), (1.0, 0.0, 0.8)])
NAMES = (
    "dry", "fair", "supple", "moist", "sticky", "fitted-1", "fitted-2", "fitted-3", "fitted-4"
)  # fmt: skip


def test_the_subjects_are_numbered_from_1() -> None:
    block = PlateBlock(plate_od())
    for number, name in enumerate(NAMES, 1):
        block.write("Simulation.Subject", number)
        block.write("Simulation.Start run", 1)
        assert block.plate._subject.name == name


def finger_of(block: PlateBlock, motion: int) -> object:
    block.write("Finger.Motion", motion)
    block.write("Simulation.Start run", 1)
    return block.plate._finger


def test_the_finger_is_lifted_strokes_or_is_the_recorded_one() -> None:
    block = PlateBlock(plate_od(), RECORDING)
    assert finger_of(block, 2) is RECORDING
    assert isinstance(finger_of(block, 1), Stroke)
    assert isinstance(finger_of(block, 0), Lifted)


def test_where_there_is_no_recording_that_finger_alone_is_refused() -> None:
    block = PlateBlock(plate_od())
    with pytest.raises(Abort) as refused:
        block.write("Finger.Motion", 2)
    assert refused.value.code == AbortCode.STATE
    assert isinstance(finger_of(block, 1), Stroke)
    block.write("Simulation.Seed", 2)
    assert block.od["Simulation.Seed"].value == 2


def test_a_stored_motion_without_its_recording_is_a_lifted_finger() -> None:
    block = PlateBlock(plate_od())
    block.od["Finger.Motion"].value = 2
    block.start_run()
    assert isinstance(block.plate._finger, Lifted)


GAUGES = [f"Gauge.S{number}" for number in range(1, 7)]


def readings(block: PlateBlock) -> list[float]:
    """Means of 64 samples of S1..S6 in N, whose noise is 4.3 mN."""
    rows = []
    for _ in range(64):
        block.cycle()
        rows.append([block.od[name].si_value for name in GAUGES])
    return [sum(column) / 64 for column in zip(*rows, strict=True)]


def test_a_weight_lies_on_the_simulated_plate_at_once_and_beyond_a_start() -> None:
    block = PlateBlock(plate_od())
    bare = readings(block)
    for name, raw in (("Force x", 500), ("Force y", -250), ("Normal force", 2000)):
        block.write(f"Weight.{name}", raw)
    loads = [0.49, -0.27, 0.5, 0.5, 0.5, 0.5]
    for act in (lambda: None, block.start_run):
        act()
        under = readings(block)
        assert [u - b for u, b in zip(under, bare, strict=True)] == pytest.approx(loads, abs=5e-3)
    block.write("Weight.Position", 1400)  # half way to S4 and S6
    loads[2:] = [0.25, 0.75, 0.25, 0.75]
    under = readings(block)
    assert [u - b for u, b in zip(under, bare, strict=True)] == pytest.approx(loads, abs=5e-3)
    for name in ("Force x", "Force y", "Normal force"):
        block.write(f"Weight.{name}", 0)
    assert readings(block) == pytest.approx(bare, abs=5e-3)
