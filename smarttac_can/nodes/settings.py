"""What the object dictionary of the stimulator tells the controllers, in SI units."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Final

from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.tribometer import Matrix
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.modes import Law, VibrationLaw

CALIBRATION: Final = "Calibration"
MODEL: Final = "Model"
LIMIT: Final = "Limit"
GAUGE_ZERO: Final = "Gauge zero"
TEXTURE: Final = "Texture"
DESIGN: Final = ("Friction law", "Controller", LIMIT, CALIBRATION, TEXTURE)
"""Names of the records that hold the parameters of the cascade."""


_FIELDS: Final = {
    "Controller.Vibration law": "vibration_law",
    "Controller.Amplitude pole": "amplitude_pole",
    "Controller.Resonance pole": "resonance_pole",
    "Friction law": "law",
    "Controller.Friction slope per percent": "slope",
    "Controller.Friction step limit": "step_max",
    "Controller.Contact force": "contact_force",
    "Controller.Boundary hysteresis": "hysteresis",
    "Controller.Dead time": "dead_time",
    "Model.Data sheet gain per volt": "sheet_gain",
    "Model.Data sheet tau": "sheet_tau",
    "Model.Data sheet tolerance": "sheet_tolerance",
    "Texture.Preview": "preview",
    "Limit.Voltage": "V_max",
    "Limit.Amplitude": "W_max",
    "Limit.Lowest frequency": "f_min",
    "Limit.Highest frequency": "f_max",
}
"""Objects that are a parameter each; those of the calibration make up two together."""
LAWS: Final[Mapping[str, type[Law] | type[VibrationLaw]]] = {
    "Friction law": Law,
    "Controller.Vibration law": VibrationLaw,
}
"""Objects that choose a law, and what there is."""
_Quantity = Callable[[str], float]
"""Value of an object in SI units by its name."""


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


def cascade_parameters(od: ObjectDictionary) -> CascadeParameters:
    """Build the parameters of the cascade.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.

    Raises
    ------
    Abort
        VALUE if the parameters contradict each other.
    """
    fields = {field: _parameter(od[name], od[name].value) for name, field in _FIELDS.items()}
    calibration = _calibration(lambda name: od[name].si_value)
    try:
        return CascadeParameters(**fields, **calibration)
    except ValueError as error:
        raise Abort(AbortCode.VALUE, str(error)) from error


def with_change(
    parameters: CascadeParameters, od: ObjectDictionary, changed: Entry, raw: Any
) -> CascadeParameters:
    """Return the parameters with what depends on one object replaced.

    They are the same if none does: some limits are the watchdogs' alone.

    Parameters
    ----------
    parameters
        What the objects say so far.
    od
        Object dictionary of ``stimulator.eds``.
    changed, raw
        An entry with the raw value it is about to take.

    Raises
    ------
    Abort
        VALUE if the parameters would contradict each other.
    """
    if changed.name in _FIELDS:
        fields = {_FIELDS[changed.name]: _parameter(changed, raw)}
    elif changed.name.partition(".")[0] == CALIBRATION:
        fields = _calibration(
            lambda name: float(raw * changed.si) if name == changed.name else od[name].si_value
        )
    else:
        return parameters
    try:
        return replace(parameters, **fields)
    except ValueError as error:
        raise Abort(AbortCode.VALUE, str(error)) from error


def _parameter(entry: Entry, raw: int) -> Any:
    law = LAWS.get(entry.name)
    return float(raw * entry.si) if law is None else law(raw)


def _calibration(si: _Quantity) -> dict[str, Any]:
    positions = tuple([si(f"Calibration.Position of S{number}") for number in range(3, 7)])
    return {"lateral": _lateral(si), "gauge_positions": positions}


def lateral_calibration(od: ObjectDictionary) -> Matrix:
    """Return the calibration of the lateral gauges that the object dictionary holds."""
    return _lateral(lambda name: od[name].si_value)


def _lateral(si: _Quantity) -> Matrix:
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
        load=od["Model.Load"].si_value,
        temperature=od["Model.Temperature"].si_value,
    )


def keep_model(od: ObjectDictionary, model: PlateModel) -> None:
    """Write a model to the object dictionary, rounded as it stands there."""
    for name, value in (
        ("Gain per volt", model.gain),
        ("Tau", model.tau),
        ("Resonance", model.f0),
        ("Load", model.load),
        ("Temperature", model.temperature),
    ):
        entry = od[f"Model.{name}"]
        entry.value = entry.quantise(value)
