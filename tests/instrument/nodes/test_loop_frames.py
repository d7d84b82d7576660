"""The frames of the loop have a layout that no master changes, with a check."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from line import Line

from smarttac_can.bench.network import LocalNetwork
from smarttac_can.bench.simulation import (
    STIMULATOR_ID,
    plate_od,
    stimulator_od,
    stimulator_with_plate,
)
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.instrument.nodes.loop_frames import (
    CheckedFrames,
    crc8,
    last_unsent,
    links_to_plate,
    plate_serial,
    received_drive,
    received_measurement,
    sent_drive,
    sent_measurement,
)

OF_STIMULATOR = (0x1604, 0x1605, 0x1606, 0x1A04)
OF_PLATE = (0x1600, 0x1A00, 0x1A01, 0x1A02)
DRIVE = [("Voltage", 2), ("Frequency", 4), ("Tick", 1), ("Check", 1)]


def layout(frames: CheckedFrames) -> list[tuple[str, int]]:
    entries = [*frames.entries, frames.check]
    return [(entry.name.rpartition(".")[2], entry.size) for entry in entries]


def test_both_ends_carry_the_same() -> None:
    assert layout(sent_drive(stimulator_od())) == layout(received_drive(plate_od())) == DRIVE
    measurement = layout(received_measurement(stimulator_od()))
    assert sum(size for _, size in measurement) == 24
    assert [size for _, size in measurement] == [
        size for _, size in layout(sent_measurement(plate_od()))
    ]


@pytest.mark.parametrize(
    ("od", "records"), [(stimulator_od(), OF_STIMULATOR), (plate_od(), OF_PLATE)]
)
def test_the_mappings_of_the_loop_are_constant(
    od: ObjectDictionary, records: tuple[int, ...]
) -> None:
    for index in records:
        record = od.objects[index].entries
        assert len(record) == record[0].value + 1
        assert {entry.access for entry in record.values()} == {"const"}


def test_pdo_save_of_python_canopen_skips_constant_mappings() -> None:
    line = Line(stimulator_with_plate())
    eds = Path(__file__).resolve().parents[3] / "eds" / "stimulator.eds"
    node = LocalNetwork(line.bus).add_node(STIMULATOR_ID, str(eds))
    node.tpdo.read()
    node.rpdo.read()
    node.tpdo.save()
    node.rpdo.save()
    node.tpdo.read()
    node.rpdo.read()
    assert [variable.length // 8 for variable in node.tpdo[5].map] == [size for _, size in DRIVE]


# Assumptions of a stimulator about its plate node: its serial number, and its heartbeat.


SERIAL = "Calibration.Plate serial number"


def test_no_two_simulated_plates_have_one_serial_number() -> None:
    entry = stimulator_od()[SERIAL]
    serials = [plate_serial(entry, node_id) for node_id in range(1, 128)]
    assert (serials[32], serials[33], serials[31]) == (1, 2, 127)
    assert sorted(serials) == list(range(1, 128))
    entry.default = 4711
    assert plate_serial(entry, 5) == 4711, "that of an EDS that names a plate"


@pytest.mark.parametrize(
    ("taken", "last"),
    [
        ({}, 33 << 16 | 2000),
        ({1: 1 << 16 | 1000}, 33 << 16 | 2000),
        ({4: 1 << 16 | 1000}, 1 << 16 | 1000),
        ({2: 33 << 16 | 500}, 0),
    ],
)
def test_last_1016h_entry_watches_the_plate_unless_it_is_taken(
    taken: dict[int, int], last: int
) -> None:
    od = stimulator_od()
    for subindex, watch in taken.items():
        od.entry(0x1016, subindex).value = watch
    for entry, value in links_to_plate(od, 33, produce_sync=False):
        entry.value = value
    watches = [od.entry(0x1016, subindex).value for subindex in (1, 2, 3, 4)]
    assert watches == [taken.get(subindex, 0) for subindex in (1, 2, 3)] + [last]


def test_link_to_plate_keeps_values_other_than_the_default() -> None:
    od = stimulator_od()
    first, drive, sync = od.entry(0x1404, 1), od.entry(0x1804, 1), od.entry(0x1005)
    first.value, sync.value = 0x8000_01A1, 0x81
    links = dict(links_to_plate(od, 33, produce_sync=True))
    assert first not in links
    assert sync not in links
    assert links[drive] == 0x221


def test_the_check_is_that_of_sae_j1850() -> None:
    """Check value of the catalogue of parametrised CRC algorithms (reveng, CRC-8/SAE-J1850)."""
    assert crc8(b"123456789") == 0x4B


@given(st.binary(min_size=1, max_size=23), st.data())
def test_any_wrong_bit_and_any_short_burst_is_found(data: bytes, draw: st.DataObject) -> None:
    first = draw.draw(st.integers(0, 8 * len(data) - 1))
    burst = draw.draw(st.integers(1, 255).filter(lambda bits: bits & 1))
    wrong = int.from_bytes(data, "big") ^ burst << first
    size = max(len(data), (wrong.bit_length() + 7) // 8)
    assert crc8(wrong.to_bytes(size, "big")) != crc8(data.rjust(size, b"\0"))


@given(st.binary(min_size=8, max_size=8))
def test_forged_drive_check_passes_once_in_256(data: bytes) -> None:
    """The byte that the check stands for is another for each check."""
    body = data[:7]
    named = {last_unsent(body + bytes((check,)), b"\0") for check in range(256)}
    assert len(named) == 256
    check = crc8(body + bytes((0, STIMULATOR_ID)))
    assert last_unsent(body + bytes((check,)), b"\0") == STIMULATOR_ID
