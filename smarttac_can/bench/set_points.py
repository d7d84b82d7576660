"""Set-points of a stimulator as properties, in a person's units."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import IntEnum
from re import sub
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from smarttac_can.bench.named_objects import NamedObjects, number_given
from smarttac_can.bench.textures import Texture
from smarttac_can.master.errors import RefusedError
from smarttac_can.od.cia import AbortCode
from smarttac_can.od.units import Quantity
from smarttac_can.vocabulary.textures import TextureTable

if TYPE_CHECKING:
    from smarttac_can.bench.stimulator import Stimulator

_SIDES: Final = 2
_TOLD: Final = (AbortCode.NO_DATA, AbortCode.VALUE, AbortCode.STATE)
"""Refusals of a texture whose reason is in the Message."""
_Choices = TypeVar("_Choices", bound=IntEnum)


class InUnit:
    """A property that is one object of a stimulator, in a unit of its own.

    Parameters
    ----------
    name
        Name of the object.
    unit
        Unit of the property.
    text
        What the property is.
    """

    def __init__(self, name: str, unit: str, text: str) -> None:
        self._name, self._unit, self.__doc__ = name, unit, text

    def __get__(self, bench: Stimulator, _owner: type) -> float:
        return bench.get(self._name, self._unit)

    def __set__(self, bench: Stimulator, value: float | str) -> None:
        number = in_unit(self._name, value, self._unit)
        bench.set(self._name, value if isinstance(value, str) else f"{number} {self._unit}")


def in_unit(name: str, value: float | str, unit: str) -> float:
    """Return what a person gave, a number of a unit or a text such as ``80 V``, as such a number.

    Raises
    ------
    ValueError
        If it is none, not finite, or has no unit of this kind.
    """
    if not isinstance(value, str):
        return number_given(name, value)
    try:
        return Quantity.parse(value).in_unit(unit)
    except ValueError:
        like = f"number with a unit like {unit}" if unit else "number or percentage"
        raise ValueError(f"{name} {value!r} is no {like}") from None


class Choice(Generic[_Choices]):
    """A property that is one object of a stimulator, set by a member of its choices or a name.

    Parameters
    ----------
    name
        Name of the object.
    choices
        What its values mean.
    text
        What the property is.
    """

    def __init__(self, name: str, choices: type[_Choices], text: str) -> None:
        self._name, self._choices, self.__doc__ = name, choices, text

    def __get__(self, bench: Stimulator, _owner: type) -> _Choices:
        return self._choices(round(bench.get(self._name)))

    def __set__(self, bench: Stimulator, choice: _Choices | str) -> None:
        bench.set(self._name, by_name(self._choices, choice))


class BothSides:
    """A property that is the set-points of the COF; a number sets both.

    Parameters
    ----------
    text
        What the property is.
    """

    def __init__(self, text: str) -> None:
        self.__doc__ = text

    def __get__(self, bench: Stimulator, _owner: type) -> tuple[float, float]:
        return bench.get("Setpoint.COF left"), bench.get("Setpoint.COF right")

    def __set__(self, bench: Stimulator, cof: float | str | Iterable[float | str]) -> None:
        pair = list(cof) if isinstance(cof, Iterable) and not isinstance(cof, str) else [cof] * 2
        if len(pair) != _SIDES:
            raise ValueError(f"cof {cof!r} is neither a number nor a pair, left and right")
        left, right = (in_unit("cof", one, "") for one in pair)
        bench.set("Setpoint.COF left", left)
        bench.set("Setpoint.COF right", right)


def choose_slot(objects: NamedObjects, slot: int) -> None:
    """Choose the slot of the texture that is played."""
    if type(slot) is not int:
        raise ValueError(f"texture slot {slot!r} is no integer")
    _give_texture(objects, "Texture.Slot", lambda: objects.write("Texture.Slot", slot))


def read_texture(objects: NamedObjects) -> Texture | None:
    """Read the texture in the chosen slot; None if it is empty."""
    data = objects.link.read_table(_table(objects))
    return Texture(TextureTable.unpack(data)) if data else None


def write_texture(objects: NamedObjects, texture: Texture | None) -> None:
    """Write a texture, or None to empty it, into the chosen slot."""
    data = b""
    if texture is not None:
        if not isinstance(texture, Texture):
            raise ValueError(f"texture {texture!r} is no Texture")
        bounds = objects.od["Setpoint.COF left"]
        texture.table.require_within(int(bounds.low), int(bounds.high))
        data = texture.table.pack()
    name = _table(objects)
    _give_texture(objects, name, lambda: objects.link.write_table(name, data))


def _table(objects: NamedObjects) -> str:
    return f"Texture table.Table {objects.link.read('Texture.Slot')}"


def _give_texture(objects: NamedObjects, name: str, write: Callable[[], None]) -> None:
    """Write something of a texture; where it is refused, say why as the stimulator does."""
    try:
        write()
    except RefusedError as error:
        if error.code not in _TOLD:
            raise
        raise RefusedError(f"cannot write {name}: {objects.message}", error.code) from error


def by_name(choices: type[IntEnum], choice: int | str) -> int:
    """Return the number of a choice that a person may have given by its name.

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
