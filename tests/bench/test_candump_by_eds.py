"""The log of a run says the same as its traces, to a reader with the log and the EDS alone.

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

from smarttac_can.studies.paper.experiments import Conditions
from smarttac_can.studies.paper.reproduce import CANDUMP, TRACES, reproduce

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
LINE = re.compile(r"\(\d{10}\.\d{6}\) can0 ([0-9A-F]{3})#((?:[0-9A-F]{2})*)")
UNIT = re.compile(r"(.*?)(?: \[([\d.]*) ?.*\])?")
RUN = itemgetter("experiment", "subject")
FORMATS = {3: "h", 4: "i", 5: "B", 6: "H", 7: "I"}


class Tpdo:
    """A TPDO by the EDS: names, and how many of the displayed units a count is."""

    def __init__(self, od: canopen.ObjectDictionary, number: int) -> None:
        record = od[0x1A00 + number - 1]
        self.can_id = od[0x1800 + number - 1][1].default & 0x7FF
        self.names: list[str] = []
        self.factors: list[Decimal] = []
        code = "<"
        for position in range(1, record[0].default + 1):
            mapped = record[position].default
            variable = od.get_variable(mapped >> 16, mapped >> 8 & 0xFF)
            name = UNIT.fullmatch(variable.name)
            assert name is not None
            parent = f"{od[mapped >> 16].name}." if mapped >> 8 & 0xFF else ""
            self.names.append(parent + name[1])
            self.factors.append(Decimal(name[2] or 1))
            code += FORMATS[variable.data_type]
        self.struct = struct.Struct(code)

    def decode(self, data: bytes) -> dict[str, Decimal]:
        values = self.struct.unpack(data)
        return {n: v * f for n, v, f in zip(self.names, values, self.factors, strict=True)}


def frames(log: Path) -> Iterator[tuple[int, bytes]]:
    for line in log.read_text(encoding="ascii").splitlines():
        found = LINE.fullmatch(line)
        assert found is not None, line
        yield int(found[1], 16), bytes.fromhex(found[2])


def cycles(log: Path, tpdos: list[Tpdo]) -> list[list[dict[str, Decimal]]]:
    """Runs of cycles; a cycle ends with the last TPDO, a run with the start of the next."""
    by_id = {tpdo.can_id: tpdo for tpdo in tpdos}
    runs: list[list[dict[str, Decimal]]] = []
    row: dict[str, Decimal] = {}
    for can_id, data in frames(log):
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


def test_candump_log_decoded_by_eds_equals_the_traces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smarttac_can.studies.paper.experiments.PASSES", 2)
    reproduce(frozenset({"fig5", "table1"}), Conditions(seed=3), link="bus", folder=tmp_path)
    od = canopen.import_od(str(EDS / "stimulator.eds"), node_id=32)
    with (tmp_path / TRACES).open(encoding="ascii", newline="") as file:
        assert file.readline() == "# format: SMARTTAC traces 2\n"
        rows = list(csv.DictReader(file))
    traces = [(label, list(group)) for label, group in groupby(rows, key=RUN)]
    _, *runs = cycles(tmp_path / CANDUMP, [Tpdo(od, number) for number in (1, 2, 3, 4)])
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
