"""Set-points of a stimulator, in a person's units."""

from __future__ import annotations

from collections.abc import Sequence

from smarttac_can.bench.named_objects import NamedObjects
from smarttac_can.control.cascade import Mode
from smarttac_can.control.friction import Law


class SetPoints(NamedObjects):
    """Friction law and set-points of a stimulator over a link."""

    __slots__ = ()

    @property
    def law(self) -> Law:
        """Friction law."""
        return Law(self._link.read("Friction law"))

    @law.setter
    def law(self, law: Law | str) -> None:
        self._link.write("Friction law", by_name(Law, law))

    @property
    def voltage(self) -> float:
        """Set-point of mode OPEN_LOOP in V."""
        return self.get("Setpoint.Voltage") * 1e-3

    @voltage.setter
    def voltage(self, volts: float) -> None:
        self.set("Setpoint.Voltage", volts * 1e3)

    @property
    def frequency(self) -> float:
        """Excitation frequency in Hz: fixed, or where the resonance loop starts from."""
        return self.get("Setpoint.Frequency")

    @frequency.setter
    def frequency(self, hertz: float) -> None:
        self.set("Setpoint.Frequency", hertz)

    @property
    def amplitude(self) -> float:
        """Set-point of the amplitude in um peak-to-peak."""
        return self.get("Setpoint.Amplitude") * 1e-3

    @amplitude.setter
    def amplitude(self, micrometres: float) -> None:
        self.set("Setpoint.Amplitude", micrometres * 1e3)

    @property
    def cof(self) -> tuple[float, float]:
        """Set-points of the COF left and right of the boundary; a number sets both."""
        return self.get("Setpoint.COF left"), self.get("Setpoint.COF right")

    @cof.setter
    def cof(self, cof: float | Sequence[float]) -> None:
        left, right = cof if isinstance(cof, Sequence) else (cof, cof)
        self.set("Setpoint.COF left", left)
        self.set("Setpoint.COF right", right)

    @property
    def boundary(self) -> float:
        """Position of the boundary in mm from the middle of the plate."""
        return self.get("Setpoint.Boundary") * 1e-3

    @boundary.setter
    def boundary(self, millimetres: float) -> None:
        self.set("Setpoint.Boundary", millimetres * 1e3)


def by_name(choices: type[Mode] | type[Law], choice: int | str) -> int:
    """Number of a choice that a person may have given by its name.

    Raises
    ------
    ValueError
        If there is no such choice.
    """
    if not isinstance(choice, str):
        return int(choices(choice))
    name = choice.upper().replace("-", "_").replace(" ", "_").replace("+", "_")
    if name not in choices.__members__:
        known = ", ".join(member.lower() for member in choices.__members__)
        raise ValueError(f"{choices.__name__.lower()} {choice!r} is none of {known}")
    return int(choices[name])
