"""Tables of the guides beside the code."""

import inspect
import re
from pathlib import Path

import pytest

from smarttac_can.assurance.timing.loop_timing import frozen_stage
from smarttac_can.bench.simulation import PLATE_ID, STIMULATOR_ID, plate_od, stimulator_od
from smarttac_can.canopen.od.timing import bus_load, cyclic_frames, frame_seconds
from smarttac_can.host.faulty_bus import FaultyBus, FrameFault
from smarttac_can.instrument.nodes.loop_frames import crc8, is_sound, links_to_plate
from smarttac_can.instrument.nodes.states import TRANSITIONS
from smarttac_can.science.plant.faults import Fault
from smarttac_can.vocabulary.faults import SENSOR_KINDS, FaultKind
from smarttac_can.vocabulary.states import STATE_SHIFT, State, Status

GUIDES = Path(__file__).parents[1] / "docs" / "how-to"
PLATE_NODE = (GUIDES / "plate-node.md").read_text(encoding="utf-8")


def table(guide: str, header: str) -> list[list[str]]:
    """Cells of the table with that header."""
    lines = (GUIDES / guide).read_text(encoding="utf-8").splitlines()
    start = lines.index(header) + 2
    end = next(n for n in range(start, len(lines)) if not lines[n].startswith("|"))
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[start:end]]


def test_kinds_of_faults_of_the_plate_and_their_ranges() -> None:
    rows = table("break-things.md", "| Kind | | Sensor | Value | Range |")
    assert [int(row[0]) for row in rows] == [kind for kind in FaultKind if kind]
    for number, _, sensor, meaning, bounds in rows:
        kind = FaultKind(int(number))
        assert bool(sensor) == (kind in SENSOR_KINDS)
        if sensor:
            first, last = map(int, sensor.split(".."))
            for wrong in (first - 1, last + 1):
                with pytest.raises(ValueError, match="sensor"):
                    Fault(kind, wrong, 20).require_sense()
            Fault(kind, last, 20).require_sense()
        assert bool(meaning) == bool(bounds)
        if bounds:
            low, high = map(int, bounds.split(".."))
            for value in (low, high):
                Fault(kind, 9, value).require_sense()
            for value in (low - 1, high + 1):
                with pytest.raises(ValueError, match=str(value)):
                    Fault(kind, 9, value).require_sense()


def test_faults_of_the_bus() -> None:
    rows = table("break-things.md", "| Fault | By | Range |")
    ways = " ".join(row[1] for row in rows)
    assert re.findall(r"FrameFault\.(\w+)", ways) == [
        frame_fault.name for frame_fault in FrameFault
    ]
    for name, arguments in re.findall(r"`(\w+)\((port.*?|frames.*?)\)`", ways):
        parameters = list(inspect.signature(getattr(FaultyBus, name)).parameters)
        assert parameters == ["self", *arguments.split(", ")]


def test_bits_of_the_statusword() -> None:
    rows = table("../reference/pdos-and-states.md", "| Bit | Statusword | 1 means |")
    flags = {int(bit): name for bit, name, _ in rows if bit.isdigit()}
    assert flags == {flag.bit_length() - 1: (flag.name or "").lower() for flag in Status}
    (states,) = [meaning for bit, _, meaning in rows if bit == f"{STATE_SHIFT} to 10"]
    named = {int(n): name for n, name in re.findall(r"(\d) ([a-z ]+)", states)}
    assert named == {state: state.name.lower().replace("_", " ") for state in State}


def test_the_load_of_a_bus_with_a_plate_node() -> None:
    stimulator, plate = stimulator_od(), plate_od()
    for entry, value in links_to_plate(stimulator, PLATE_ID, produce_sync=True):
        entry.value = value

    def load(bit_rate: int = 1_000_000) -> int:
        return round(100 * bus_load(cyclic_frames([stimulator, plate], 1e-3), bit_rate))

    loads, at_half = [load()], load(500_000)
    for tpdos in ((2,), (3, 4)):
        for tpdo in tpdos:
            stimulator.entry(0x1800 + tpdo - 1, 2).value = 254
            stimulator.entry(0x1800 + tpdo - 1, 5).value = 0
        loads.append(load())
    assert re.findall(r"(\d+) % with", PLATE_NODE) == [str(percent) for percent in loads]
    assert f"takes {round(100 * frame_seconds(6, 1_000_000) / 1e-3)} % more" in PLATE_NODE
    assert f"does not fit: {at_half} %" in PLATE_NODE


def test_the_times_of_the_frames_of_a_cycle() -> None:
    shown = re.findall(r"^(\d\.\d{3}) ms  \w{3}(.*)$", PLATE_NODE, re.MULTILINE)
    end = 1e-3
    for text, data in shown:
        end += frame_seconds(len(data.split()), 1_000_000)
        assert float(text) == pytest.approx(end * 1e3)
    picture = (GUIDES.parent / "images" / "one-tick.svg").read_text(encoding="utf-8")
    assert [f">{round(float(text) * 1000) - 1000}<" in picture for text, _ in shown] == [True] * 5


def test_the_checks_of_the_frames_of_a_cycle() -> None:
    frames = re.findall(r"^\d\.\d{3} ms  \w{3}  (.*)$", PLATE_NODE, re.MULTILINE)
    *measurement, drive = [bytes.fromhex(frame) for frame in frames]
    assert len(measurement) == 3
    sent = b"".join(measurement)
    assert len(sent) == 24
    assert is_sound(sent)
    session = measurement[2][4] - measurement[0][4]
    assert drive[-1] == crc8(drive[:-1] + bytes((session, STIMULATOR_ID)))


def test_table_of_a_frozen_stage_equals_the_plate() -> None:
    header = (
        "| Deadline T, ms | Share of 7.5 um that is reached | Below 5 % of it after, ms | Dose "
        "| Dose from rest |"
    )
    for deadline, *cells in table("real-time.md", header):
        stage = frozen_stage(int(deadline)).as_json()
        assert [float(cell.removesuffix(" %")) for cell in cells] == [
            round(100 * stage["reached_share"], 1),
            round(stage["below_5_percent_ms"], 1),
            round(stage["dose_ratio"], 1),
            round(stage["dose_ratio_from_rest"], 1),
        ]


def test_drawing_of_states_has_each_event_that_changes_the_state() -> None:
    drawing = (GUIDES.parent / "images" / "states.svg").read_text(encoding="utf-8")
    labels = " ".join(re.findall(r"<text[^>]*>([^<]*)</text>", drawing))
    for row in TRANSITIONS:
        if row.state is not row.next:
            assert row.event.name.lower().replace("_", " ") in labels
    for state in State:
        assert state.name.lower().replace("_", " ") in labels
