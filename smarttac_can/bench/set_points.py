"""Set-points of a stimulator, in a person's units."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from enum import IntEnum
from re import sub
from typing import Final

from smarttac_can.bench.named_objects import NamedObjects, finite
from smarttac_can.bench.textures import Texture
from smarttac_can.master.errors import RefusedError
from smarttac_can.od.cia import AbortCode
from smarttac_can.vocabulary.modes import Law, VibrationLaw
from smarttac_can.vocabulary.textures import TextureTable

_SIDES: Final = 2
_TOLD: Final = (AbortCode.NO_DATA, AbortCode.VALUE, AbortCode.STATE)
"""Refusals of a texture whose reason is in the Message."""


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

    def __get__(self, bench: NamedObjects, _owner: type) -> float:
        return bench.get(self._name, self._unit)

    def __set__(self, bench: NamedObjects, value: float) -> None:
        bench.set(self._name, f"{finite(self._name, value)} {self._unit}")


class SetPoints(NamedObjects):
    """Laws, set-points and textures of a stimulator over a link."""

    __slots__ = ()

    voltage = InUnit("Setpoint.Voltage", "V", "Set-point of mode OPEN_LOOP in V.")
    frequency = InUnit(
        "Setpoint.Frequency", "Hz", "Excitation frequency in Hz: fixed, or where its loop starts."
    )
    amplitude = InUnit("Setpoint.Amplitude", "um", "Set-point of the amplitude in um peak-to-peak.")
    boundary = InUnit("Setpoint.Boundary", "mm", "Boundary in mm from the middle of the plate.")

    @property
    def law(self) -> Law:
        """Friction law: what the step of the amplitude is added to; set it by member or name."""
        return Law(self._link.read("Friction law"))

    @law.setter
    def law(self, law: Law | str) -> None:
        self._write("Friction law", by_name(Law, law))

    @property
    def vibration_law(self) -> VibrationLaw:
        """How amplitude and resonance are regulated; by member or name, also while running."""
        return VibrationLaw(self._link.read("Controller.Vibration law"))

    @vibration_law.setter
    def vibration_law(self, law: VibrationLaw | str) -> None:
        self._write("Controller.Vibration law", by_name(VibrationLaw, law))

    @property
    def cof(self) -> tuple[float, float]:
        """Set-points of the COF left and right of the boundary; a number sets both."""
        return self.get("Setpoint.COF left"), self.get("Setpoint.COF right")

    @cof.setter
    def cof(self, cof: float | Iterable[float]) -> None:
        pair = list(cof) if isinstance(cof, Iterable) and not isinstance(cof, str) else [cof] * 2
        if len(pair) != _SIDES:
            raise ValueError(f"cof {cof!r} is neither a number nor a pair, left and right")
        left, right = (finite("cof", one) for one in pair)
        self.set("Setpoint.COF left", left)
        self.set("Setpoint.COF right", right)

    @property
    def texture_slot(self) -> int:
        """Slot that mode TEXTURE plays, 1 to 4, and that `texture` is of; also while running."""
        return self._link.read("Texture.Slot")

    @texture_slot.setter
    def texture_slot(self, slot: int) -> None:
        if type(slot) is not int:
            raise ValueError(f"texture slot {slot!r} is no integer")
        self._give_texture(lambda: self._write("Texture.Slot", slot), "Texture.Slot")

    @property
    def texture(self) -> Texture | None:
        """Texture in the chosen slot, None if it is empty; also while it is played.

        Setting one raises `ValueError` if it has a COF beyond the bounds of the stimulator, and
        `RefusedError` if the stimulator refuses it; what was there stays then.
        """
        data = self._link.read_table(self._table)
        return Texture(TextureTable.unpack(data)) if data else None

    @texture.setter
    def texture(self, texture: Texture | None) -> None:
        data = b""
        if texture is not None:
            if not isinstance(texture, Texture):
                raise ValueError(f"texture {texture!r} is no Texture")
            bounds = self._od["Setpoint.COF left"]
            texture.table.require_within(int(bounds.low), int(bounds.high))
            data = texture.table.pack()
        name = self._table
        self._give_texture(lambda: self._link.write_table(name, data), name)

    @property
    def _table(self) -> str:
        return f"Texture table.Table {self.texture_slot}"

    def _give_texture(self, write: Callable[[], None], name: str) -> None:
        """Write something of a texture; where it is refused, say why as the stimulator does."""
        try:
            write()
        except RefusedError as error:
            if error.code not in _TOLD:
                raise
            reason = self._link.text("Message")
            raise RefusedError(f"cannot write {name}: {reason}", error.code) from error


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
