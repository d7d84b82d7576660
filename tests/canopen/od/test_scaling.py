"""Rows of quantities become the same integers whether they are scaled at once or on demand."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttac_can.canopen.od.cia import DataType, ObjectType
from smarttac_can.canopen.od.dictionary import Object, ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.scaling import QuantisedOnDemand, Quantiser
from smarttac_can.canopen.od.units import Quantity

TENTHS = Quantity.parse("0.1 um")


def entries() -> list[Entry]:
    signed, unsigned = DataType.INTEGER16, DataType.UNSIGNED16
    return [
        Entry(0x2000, 1, "Position", signed, "ro", unit=TENTHS),
        Entry(0x2000, 2, "Way", unsigned, "ro", high=1000, default=250, unit=TENTHS),
        Entry(0x2000, 3, "Plain", signed, "ro", low=-5, high=5),
    ]


@given(st.lists(st.tuples(*[st.floats(-1.0, 1.0)] * 3), min_size=1))
def test_scaling_on_demand_equals_scaling_at_once(rows: list[tuple[float, ...]]) -> None:
    eager, lazy = entries(), entries()
    quantiser, on_demand = Quantiser(eager), QuantisedOnDemand(lazy)
    for row in rows:
        quantiser.write(row)
        on_demand.row = row
        assert [entry.read() for entry in lazy] == [entry.value for entry in eager]


@pytest.mark.parametrize("si", [0.5e-7, 1.5e-7, 1e-4 + 0.5e-7, 1.0, -1.0, math.nextafter(0, 1)])
def test_both_round_and_clip_as_an_entry_does(si: float) -> None:
    eager, lazy = entries()[:2], entries()[:2]
    Quantiser(eager).write((si, si))
    QuantisedOnDemand(lazy).row = (si, si)
    wanted = [entry.quantise(si) for entry in entries()[:2]]
    assert [entry.value for entry in eager] == [entry.read() for entry in lazy] == wanted


def test_scaled_row_has_defaults_before_a_row_and_after_reset() -> None:
    row = entries()
    on_demand = QuantisedOnDemand(row)
    assert [entry.read() for entry in row] == [0, 250, 0]
    on_demand.row = (1e-6, 2e-6, 3.0)
    assert [entry.read() for entry in row] == [10, 20, 3]
    on_demand.reset()
    assert [entry.read() for entry in row] == [0, 250, 0]


def test_computed_entry_holds_no_stale_value() -> None:
    row = entries()
    on_demand = QuantisedOnDemand(row)
    od = ObjectDictionary(
        1, [Object(0x2000, "Row", ObjectType.RECORD, {entry.subindex: entry for entry in row})]
    )
    on_demand.row = (1e-6, 2e-6, 3.0)
    od.reset()
    assert [entry.read() for entry in od] == [10, 20, 3]
    assert od.number(0x2000, 2) == 20
    assert row[0].pack() == b"\x0a\x00"
    assert row[0].si_value == pytest.approx(1e-6)
    assert "Position = 10" in repr(row[0])
    with pytest.raises(AttributeError):
        _ = row[0].value
