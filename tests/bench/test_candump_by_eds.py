"""The log of a run says the same as its traces, to who has the log and the EDS and nothing else.

The EDS is read by python-canopen, the log by splitting its lines: no code of the client.
"""

import csv
import re
import struct
from collections.abc import Iterator
from decimal import Decimal
from itertools import groupby
from operator import itemgetter
from pathlib import Path

import canopen
import pytest

from smarttac_can.paper.experiments import Conditions
from smarttac_can.paper.reproduce import CANDUMP, TRACES, reproduce

EDS = Path(__file__).parents[2] / "eds"
COLUMNS = {
    "cof": "Contact.COF",
    "cof_reference": "Contact.COF reference",
    "amplitude_um": "Vibration.Amplitude",
    "voltage_v": "Vibration.Voltage",
    "frequency_hz": "Vibration.Frequency",
    "tangential_force_n": "Contact.Tangential force",
    "normal_force_n": "Contact.Normal force",
    "position_mm": "Contact.Position",
}
THOUSANDTHS = {"amplitude_um", "voltage_v", "tangential_force_n", "normal_force_n", "position_mm"}
LINE = re.compile(r"\((\d{10}\.\d{6})\) can0 ([0-9A-F]{3})#((?:[0-9A-F]{2})*)")
UNIT = re.compile(r"(.*?)(?: \[([\d.]*) ?(.*)\])?")
RUN = itemgetter("experiment", "subject")
FORMATS = {3: "h", 4: "i", 5: "B", 6: "H", 7: "I"}


class Tpdo:
    """A TPDO by the EDS: names, and how many of the displayed units a count is."""

    def __init__(self, od: canopen.ObjectDictionary, number: int) -> None:
        record = od[0x1A00 + number - 1]
        self.can_id = od[0x1800 + number - 1][1].default & 0x7FF
        self.names: list[str] = []
        self.factors: list[Decimal] = []
        self.units: list[str] = []
        code = "<"
        for position in range(1, record[0].default + 1):
            mapped = record[position].default
            variable = od.get_variable(mapped >> 16, mapped >> 8 & 0xFF)
            name = UNIT.fullmatch(variable.name)
            assert name is not None
            parent = f"{od[mapped >> 16].name}." if mapped >> 8 & 0xFF else ""
            self.names.append(parent + name[1])
            self.factors.append(Decimal(name[2] or 1))
            self.units.append(name[3] or "")
            code += FORMATS[variable.data_type]
        self.struct = struct.Struct(code)

    def decode(self, data: bytes) -> dict[str, Decimal]:
        values = self.struct.unpack(data)
        return {n: v * f for n, v, f in zip(self.names, values, self.factors, strict=True)}


def frames(log: Path) -> Iterator[tuple[Decimal, int, bytes]]:
    for line in log.read_text(encoding="ascii").splitlines():
        found = LINE.fullmatch(line)
        assert found is not None, line
        yield Decimal(found[1]), int(found[2], 16), bytes.fromhex(found[3])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smarttac_can.paper.experiments.PASSES", 2)
        reproduce(frozenset({"fig5", "table1"}), Conditions(seed=3), link="bus", folder=place)
    return place


@pytest.fixture(scope="module")
def stimulator() -> list[Tpdo]:
    od = canopen.import_od(str(EDS / "stimulator.eds"), node_id=32)
    return [Tpdo(od, number) for number in (1, 2, 3, 4)]


def cycles(folder: Path, tpdos: list[Tpdo]) -> list[list[dict[str, Decimal]]]:
    """Runs of cycles; a cycle ends with the last TPDO, a run with the start of the next."""
    by_id = {tpdo.can_id: tpdo for tpdo in tpdos}
    runs: list[list[dict[str, Decimal]]] = []
    row: dict[str, Decimal] = {}
    for _, can_id, data in frames(folder / CANDUMP):
        if can_id in by_id:
            row |= by_id[can_id].decode(data)
            if can_id == tpdos[-1].can_id:
                if row["Contact.Tick"] == 0:
                    runs.append([])
                # A node that ends repeats its last tick, to say how it left the plate.
                if not runs[-1] or row["Contact.Tick"] != runs[-1][-1]["Contact.Tick"]:
                    runs[-1].append(row)
                row = {}
    return runs


def test_the_log_says_what_the_traces_say(folder: Path, stimulator: list[Tpdo]) -> None:
    with (folder / TRACES).open(encoding="ascii", newline="") as file:
        assert file.readline() == "# format: SMARTTAC traces 2\n"
        rows = list(csv.DictReader(file))
    traces = [(label, list(group)) for label, group in groupby(rows, key=RUN)]
    _, *runs = cycles(folder, stimulator)
    assert [label[0] for label, _ in traces] == [
        *("fig5.amplitude_only", "fig5.amplitude_and_frequency"),
        *["table1"] * 4,
    ]
    for (label, trace), run in zip(traces, runs, strict=True):
        by_tick = {int(cycle["Contact.Tick"]): cycle for cycle in run}
        for row in trace:
            cycle = by_tick[int(1000 * Decimal(row["time_s"]))]
            for column, name in COLUMNS.items():
                scale = Decimal("0.001") if column in THOUSANDTHS else 1
                value = Decimal(row[column] or 0)
                assert value == cycle[name] * scale, (label, row["time_s"], column)
    assert len({row["cof"] for row in rows}) > 1000


def test_the_units_are_those_of_the_traces(stimulator: list[Tpdo]) -> None:
    units = {
        name: (factor, unit)
        for tpdo in stimulator
        for name, factor, unit in zip(tpdo.names, tpdo.factors, tpdo.units, strict=True)
    }
    assert units["Vibration.Amplitude"] == (Decimal("0.1"), "nm")
    assert units["Vibration.Voltage"] == (10, "mV")
    assert units["Vibration.Frequency"] == (Decimal("0.01"), "Hz")
    assert units["Contact.Tangential force"] == units["Contact.Normal force"] == (1, "mN")
    assert units["Contact.COF"] == (Decimal("0.0001"), "")


def test_every_measurement_in_the_log_is_answered_with_its_tick(folder: Path) -> None:
    od = canopen.import_od(str(EDS / "plate.eds"), node_id=33)
    vibration = Tpdo(od, 1)
    asked = answered = None
    count = 0
    for _, can_id, data in frames(folder / CANDUMP):
        if can_id == vibration.can_id:
            asked = vibration.decode(data)["Vibration.Tick"]
        elif can_id == od[0x1400][1].default & 0x7FF:
            answered = data[6]
            assert answered == asked
            count += 1
    assert count > 500


def test_the_time_stamps_never_go_back(folder: Path) -> None:
    stamps = [stamp for stamp, _, _ in frames(folder / CANDUMP)]
    assert stamps == sorted(stamps)
