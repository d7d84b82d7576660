from decimal import Decimal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.canopen.od.cia import DataType
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.units import ONE, Quantity, split_name

TEN_MILLIVOLTS = Quantity(Decimal(10), "mV")


def voltage() -> Entry:
    return Entry(
        0x2100, 1, "Setpoint.Voltage", DataType.UNSIGNED16, "rww",
        low=5, high=20000, default=100, pdo=True, unit=TEN_MILLIVOLTS,
    )  # fmt: skip


def test_value_in_si() -> None:
    entry = voltage()
    assert entry.si_value == 1.0
    assert (entry.unit, entry.si) == (TEN_MILLIVOLTS, 0.01)


@pytest.mark.parametrize(
    ("text", "raw"),
    [
        *(("1 V", 100), ("0.025 V", 2), ("0.035 V", 4), ("35000 uV", 4)),
        *(("-0.5kV", -50_000), ("1e3 kV", 100_000_000), ("0 mV", 0)),
    ],
)
def test_counts_of_a_quantity_round_half_to_even_and_do_not_clip(text: str, raw: int) -> None:
    assert voltage().counts(text) == raw


@pytest.mark.parametrize(
    ("low", "refusal"),
    [(0, "would become 0: it goes in steps of 10 mV"), (5, "is below 50 mV, its lowest value")],
)
def test_quantity_that_would_become_0_is_refused(low: int, refusal: str) -> None:
    entry = voltage()
    entry.low = low
    with pytest.raises(ValueError, match=f"^Setpoint.Voltage 4 mV {refusal}$"):
        entry.require_kept(0, Quantity.parse("4 mV"), entry.name)
    entry.require_kept(0, Quantity.parse("0 V"), entry.name)
    entry.require_kept(1, Quantity.parse("6 mV"), entry.name)


def test_raw_value_is_shown_in_its_unit() -> None:
    entry = voltage()
    assert entry.shown(125) == "1250 mV"
    entry.unit = ONE
    assert entry.shown(125) == "125"


@given(
    st.decimals(-(10**9), 10**9, places=7),
    st.sampled_from(["V", "mV", "uV", "nV", "kV"]),
    st.sampled_from(["mV", "10 mV", "0.1 uV", "V", "3 mV"]),
)
def test_any_unit_of_a_kind_gives_the_same_counts(volts: Decimal, symbol: str, count: str) -> None:
    entry = voltage()
    entry.unit = split_name(f"Voltage [{count}]")[1]
    exponent = {"kV": -3, "V": 0, "mV": 3, "uV": 6, "nV": 9}[symbol]
    assert entry.counts(f"{volts.scaleb(exponent)} {symbol}") == entry.counts(f"{volts} V")


@pytest.mark.parametrize(
    ("unit", "text", "expected"),
    [
        (TEN_MILLIVOLTS, "80 N", " with a unit like mV"),
        (TEN_MILLIVOLTS, "80", " with a unit like mV"),
        (TEN_MILLIVOLTS, "nan V", " with a unit like mV"),
        (TEN_MILLIVOLTS, "1" + "0" * 400 + " V", " with a unit like mV"),
        (ONE, "80 V", ""),
        (ONE, "eighty", ""),
    ],
)
def test_counts_refuse_another_unit(unit: Quantity, text: str, expected: str) -> None:
    entry = voltage()
    entry.unit = unit
    with pytest.raises(ValueError, match=f"^Setpoint.Voltage '{text}' is not a number{expected}$"):
        entry.counts(text)


@pytest.mark.parametrize(
    ("si", "raw"),
    [(1.0, 100), (1.004, 100), (1.006, 101), (-3.0, 5), (1e9, 20000), (float("inf"), 20000)],
)
def test_quantise_rounds_and_clips(si: float, raw: int) -> None:
    assert voltage().quantise(si) == raw


def test_quantise_rounds_half_to_even() -> None:
    entry = Entry(0x2000, 0, "Count", DataType.INTEGER16, "rw")
    assert [entry.quantise(x) for x in (0.5, 1.5, -0.5, -1.5)] == [0, 2, 0, -2]


def test_a_counter_begins_anew() -> None:
    entry = Entry(0x2000, 0, "Count", DataType.UNSIGNED32, "ro", default=0xFFFF_FFFE)
    entry.count()
    assert entry.value == 0xFFFF_FFFF
    entry.count(3)
    assert entry.value == 2


def test_quantise_refuses_nan_and_real32() -> None:
    with pytest.raises(ValueError, match="NaN"):
        voltage().quantise(float("nan"))
    with pytest.raises(TypeError, match="Ratio is REAL32, not an integer"):
        Entry(0x2000, 0, "Ratio", DataType.REAL32, "rw").quantise(1.0)


@given(st.floats(allow_nan=False))
@settings(max_examples=100)
def test_quantise_never_leaves_the_limits(si: float) -> None:
    entry = voltage()
    entry.check(entry.quantise(si))


@pytest.mark.parametrize(
    ("access", "readable", "writable", "tpdo", "rpdo"),
    [
        ("ro", True, False, True, False),
        ("wo", False, True, False, True),
        ("rw", True, True, True, True),
        ("rwr", True, True, True, False),
        ("rww", True, True, False, True),
        ("const", True, False, False, False),
    ],
)
def test_access(access: str, readable: bool, writable: bool, tpdo: bool, rpdo: bool) -> None:
    entry = Entry(0x2000, 0, "X", DataType.UNSIGNED8, access, pdo=True)
    assert (entry.readable, entry.writable) == (readable, writable)
    assert (entry.tpdo_mappable, entry.rpdo_mappable) == (tpdo, rpdo)
    assert not Entry(0x2000, 0, "X", DataType.UNSIGNED8, access).tpdo_mappable
