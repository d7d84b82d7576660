import re
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smarttac_can.canopen.od.units import ONE, Quantity, split_name

VOLTAGES = ["V", "mV", "uV", "kV"]
SPEEDS = ["m/s", "mm/s", "um/ms", "km/s"]
PURE = ["", "%", "ppm", "1", "mm/m"]
KINDS = [VOLTAGES, SPEEDS, PURE, ["N s/m", "mN s/m", "N s/km"], ["m/s^2", "mm/s^2"]]


def quantity(number: str, symbol: str) -> Quantity:
    return Quantity(Decimal(number), symbol)


@pytest.mark.parametrize(
    ("parameter_name", "name", "unit", "si"),
    [
        ("Voltage [10 mV]", "Voltage", quantity("10", "mV"), 0.01),
        ("COF [0.0001]", "COF", quantity("0.0001", ""), 0.0001),
        ("Tau [0.1 us]", "Tau", quantity("0.1", "us"), 1e-7),
        ("Temperature [0.01 degC]", "Temperature", quantity("0.01", "degC"), 0.01),
        ("Amplitude [nm]", "Amplitude", quantity("1", "nm"), 1e-9),
        ("Frequency [0.01 Hz]", "Frequency", quantity("0.01", "Hz"), 0.01),
        ("Speed [0.1 mm/s]", "Speed", quantity("0.1", "mm/s"), 1e-4),
        ("Damping [N s/m]", "Damping", quantity("1", "N s/m"), 1.0),
        ("Mass [g]", "Mass", quantity("1", "g"), 1e-3),
        ("Load [0.1 %]", "Load", quantity("0.1", "%"), 1e-3),
        ("Acceleration [mm/s^2]", "Acceleration", quantity("1", "mm/s^2"), 1e-3),
        ("Mode", "Mode", ONE, 1.0),
    ],
)
def test_unit_is_parted_from_the_name(
    parameter_name: str, name: str, unit: Quantity, si: float
) -> None:
    assert split_name(parameter_name) == (name, unit)
    assert unit.si == si


def test_a_name_of_any_length_takes_no_time_to_speak_of() -> None:
    for name in (f"X{' ' * 1_000_000}x]", "[" * 1_000_000, "X [" + "m " * 1_000_000):
        assert split_name(name) == (name, ONE)


@pytest.mark.parametrize("parameter_name", ["X [a]b]", "X]", "X [", "[", "]", ""])
def test_brackets_that_hold_no_end_are_part_of_the_name(parameter_name: str) -> None:
    assert split_name(parameter_name) == (parameter_name, ONE)


@pytest.mark.parametrize(
    "inside",
    [
        "1e999999999999999999999 V",
        "1e99999 V",
        f"{'9' * 5000} V",
        "1e-400 V",
        "Gm^9 " * 8,
        "Gm^9 " * 100_000,
    ],
)
def test_a_factor_that_no_float_holds_is_refused(inside: str) -> None:
    with pytest.raises(ValueError, match="is not known"):
        split_name(f"X [{inside}]")


@pytest.mark.parametrize(
    "parameter_name",
    ["X [reserved]", "X [1]", "X []", "X [0.0 mV]", "X [mmm]", "X [low.byte]", "X [-1 mV]"],
)
def test_unit_refuses_unknown_symbols(parameter_name: str) -> None:
    with pytest.raises(ValueError, match="is not known"):
        split_name(parameter_name)


@pytest.mark.parametrize(
    ("text", "read"),
    [
        ("80 V", quantity("80", "V")),
        (" 0.5um ", quantity("0.5", "um")),
        ("-3.21 mm", quantity("-3.21", "mm")),
        ("+1e-07 N s/m", quantity("1e-7", "N s/m")),
        ("35 %", quantity("35", "%")),
        ("0.35", quantity("0.35", "")),
        ("1\N{NO-BREAK SPACE}um", quantity("1", "um")),
    ],
)
def test_quantity_reads_numbers_as_typed(text: str, read: Quantity) -> None:
    assert Quantity.parse(text) == read


@pytest.mark.parametrize("micro", ["u", "\N{MICRO SIGN}", "\N{GREEK SMALL LETTER MU}"])
def test_micro_may_be_u_or_the_sign_or_the_greek_letter(micro: str) -> None:
    assert Quantity.parse(f"1 {micro}m").over(quantity("1", "nm")) == 1000.0
    assert Quantity.parse(f"2.5{micro}m/{micro}s").si == 2.5
    assert quantity("1", "mm").in_unit(f"{micro}m") == 1000.0
    assert split_name(f"Width [10 {micro}m]") == ("Width", quantity("10", "um"))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "V",
        "mV 80",
        "nan V",
        "inf V",
        "80 volts",
        "1,5 V",
        "0x10",
        "1e9999 V",
        "8\n0 V",
        "\N{ARABIC-INDIC DIGIT THREE} V",
        "1 \N{GREEK SMALL LETTER NU}m",
    ],
)
def test_quantity_refuses_malformed_numbers(text: str) -> None:
    with pytest.raises(ValueError, match="is not"):
        Quantity.parse(text)


@pytest.mark.parametrize(
    ("unit", "text"),
    [
        (ONE, ""),
        (quantity("1", "nm"), "nm"),
        (quantity("10", "mV"), "10 mV"),
        (quantity("0.0001", ""), "0.0001"),
        (quantity("1e-5", "V"), "0.00001 V"),
    ],
)
def test_a_quantity_reads_as_in_brackets(unit: Quantity, text: str) -> None:
    assert str(unit) == text


@pytest.mark.parametrize("count", [35, 3, -7, 42, 2**31 - 1, 0])
def test_counts_in_another_unit_are_the_nearest_floats(count: int) -> None:
    for unit, symbol, exact in (
        (quantity("1", "%"), "", Decimal("0.01")),
        (quantity("0.0001", ""), "", Decimal("0.0001")),
        (quantity("10", "mV"), "V", Decimal("0.01")),
        (quantity("0.1", "nm"), "um", Decimal("0.0001")),
        (quantity("2.5", "km"), "mm", Decimal("2500000")),
    ):
        nearest = float(count * exact)
        assert unit.times(count, symbol) == nearest
        assert unit.times(np.array([count, 1]), symbol).tolist() == [nearest, float(exact)]
    with pytest.raises(ValueError, match=r"^'N' is not a unit like %$"):
        quantity("1", "%").times(count, "N")


@pytest.mark.parametrize("kind", KINDS)
def test_units_of_one_kind_convert_and_others_do_not(kind: list[str]) -> None:
    for one in kind:
        for other in ["N", "degC", "K", "V s", *(each[0] for each in KINDS if each is not kind)]:
            message = f"^'{re.escape(other)}' is not a unit like {re.escape(one or '1')}$"
            with pytest.raises(ValueError, match=message):
                quantity("1", one).in_unit(other)


@given(st.data())
def test_there_and_back_is_where_one_was(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(KINDS))
    one, other = data.draw(st.sampled_from(kind)), data.draw(st.sampled_from(kind))
    there, back = quantity("1", one).in_unit(other), quantity("1", other).in_unit(one)
    assert there * back == pytest.approx(1.0, rel=1e-15)
