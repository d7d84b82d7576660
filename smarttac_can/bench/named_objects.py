"""Objects of a stimulator by name, and its set-points, in units for people."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from enum import IntEnum
from math import isfinite, nan
from numbers import Real
from re import sub
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from smarttac_can.bench.link import Link
from smarttac_can.master.errors import BenchError, RefusedError
from smarttac_can.od.cia import AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.od.units import Quantity
from smarttac_can.vocabulary.meanings import SIMULATION
from smarttac_can.vocabulary.states import State, state_in

_HINTS: Final = 3
_LEFT_OF_ZERO: Final = 1e-9
"""Largest rounding error of a 0, for example in steps of 0.1 from -38 to 38."""
_MESSAGE: Final = "Message"
DISARM_FIRST: Final = "it is armed or running, disarm() first"
ARMED: Final = (State.ARMED, State.RUNNING)
"""States in which a stimulator may drive its plate."""
SHOWN_UNITS: Final = {"mV": "V", "mN": "N", "nm": "um", "um": "mm"}
"""Units shown to people instead of those of the objects: places in mm, amplitudes in um."""
_Choices = TypeVar("_Choices", bound=IntEnum)


def finite(name: str, value: object) -> float:
    """Return a number given by a user.

    Raises
    ------
    ValueError
        If it is not a number, or not finite.
    """
    try:
        number = float(value) if isinstance(value, Real) else nan
    except OverflowError:
        number = nan
    if not isfinite(number):
        raise ValueError(f"{name} {value!r} is not a finite number")
    return number


def number_given(name: str, value: object) -> float:
    """Return a number given by a user; 0 for a rounding error.

    Raises
    ------
    ValueError
        As `finite`.
    """
    number = finite(name, value)
    return number if abs(number) >= _LEFT_OF_ZERO else 0.0


def truth(name: str, value: object) -> bool:
    """Return a boolean given by a user.

    Raises
    ------
    ValueError
        If it is neither True nor False; a text such as ``no`` would count as True.
    """
    if not isinstance(value, bool):
        raise ValueError(f"{name} {value!r} is neither True nor False")
    return value


def find_number(od: ObjectDictionary, name: str) -> Entry:
    """Return the numeric object of a name.

    Raises
    ------
    BenchError
        If there is none; the message suggests similar names.
    """
    entry = od.find(name) if isinstance(name, str) else None
    if entry is None:
        near = get_close_matches(str(name), [known.name for known in od], _HINTS)
        hint = f", perhaps {' or '.join(near)}" if near else ""
        raise BenchError(f"there is no object {name!r}{hint}")
    if not isinstance(entry.default, int | float):
        hint = ": it is the text in .message" if name == _MESSAGE else ""
        raise BenchError(f"{name} is not a number{hint}")
    return entry


def shown_unit(entry: Entry) -> str:
    """Return the unit in which recordings and live views show an object."""
    return SHOWN_UNITS.get(entry.unit.symbol, entry.unit.symbol)


def shown(entry: Entry, raw: Any) -> Any:
    """Return raw values of an object, one or an array, in its `shown_unit`."""
    return entry.unit.times(raw, shown_unit(entry))


def raw_value(entry: Entry, text: str) -> int:
    """Return the raw value of an object for a text such as ``80 V``, without checking limits.

    Raises
    ------
    ValueError
        If it is not a number with a unit of this kind, or would become 0.
    """
    raw = entry.counts(text)
    entry.require_kept(raw, text.strip())
    return raw


def in_unit(name: str, value: float | str, unit: str) -> float:
    """Return a value given by a user, a number in `unit` or a text such as ``80 V``, in `unit`.

    Raises
    ------
    ValueError
        If it is not a number, not finite, or has no unit of this kind.
    """
    if not isinstance(value, str):
        return number_given(name, value)
    try:
        return Quantity.parse(value).in_unit(unit)
    except ValueError:
        like = f"number with a unit like {unit}" if unit else "number or percentage"
        raise ValueError(f"{name} {value!r} is no {like}") from None


def with_unit(name: str, value: float | str, unit: str) -> str:
    """Return a value given by a user, as for `in_unit`, as a text with a unit.

    Raises
    ------
    ValueError
        As `in_unit`.
    """
    number = in_unit(name, value, unit)
    return value if isinstance(value, str) else f"{number} {unit}"


def by_name(choices: type[IntEnum], choice: int | str) -> int:
    """Return the number of a choice given by a user as a number or a name.

    Raises
    ------
    ValueError
        If there is no such choice.
    """
    try:
        if isinstance(choice, str):
            name = choice.upper().replace("-", "_").replace(" ", "_").replace("+", "_")
            return int(choices[name])
        return int(choices(choice))
    except (KeyError, ValueError):
        known = ", ".join(member.lower() for member in choices.__members__)
        what = sub(r"(?<=[a-z])(?=[A-Z])", " ", choices.__name__).lower()
        raise ValueError(f"{what} {choice!r} is none of {known}") from None


class NamedObjects:
    """Access by name to the numeric objects of a stimulator and of the simulation.

    Parameters
    ----------
    link
        Link to the stimulator.
    od
        Object dictionary from its EDS.
    """

    __slots__ = ("_link", "_od")

    def __init__(self, link: Link, od: ObjectDictionary) -> None:
        self._link = link
        self._od = od

    @property
    def message(self) -> str:
        """Reason why the stimulator turned itself off; empty if it did not."""
        return str(self._link.read("Message"))

    def get(self, name: str, unit: str = "") -> float:
        """Read an object of the stimulator or the simulation by name.

        Parameters
        ----------
        name
            Name of the object.
        unit
            Unit of the result, such as ``V``; the displayed unit of the object if empty.

        Raises
        ------
        BenchError
            If the object does not exist, or is not a number.
        ValueError
            If the unit is of another kind.
        """
        entry = find_number(self._od, name)
        if not isinstance(unit, str):
            raise ValueError(f"{unit!r} is not a unit like {entry.unit.symbol or 1}")
        return float(entry.unit.times(self._link.read(name), unit or entry.unit.symbol))

    def set(self, name: str, value: float | str) -> None:
        """Write an object by name; a value outside its limits is refused, not clipped.

        Parameters
        ----------
        name
            Name of the object.
        value
            Number in the displayed unit, or a text with any unit of that kind: ``80 V``.

        Raises
        ------
        RefusedError
            If the device refuses the value; nothing has changed then.
        BenchError
            If the object does not exist, or is not a number.
        ValueError
            If the value is not finite, has a unit of another kind, or is not 0 but would be rounded
            to 0 by the step of the object.
        """
        self._write(name, self._raw(name, value))

    def set_all(self, values: Mapping[str, float | str]) -> None:
        """Write objects by name, in this order; if one is refused, none is changed.

        Parameters
        ----------
        values
            Values by name, each as for `set`.

        Raises
        ------
        RefusedError, BenchError, ValueError
            As `set`; the objects written before are restored.
        """
        raws = {name: self._raw(name, value) for name, value in values.items()}
        before: dict[str, int] = {}
        try:
            for name, raw in raws.items():
                held = self._link.read(name)
                self._write(name, raw)
                before[name] = held
        except RefusedError:
            for name, held in before.items():
                self._write(name, held)
            raise

    def _raw(self, name: str, value: float | str) -> int:
        entry = find_number(self._od, name)
        text = (
            value if isinstance(value, str) else f"{number_given(name, value)} {entry.unit.symbol}"
        )
        return raw_value(entry, text)

    def nearest(self, name: str, value: float) -> float:
        """Return the value that an object holds after rounding a measured value to its step.

        `set` refuses a value that is rounded to 0; this returns 0.

        Parameters
        ----------
        name
            Name of the object.
        value
            Number in the displayed unit.

        Raises
        ------
        BenchError
            If the object does not exist, or is not a number.
        ValueError
            If the value is not finite.
        """
        entry = find_number(self._od, name)
        counts = entry.counts(f"{finite(name, value)} {entry.unit.symbol}")
        return float(counts * entry.unit.number)

    def _write(self, name: str, raw: int) -> None:
        """Write a raw value; if it is refused because of being armed, the error says so."""
        try:
            self._link.write(name, raw)
        except RefusedError as error:
            simulated = name.partition(".")[0] in SIMULATION
            if not simulated and self._is_refused_while_armed(error):
                raise RefusedError(f"{error}: {DISARM_FIRST}", error.code) from error
            raise

    def _is_refused_while_armed(self, error: RefusedError) -> bool:
        return error.code == AbortCode.STATE and self._shown_state() in ARMED

    def _shown_state(self) -> State:
        return state_in(self._link.read("Statusword"))


class InUnit(property):
    """A property for one object of a stimulator, in a fixed unit.

    Parameters
    ----------
    name
        Name of the object.
    unit
        Unit of the property.
    text
        Docstring of the property.
    """

    def __init__(self, name: str, unit: str, text: str) -> None:
        def read(bench: NamedObjects) -> float:
            return bench.get(name, unit)

        def write(bench: NamedObjects, value: float | str) -> None:
            bench.set(name, with_unit(name, value, unit))

        super().__init__(read, write)
        self.__doc__ = text

    if TYPE_CHECKING:

        def __get__(self, bench: Any, owner: type | None = None, /) -> float: ...  # type: ignore[override]
        def __set__(self, bench: NamedObjects, value: float | str, /) -> None: ...


class Choice(property, Generic[_Choices]):
    """A property for one object of a stimulator with choices, set by a member or its name.

    Parameters
    ----------
    name
        Name of the object.
    choices
        Enumeration of its values.
    text
        Docstring of the property.
    """

    def __init__(self, name: str, choices: type[_Choices], text: str) -> None:
        def read(bench: NamedObjects) -> _Choices:
            return choices(round(bench.get(name)))

        def write(bench: NamedObjects, choice: _Choices | str) -> None:
            bench.set(name, by_name(choices, choice))

        read.__annotations__["return"] = choices  # shown by documentation tools and editors
        super().__init__(read, write)
        self.__doc__ = text

    if TYPE_CHECKING:

        def __get__(self, bench: Any, owner: type | None = None, /) -> _Choices: ...  # type: ignore[override]
        def __set__(self, bench: NamedObjects, choice: _Choices | str, /) -> None: ...
