"""What a stimulator published last, in a person's units."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan, nan
from typing import Final, Self

from smarttac_can.bench.errors import NotRunningError
from smarttac_can.bench.link import PUBLISHED, Snapshot
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import State, Status, state_in

_STATUS: Final = sum(Status)


@dataclass(frozen=True, slots=True, repr=False)
class Reading:
    """What the stimulator published last."""

    age: float
    """Age in s of the oldest value in it."""
    mode: Mode
    """Mode in force."""
    state: State
    """State of the device."""
    status: Status
    """Other bits of the statusword."""
    tangential_force: float
    """Tangential force in N."""
    normal_force: float
    """Normal force in N."""
    cof: float
    """Coefficient of friction; NaN while no finger touches."""
    amplitude: float
    """Vibration amplitude in um peak-to-peak."""
    voltage: float
    """Voltage in V."""
    frequency: float
    """Excitation frequency in Hz."""
    temperature: float
    """Plate temperature in degC."""
    position: float
    """Position of the finger in mm from the middle of the plate; NaN while it does not touch."""

    def __repr__(self) -> str:
        contact = "no contact"
        if not isnan(self.cof):
            contact = f"COF {self.cof:.4f} at {self.position:.2f} mm"
        return (
            f"<Reading of {self.age:.3f} s ago: {self.state}, mode {self.mode}, "
            f"status {self.status.name or 0}; {contact}, "
            f"Ft {self.tangential_force:.3f} N, Fn {self.normal_force:.3f} N, "
            f"{self.amplitude:.4f} um, {self.voltage:.2f} V, {self.frequency:.2f} Hz, "
            f"{self.temperature:.2f} degC>"
        )

    @classmethod
    def from_snapshot(cls, snapshot: Snapshot, od: ObjectDictionary) -> Self:
        """Convert raw values by the EDS of the stimulator.

        Raises
        ------
        NotRunningError
            If a value has not been published yet.
        """
        raw, age = snapshot
        for name in PUBLISHED:
            if name not in raw:
                raise NotRunningError(
                    f"{name!r} has not been published yet: run() first, or have its TPDO's event "
                    "timer, 0.1 s by default, send it"
                )

        def value(name: str, unit: str) -> float:
            return float(od[name].unit.times(raw[name], unit))

        return cls(
            age=age,
            mode=Mode(raw["Mode display"]),
            state=state_in(raw["Statusword"]),
            status=Status(raw["Statusword"] & _STATUS),
            tangential_force=value("Contact.Tangential force", "N"),
            normal_force=value("Contact.Normal force", "N"),
            cof=value("Contact.COF", "") or nan,
            amplitude=value("Vibration.Amplitude", "um"),
            voltage=value("Vibration.Voltage", "V"),
            frequency=value("Vibration.Frequency", "Hz"),
            temperature=value("Plate temperature", "degC"),
            position=value("Contact.Position", "mm") if raw["Contact.COF"] else nan,
        )
