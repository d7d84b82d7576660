"""The drive that stands in the objects of the stimulator."""

from __future__ import annotations

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.nodes.process_image import DriveOutput
from smarttac_can.vocabulary.signals import Drive


def test_a_drive_stands_with_the_tick_it_answers_and_off_it_is_0_v() -> None:
    od = stimulator_od()
    output = DriveOutput(od)
    entries = [od[f"Drive.{name}"] for name in ("Voltage", "Frequency", "Tick")]
    output.write(Drive(20.0, 43390.0), 7)
    assert [entry.value for entry in entries] == [2000, 4_339_000, 7]
    output.switch_off()
    assert [entry.value for entry in entries] == [0, 4_339_000, 7]
