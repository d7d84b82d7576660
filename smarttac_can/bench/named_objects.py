"""Objects of a stimulator by name, and its set-points, in units for people."""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from smarttac_can.bench.errors import refused_write
from smarttac_can.bench.given import Given, by_name, given, said, stays_in_process
from smarttac_can.bench.link import Link
from smarttac_can.canopen.master.errors import BenchError, RefusedError
from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.vocabulary.meanings import SIMULATION
from smarttac_can.vocabulary.states import State, state_in

_HINTS: Final = 3
_MESSAGE: Final = "Message"
DISARM_FIRST: Final = "it is armed or running, disarm() first"
ARMED: Final = (State.ARMED, State.RUNNING)
"""States in which a stimulator may drive its plate."""
SHOWN_UNITS: Final = {"mV": "V", "mN": "N", "nm": "um", "um": "mm"}
"""Units shown to people instead of those of the objects: places in mm, amplitudes in um."""
_Choices = TypeVar("_Choices", bound=IntEnum)


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


def raw_value(entry: Entry, value: Given) -> int:
    """Return the raw value of an object for a quantity, without checking limits.

    Raises
    ------
    ValueError
        If its unit is of another kind, or it would become 0.
    """
    raw = _nearest(entry, value)
    entry.require_kept(raw, value.quantity, value.name)
    return raw


def _nearest(entry: Entry, value: Given) -> int:
    try:
        return round(value.quantity.over(entry.unit))
    except (ValueError, OverflowError):
        like = f"number with a unit like {entry.unit.symbol or 1}"
        raise ValueError(f"{value.name} {value} is no {like}") from None


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

    __reduce_ex__ = stays_in_process("a stimulator")

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
        symbol = entry.unit.symbol if unit == "" else unit
        try:
            entry.unit.in_unit(symbol)
        except (ValueError, AttributeError):
            like = entry.unit.symbol or "%"
            raise ValueError(f"{name} has no unit {said(unit)}: give one like {like}") from None
        return float(entry.unit.times(self._link.read(name), symbol))

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
        self._set(name, self._given(name, value))

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
        if not isinstance(values, Mapping):
            raise ValueError(f"values {said(values)} are no mapping of names to values")
        self._set_all({name: self._given(name, value) for name, value in values.items()})

    def _given(self, name: str, value: float | str) -> Given:
        return given(name, value, find_number(self._od, name).unit.symbol)

    def _set(self, name: str, value: Given) -> None:
        self._write(name, raw_value(find_number(self._od, name), value), value)

    def _set_all(self, values: Mapping[str, Given]) -> None:
        raws = {name: raw_value(find_number(self._od, name), v) for name, v in values.items()}
        last = [*raws][-1:]  # nothing follows it, so that its old value is never needed
        before: dict[str, int] = {}
        with self._link.turn:
            try:
                for name, raw in raws.items():
                    old = {} if name in last else {name: self._link.read(name)}
                    self._write(name, raw, values[name])
                    before |= old
            except RefusedError:
                for name, held in before.items():
                    self._write(name, held)
                raise

    def _set_alike(self, values: Mapping[str, Given]) -> None:
        """Write objects that only their bounds refuse: a value outside goes first.

        So nothing has changed when it is refused, and no old value has to be read.
        """
        entries = {name: find_number(self._od, name) for name in values}
        raws = {name: raw_value(entries[name], values[name]) for name in values}
        with self._link.turn:
            for name in sorted(
                values, key=lambda name: entries[name].low <= raws[name] <= entries[name].high
            ):
                self._write(name, raws[name], values[name])

    def nearest(self, name: str, value: float | str) -> float:
        """Return the value that an object holds after rounding a measured value to its step.

        `set` refuses a value that is rounded to 0; this returns 0.

        Parameters
        ----------
        name
            Name of the object.
        value
            Number in the displayed unit, or a text with any unit of that kind.

        Raises
        ------
        BenchError
            If the object does not exist, or is not a number.
        ValueError
            If the value is not finite, or has a unit of another kind.
        """
        entry = find_number(self._od, name)
        return float(entry.unit.times(_nearest(entry, self._given(name, value)), entry.unit.symbol))

    def _write(self, name: str, raw: int, value: Given | None = None) -> None:
        """Write a raw value; a refusal has the words of who gave it, and says if it is armed."""
        try:
            self._link.write(name, raw)
        except RefusedError as error:
            refused = refused_write(self._od[name], raw, Abort(error.code), value)
            simulated = name.partition(".")[0] in SIMULATION
            if not simulated and self._is_refused_while_armed(error):
                refused = RefusedError(f"{refused}: {DISARM_FIRST}", error.code)
            raise refused from error

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
            bench._set(name, given(self._called, value, unit))  # noqa: SLF001 - a part of it

        super().__init__(read, write)
        self.__doc__ = text
        self._called = name

    def __set_name__(self, _owner: type, name: str) -> None:
        self._called = name

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
