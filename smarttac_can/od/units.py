"""The unit in brackets that ends a parameter name, such as ``Voltage [10 mV]``."""

from __future__ import annotations

import re
from decimal import Decimal
from typing import Final, NamedTuple

_PREFIX: Final = {"G": 9, "M": 6, "k": 3, "": 0, "m": -3, "u": -6, "n": -9, "p": -12}
_BASE: Final = {
    # Exponents of ten to the SI unit; degC counts as a unit of its own.
    **dict.fromkeys(("m", "s", "V", "A", "N", "Hz", "K", "degC", "W", "J", "Pa", "Ohm", "rad"), 0),
    "g": -3,
    "1": 0,
    "%": -2,
    "ppm": -6,
}
_NAME: Final = re.compile(r"^(?P<name>.*?)\s*\[(?P<inside>[^\[\]]*)\]$")
_INSIDE: Final = re.compile(r"^(?P<factor>\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)?\s*(?P<unit>.*)$")
_TERM: Final = re.compile(r"^(?P<symbol>[A-Za-z%1]+)(?:\^(?P<power>[1-9]))?$")


class Unit(NamedTuple):
    """What one count of an integer entry stands for."""

    text: str
    """Displayed unit, such as ``mV``; empty for a pure number."""
    factor: float
    """Displayed units per count."""
    si: float
    """SI base units (V, m, s, N, degC ...) per count."""


PLAIN: Final = Unit("", 1.0, 1.0)


def split_name(parameter_name: str) -> tuple[str, Unit]:
    """Part a parameter name from its unit.

    A name without brackets is a plain number: unit ``""``, factor 1.

    Raises
    ------
    ValueError
        The brackets hold something that is no unit.
    """
    found = _NAME.match(parameter_name)
    if found is None:
        return parameter_name, PLAIN
    inside = _INSIDE.match(found["inside"].strip())
    # A name that ends in "[1]" or "[3]" counts array elements in many foreign EDS files.
    if inside is None or (not inside["unit"] and "." not in (inside["factor"] or "")):
        raise ValueError(f"unit [{found['inside']}] of {parameter_name!r} is not known")
    factor = Decimal(inside["factor"] or "1")
    exponent = _exponent(inside["unit"]) if inside["unit"] else 0
    if exponent is None or not factor:
        raise ValueError(f"unit [{found['inside']}] of {parameter_name!r} is not known")
    # Decimal, so that 0.1 us is the float nearest to 1e-7.
    return found["name"], Unit(inside["unit"], float(factor), float(factor.scaleb(exponent)))


def _exponent(unit: str) -> int | None:
    """Power of ten from a unit such as ``N s/m`` to SI base units; None where it is not known."""
    numerator, _, denominator = unit.partition("/")
    total = 0
    for side, sign in ((numerator, 1), (denominator, -1)):
        for term in side.split():
            found = _TERM.match(term)
            exponent = _symbol(found["symbol"]) if found else None
            if found is None or exponent is None:
                return None
            total += sign * int(found["power"] or 1) * exponent
    return total


def _symbol(symbol: str) -> int | None:
    if symbol in _BASE:
        return _BASE[symbol]
    prefix, base = symbol[:1], symbol[1:]
    if prefix in _PREFIX and base in _BASE and base not in ("1", "%", "ppm", "degC"):
        return _PREFIX[prefix] + _BASE[base]
    return None
