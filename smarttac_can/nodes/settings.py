"""What the object dictionary of the stimulator tells the controllers, in SI units."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from smarttac_can.control.friction import Law
from smarttac_can.control.model import PlateModel
from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.tribometer import Matrix
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import Entry, ObjectDictionary

CALIBRATION: Final = "Calibration"
DESIGN: Final = ("Friction law", "Controller", "Limit", CALIBRATION)
"""Names of the records that hold the parameters of the cascade."""


def mend_settings(od: ObjectDictionary) -> bool:
    """Put the parameters of the cascade back to their defaults if they contradict each other.

    Returns
    -------
    bool
        Whether they did.
    """
    try:
        cascade_parameters(od)
    except Abort:
        for entry in od:
            if entry.name.partition(".")[0] in DESIGN:
                entry.value = entry.default
        return True
    return False


def cascade_parameters(
    od: ObjectDictionary, changed: tuple[Entry, int] | None = None
) -> CascadeParameters:
    """Build the parameters of the cascade.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    changed
        An entry with the raw value it is about to take.

    Raises
    ------
    Abort
        VALUE if the parameters contradict each other.
    """

    def si(name: str) -> float:
        entry = od[name]
        raw = changed[1] if changed is not None and changed[0] is entry else entry.value
        return float(raw * entry.si)

    x3, x4, x5, x6 = [si(f"Calibration.Position of S{number}") for number in range(3, 7)]
    try:
        return CascadeParameters(
            amplitude_pole=si("Controller.Amplitude pole"),
            resonance_pole=si("Controller.Resonance pole"),
            law=Law(int(si("Friction law"))),
            slope=si("Controller.Friction slope per percent"),
            step_max=si("Controller.Friction step limit"),
            contact_force=si("Controller.Contact force"),
            hysteresis=si("Controller.Boundary hysteresis"),
            dead_time=si("Controller.Dead time"),
            V_max=si("Limit.Voltage"),
            W_max=si("Limit.Amplitude"),
            f_min=si("Limit.Lowest frequency"),
            f_max=si("Limit.Highest frequency"),
            lateral=_lateral(si),
            gauge_positions=(x3, x4, x5, x6),
        )
    except ValueError as error:
        raise Abort(AbortCode.VALUE) from error


def lateral_calibration(od: ObjectDictionary) -> Matrix:
    """Return the calibration of the lateral gauges that the object dictionary holds."""
    return _lateral(lambda name: od[name].si_value)


def _lateral(si: Callable[[str], float]) -> Matrix:
    return (
        (si("Calibration.Fx from S1"), si("Calibration.Fx from S2")),
        (si("Calibration.Fy from S1"), si("Calibration.Fy from S2")),
    )


def plate_model(od: ObjectDictionary) -> PlateModel:
    """Build the model of the plate that the object dictionary holds."""
    return PlateModel(
        gain=od["Model.Gain per volt"].si_value,
        tau=od["Model.Tau"].si_value,
        f0=od["Model.Resonance"].si_value,
    )


def keep_model(od: ObjectDictionary, model: PlateModel) -> PlateModel:
    """Write a model to the object dictionary, and return it rounded as it stands there."""
    for name, value in (("Gain per volt", model.gain), ("Tau", model.tau), ("Resonance", model.f0)):
        entry = od[f"Model.{name}"]
        entry.value = entry.quantise(value)
    return plate_model(od)
