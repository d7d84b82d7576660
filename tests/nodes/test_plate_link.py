"""What a stimulator takes for granted of its plate node: its serial number, and its heartbeat."""

import pytest

from smarttac_can.bench.simulation import stimulator_od
from smarttac_can.nodes.loop_frames import links_to_plate, plate_serial

SERIAL = "Calibration.Plate serial number"


def test_no_two_simulated_plates_have_one_serial_number() -> None:
    entry = stimulator_od()[SERIAL]
    serials = [plate_serial(entry, node_id) for node_id in range(1, 128)]
    assert (serials[32], serials[33], serials[31]) == (1, 2, 127)
    assert sorted(serials) == list(range(1, 128))


@pytest.mark.parametrize(
    ("taken", "last"),
    [
        ({}, 33 << 16 | 2000),
        ({1: 1 << 16 | 1000}, 33 << 16 | 2000),
        ({4: 1 << 16 | 1000}, 1 << 16 | 1000),
        ({2: 33 << 16 | 500}, 0),
    ],
)
def test_the_last_entry_watches_the_plate_unless_that_or_the_plate_is_taken(
    taken: dict[int, int], last: int
) -> None:
    od = stimulator_od()
    for subindex, watch in taken.items():
        od.entry(0x1016, subindex).value = watch
    for entry, value in links_to_plate(od, 33, produce_sync=False):
        entry.value = value
    watches = [od.entry(0x1016, subindex).value for subindex in (1, 2, 3, 4)]
    assert watches == [taken.get(subindex, 0) for subindex in (1, 2, 3)] + [last]


def test_what_differs_from_the_default_is_kept() -> None:
    od = stimulator_od()
    first, drive, sync = od.entry(0x1404, 1), od.entry(0x1804, 1), od.entry(0x1005)
    first.value, sync.value = 0x8000_01A1, 0x81
    links = dict(links_to_plate(od, 33, produce_sync=True))
    assert first not in links
    assert sync not in links
    assert links[drive] == 0x221
