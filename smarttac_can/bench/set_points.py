"""Set-points of a stimulator as properties, in a person's units."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import IntEnum
from re import sub
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from smarttac_can.bench.named_objects import NamedObjects, number_given
from smarttac_can.bench.textures import Texture
from smarttac_can.master.errors import RefusedError
from smarttac_can.od.cia import AbortCode
from smarttac_can.od.units import Quantity
from smarttac_can.vocabulary.textures import TABLE_NAMES, TextureTable

if TYPE_CHECKING:
    from smarttac_can.bench.stimulator import Stimulator

_SIDES: Final = 2
_TOLD: Final = (AbortCode.NO_DATA, AbortCode.VALUE, AbortCode.STATE)
"""Refusals of a texture whose reason is in the Message."""
_Choices = TypeVar("_Choices", bound=IntEnum)


class InUnit(property):
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
        def read(bench: Stimulator) -> float:
            return bench.get(name, unit)

        def write(bench: Stimulator, value: float | str) -> None:
            bench.set(name, with_unit(name, value, unit))

        super().__init__(read, write)
        self.__doc__ = text

    if TYPE_CHECKING:

        def __get__(self, bench: Any, owner: type | None = None, /) -> float: ...  # type: ignore[override]
        def __set__(self, bench: Stimulator, value: float | str, /) -> None: ...


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


def with_unit(name: str, value: float | str, unit: str) -> str:
    """Return what a person gave, as for `in_unit`, as a text with a unit.

    Raises
    ------
    ValueError
        As `in_unit`.
    """
    number = in_unit(name, value, unit)
    return value if isinstance(value, str) else f"{number} {unit}"


class Choice(property, Generic[_Choices]):
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
        def read(bench: Stimulator) -> _Choices:
            return choices(round(bench.get(name)))

        def write(bench: Stimulator, choice: _Choices | str) -> None:
            bench.set(name, by_name(choices, choice))

        read.__annotations__["return"] = choices  # for who shows its type
        super().__init__(read, write)
        self.__doc__ = text

    if TYPE_CHECKING:

        def __get__(self, bench: Any, owner: type | None = None, /) -> _Choices: ...  # type: ignore[override]
        def __set__(self, bench: Stimulator, choice: _Choices | str, /) -> None: ...


class BothSides(property):
    """A property that is the set-points of the COF; a number sets both.

    Parameters
    ----------
    text
        What the property is.
    """

    def __init__(self, text: str) -> None:
        def read(bench: Stimulator) -> tuple[float, float]:
            return bench.get("Setpoint.COF left"), bench.get("Setpoint.COF right")

        def write(bench: Stimulator, cof: float | str | Iterable[float | str]) -> None:
            pair = (
                list(cof) if isinstance(cof, Iterable) and not isinstance(cof, str) else [cof] * 2
            )
            if len(pair) != _SIDES:
                raise ValueError(f"cof {cof!r} is neither a number nor a pair, left and right")
            left, right = (in_unit("cof", side, "") for side in pair)
            values = {"Setpoint.COF left": left, "Setpoint.COF right": right}
            bench._objects.set_all(values)  # noqa: SLF001 - of the class whose property it is

        super().__init__(read, write)
        self.__doc__ = text

    if TYPE_CHECKING:

        def __get__(self, bench: Any, owner: type | None = None, /) -> tuple[float, float]: ...  # type: ignore[override]
        def __set__(
            self, bench: Stimulator, cof: float | str | Iterable[float | str], /
        ) -> None: ...


def choose_slot(objects: NamedObjects, slot: int) -> None:
    """Choose the slot of the texture that is played."""
    if type(slot) is not int:
        raise ValueError(f"texture slot {slot!r} is no integer")
    _give_texture(objects, "Texture.Slot", lambda: objects.set("Texture.Slot", slot))


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
    return TABLE_NAMES[objects.link.read("Texture.Slot") - 1]


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
