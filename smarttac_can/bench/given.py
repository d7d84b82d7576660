"""Values that a caller gives: taken, or refused in one line.

Every argument of the bench goes through this module, so that all refusals read alike: the name
and the value in the words and the unit of the caller, the bound in the same unit, and what to give.
A number may be one of Python, of numpy or a 0-dimensional array. A boolean is no number, because
what is meant by ``cof=True`` cannot be known. A masked element is no number either.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from decimal import Decimal
from enum import IntEnum
from math import isfinite, nan
from numbers import Integral, Real
from re import sub
from typing import Any, Final, NamedTuple, NoReturn

import numpy as np

from smarttac_can.canopen.od.units import Quantity

_ZERO: Final = 1e-9
"""Largest rounding error of a 0, for example in steps of 0.1 from -38 to 38."""
_MOST_KEYS: Final = 100
_LONGEST_VALUE: Final = 1000
_MOST_INTEGER: Final = (1 << 63) - 1
_LONGEST: Final = 60
"""Most characters of a refused value in a message."""


class Given(NamedTuple):
    """A number with a unit, as the caller gave it, and the caller's name for it."""

    name: str
    quantity: Quantity

    def __str__(self) -> str:
        """Return the quantity for a message, such as ``0.5 um``."""
        return f"{float(self.quantity.number):.12g} {self.quantity.symbol}".rstrip()


def outside(name: str, value: float, low: float, high: float, unit: str = "") -> str:
    """Return the message on a value that is outside its bounds, all in one unit.

    Examples
    --------
    >>> outside("voltage", 250, 0, 200, "V")
    'voltage 250 V is above 200 V: give 0 to 200 V'
    """
    side, bound = ("above", high) if value > high else ("below", low)
    of = f" {unit}" if unit else ""
    return f"{name} {value:.12g}{of} is {side} {bound:.12g}{of}: give {low:.12g} to {high:.12g}{of}"


def said(value: object) -> str:
    """Return a value for a message, in one line of up to 60 characters."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # an integer of more digits than Python writes
        return f"of type {type(value).__name__}"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def plain(value: object) -> object:
    """Return what a scalar or 0-dimensional array holds, of numpy or another library.

    A masked array is returned unchanged, as are all other values.
    """
    masked = isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value)
    item = getattr(value, "item", None) if getattr(value, "ndim", None) == 0 else None
    return item() if callable(item) and not masked else value


def finite(name: str, value: object) -> float:
    """Return a number.

    Raises
    ------
    ValueError
        If it is not a number, or not finite.
    """
    held = plain(value)
    try:
        number = float(held) if isinstance(held, Real | Decimal) and not _is_boolean(held) else nan
    except OverflowError:
        number = nan
    if not isfinite(number):
        raise ValueError(f"{name} {said(value)} is not a finite number")
    return number


def number_given(name: str, value: object) -> float:
    """Return a number; 0 for a rounding error.

    Raises
    ------
    ValueError
        As `finite`.
    """
    number = finite(name, value)
    return number if abs(number) >= _ZERO else 0.0


def whole(name: str, value: object) -> int:
    """Return an integer.

    Raises
    ------
    ValueError
        If it is not an integer; 1.0 and True are none.
    """
    held = plain(value)
    if not isinstance(held, Integral) or _is_boolean(held):
        raise ValueError(f"{name} {said(value)} is no integer: give a whole number")
    return int(held)


def integer(name: str, value: object, low: int, high: int) -> int:
    """Return an integer within bounds.

    Raises
    ------
    ValueError
        If it is not an integer, or outside its bounds.
    """
    number = whole(name, value)
    if not low <= number <= high:
        raise ValueError(outside(name, number, low, high))
    return number


def truth(name: str, value: object) -> bool:
    """Return a boolean.

    Raises
    ------
    ValueError
        If it is neither True nor False; a text such as ``no`` would count as True.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{name} {said(value)} is neither True nor False")
    return value


def given(name: str, value: object, unit: str) -> Given:
    """Return a number in `unit`, or a text with a unit of this kind such as ``80 V``.

    Raises
    ------
    ValueError
        If it is not a number, not finite, or has no unit of this kind.
    """
    held = plain(value)
    if not isinstance(held, str):
        return Given(name, Quantity(Decimal(str(number_given(name, value))), unit))
    try:
        quantity = Quantity.parse(held)
        quantity.in_unit(unit)
    except ValueError:
        like = f"number with a unit like {unit}" if unit else "number or percentage"
        raise ValueError(f"{name} {said(held)} is no {like}") from None
    return Given(name, quantity)


def given_integer(name: str, value: object) -> Given:
    """Return an integer for an object; ValueError as `whole`."""
    return Given(name, Quantity(Decimal(whole(name, value)), ""))


def within(name: str, value: object, low: float, high: float, unit: str) -> float:
    """Return a value in `unit`, given as for `given`.

    Raises
    ------
    ValueError
        As `given`, or if it is outside its bounds, which are in `unit`; the message has them in the
        unit of the caller.
    """
    quantity = given(name, value, unit).quantity
    number = quantity.in_unit(unit)
    if not low <= number <= high:
        one = Quantity(Decimal(1), unit).in_unit(quantity.symbol)
        shown = float(quantity.number)
        raise ValueError(outside(name, shown, low * one, high * one, quantity.symbol))
    return number


def by_name(choices: type[IntEnum], choice: object) -> int:
    """Return the number of a choice: a member, its number or its name.

    Raises
    ------
    ValueError
        If there is no such choice; a member of other choices is none.
    """
    held = plain(choice)
    try:
        if isinstance(held, str):
            name = held.upper().replace("-", "_").replace(" ", "_").replace("+", "_")
            return int(choices[name])
        other = isinstance(held, IntEnum) and not isinstance(held, choices)
        if not isinstance(held, Integral) or _is_boolean(held) or other:
            raise ValueError
        return int(choices(int(held)))
    except (KeyError, ValueError):
        known = ", ".join(member.lower() for member in choices.__members__)
        what = sub(r"(?<=[a-z])(?=[A-Z])", " ", choices.__name__).lower()
        raise ValueError(f"{what} {said(choice)} is none of {known}") from None


def require_text(name: str, text: object, least: int, most: int) -> None:
    """Refuse what is not a text, too short or long, or has surrogates of non-UTF-8 bytes.

    Raises
    ------
    ValueError
        With the name and the bounds.
    """
    if not isinstance(text, str) or not least <= len(text) <= most:
        raise ValueError(f"{name} {said(text)} is no text of {least} to {most} characters")
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise ValueError(f"{name} {said(text)} has characters that UTF-8 does not have")


def metadata(values: object) -> dict[str, str | float]:
    """Return keys and values with which a caller describes a run or a recording, as they are kept.

    Raises
    ------
    ValueError
        If it is not a mapping of up to 100 keys, a key is not a text of 1 to 100 characters, or a
        value is neither a text of up to 1000 characters nor a finite number.
    """
    if values is None:
        return {}
    if not isinstance(values, Mapping) or len(values) > _MOST_KEYS:
        raise ValueError(f"metadata {said(values)} is no mapping of up to {_MOST_KEYS} keys")
    kept: dict[str, str | float] = {}
    for key, value in values.items():
        require_text("key of the metadata", key, 1, _MOST_KEYS)
        held = plain(value)
        if isinstance(held, str):
            require_text(key, held, 0, _LONGEST_VALUE)
            kept[key] = str(held)
        elif isinstance(held, Integral) and not _is_boolean(held):
            kept[key] = integer(key, held, -_MOST_INTEGER, _MOST_INTEGER)
        else:
            kept[key] = finite(key, held)
    return kept


def require_callable(name: str, function: object) -> None:
    """Refuse what cannot be called, before anything is done for which it is needed.

    Raises
    ------
    ValueError
        If it is no function.
    """
    if not callable(function):
        raise ValueError(f"{name} {said(function)} is no function")


def stays_in_process(what: str) -> Callable[[Any, Any], NoReturn]:
    """Return a ``__reduce_ex__`` for an object that owns a bus or an instrument of this process.

    A copy, by pickle or `copy`, would be a second owner.
    """

    def refuse(_self: Any, _protocol: Any) -> NoReturn:
        raise TypeError(
            f"{what} cannot be copied or pickled: it belongs to this process; connect or simulate "
            "in the other one, and send traces, which can be pickled"
        )

    return refuse


def sequence(name: str, values: object) -> list[Any]:
    """Return values that have an order, as a list.

    Raises
    ------
    ValueError
        If they cannot be counted through, or have no order.
    """
    if isinstance(values, str | bytes | dict | set | frozenset) or not isinstance(values, Iterable):
        raise ValueError(f"{name} {said(values)} is no list")
    return list(values)


def _is_boolean(value: object) -> bool:
    return isinstance(value, bool | np.bool_)
