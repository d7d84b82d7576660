"""Quantities: one count of an object, as in ``Voltage [10 mV]``, and values with a unit.

A ParameterName of our EDS files ends with the unit of one count in brackets. Here the unit is
taken off, and the object is called by the rest: ``Contact.COF`` for "COF [0.0001]" in the record
"Contact".

The names in the files keep their unit. Foreign tools show a raw value beside the ParameterName
and nothing else, so without the unit 3600 would not say that it is a coefficient of 0.36.
python-canopen finds an object by the whole ParameterName ("Contact", "COF [0.0001]"). DCFs, DBC
signals and users' scripts that exist would break if the names changed. Where a person gives a
name to ``smarttac sdo`` or ``eds dcf --set``, `ObjectDictionary.called` takes each spelling that
can be seen somewhere: ``Contact.COF``, ``Contact.COF [0.0001]``, and ``COF [0.0001]`` or ``COF``
alone if only one object is called so. Another unit in the brackets is refused: it would be
another scale. A bench, whose names are code, takes ``Contact.COF`` alone.
"""

from __future__ import annotations

import re
from collections import Counter
from decimal import ROUND_HALF_EVEN, Context, Decimal, DivisionByZero, InvalidOperation, Overflow
from math import inf
from typing import Any, Final, NamedTuple, Self

_ASCII: Final = {ord("\N{MICRO SIGN}"): "u", ord("\N{GREEK SMALL LETTER MU}"): "u"}
"""Spellings of micro, and the u that object dictionaries use."""
_SYMBOLS: Final = {
    prefix + base: (base, ten - 3 * (base == "g"))
    for prefix, ten in {"G": 9, "M": 6, "k": 3, "": 0, "m": -3, "u": -6, "n": -9, "p": -12}.items()
    for base in ("m", "s", "V", "A", "N", "Hz", "K", "W", "J", "Pa", "Ohm", "rad", "g")
} | {"cm": ("m", -2), "degC": ("degC", 0), "1": ("", 0), "%": ("", -2), "ppm": ("", -6)}
"""Base unit of each symbol, empty for a pure number, and its power of ten."""
EXACT: Final = Context(
    prec=28,
    rounding=ROUND_HALF_EVEN,
    Emin=-999_999,
    Emax=999_999,
    capitals=1,
    clamp=0,
    flags=[],
    traps=[DivisionByZero, InvalidOperation, Overflow],
)
"""Context of all decimal arithmetic: that of the thread is the caller's, who may have set it
to three digits."""
_LONGEST: Final = 40
"""Most characters inside the brackets."""
_QUANTITY: Final = re.compile(r"([+-]?[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]{1,3})?)\s*(.*)")
_TERM: Final = re.compile(r"(?P<symbol>[A-Za-z%1]+)(?:\^(?P<power>[1-9]))?")


class Quantity(NamedTuple):
    """A number with a unit, stored exactly as written."""

    number: Decimal
    symbol: str
    """Symbol of the unit, such as ``mV`` or ``mm/s``; empty for a pure number."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a text such as ``80 V``, ``0.5um``, ``35 %`` or ``0.35``; ValueError for any other.

        Micro may be written as u, as the micro sign or as the Greek letter mu; it becomes u.
        """
        found = _QUANTITY.fullmatch(text.strip())
        if found is None:
            raise ValueError(f"{text!r} is not a number with a unit")
        symbol = found[2].translate(_ASCII)
        _meaning(symbol)
        return cls(Decimal(found[1]), symbol)

    def __str__(self) -> str:
        """Return the text in brackets: ``10 mV``, or ``mV`` if the number is 1."""
        return self.symbol if self.number == 1 else f"{self.number:f} {self.symbol}".rstrip()

    @property
    def si(self) -> float:
        """Value in SI base units (V, m, s, N, degC ...)."""
        return float(EXACT.scaleb(self.number, _meaning(self.symbol)[0]))

    def over(self, other: Quantity) -> float:
        """Return the ratio to another quantity, as the nearest float.

        Raises
        ------
        ValueError
            The quantities have units of different kinds.
        """
        ten, kind = _meaning(self.symbol)
        other_ten, other_kind = _meaning(other.symbol)
        if kind != other_kind:
            raise ValueError(f"{other.symbol!r} is not a unit like {self.symbol or 1}")
        ratio = EXACT.divide(self.number, other.number)
        return float(EXACT.scaleb(ratio, ten - other_ten))

    def in_unit(self, symbol: str) -> float:
        """Return the value in another unit, as the nearest float; raises ValueError as `over`."""
        return self.over(Quantity(Decimal(1), symbol))

    def times(self, counts: Any, symbol: str) -> Any:
        """Return a multiple in another unit, without the rounding error of `in_unit` times counts.

        Parameters
        ----------
        counts
            Factor: a number, or an array of integers.
        symbol
            Symbol of the unit.

        Returns
        -------
        float or array
            Nearest floats: 35 times 1 % is 0.35.

        Raises
        ------
        ValueError
            The unit is of another kind.
        """
        self.in_unit(symbol)
        exponent = int(self.number.as_tuple().exponent)
        ten = exponent + _meaning(self.symbol)[0] - _meaning(symbol)[0]
        mantissa = int(EXACT.scaleb(self.number, -exponent))
        return counts * mantissa * 10 ** max(ten, 0) / 10 ** max(-ten, 0)


ONE: Final = Quantity(Decimal(1), "")


def split_name(parameter_name: str) -> tuple[str, Quantity]:
    """Split a parameter name into the name and the quantity of one count, `ONE` without brackets.

    Raises
    ------
    ValueError
        The brackets contain no unit.
    """
    name, opened, brackets = parameter_name.rpartition("[")
    inside = brackets.removesuffix("]")
    if not opened or inside == brackets or "]" in inside:
        return parameter_name, ONE
    unknown = ValueError(f"unit [{inside}] of {parameter_name!r} is not known")
    if len(inside) > _LONGEST:
        raise unknown
    inside = inside.strip()
    unit = Quantity.parse(inside if inside[:1].isdigit() else f"1 {inside}")
    # In many other EDS files a name ends in an array index such as "[1]" or "[3]".
    if not (unit.symbol or "." in inside) or not 0.0 < unit.si < inf:
        raise unknown
    return name.rstrip(), unit


def _meaning(unit: str) -> tuple[int, Counter[str]]:
    """Return the power of ten from a unit such as ``N s/m`` to SI base units, and their powers."""
    total = 0
    powers: Counter[str] = Counter()
    for side, sign in zip(unit.translate(_ASCII).split("/", 1), (1, -1), strict=False):
        for term in side.split():
            found = _TERM.fullmatch(term)
            if found is None or found["symbol"] not in _SYMBOLS:
                raise ValueError(f"unit {unit!r} is not known")
            base, ten = _SYMBOLS[found["symbol"]]
            power = sign * int(found["power"] or 1)
            total += power * ten
            powers[base] += power if base else 0
    return total, powers
