"""Plans: what follows from the parameters of the stimulator, for controllers and watchdogs.

`build_plans` builds them as they would be after a write, before the write is accepted: parameters
that contradict each other refuse it. The next cycle takes all of them at once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from smarttac_can.control.parameters import CascadeParameters
from smarttac_can.control.step import ControlPlan, control_plan
from smarttac_can.control.texture import Texture
from smarttac_can.control.tribometer import Forces
from smarttac_can.nodes.watches import WatchPlan, watch_plan
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.model import PlateModel
from smarttac_can.vocabulary.modes import LAWS
from smarttac_can.vocabulary.states import IdentificationState

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


UNTARED: Final[Forces] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""Zero of the gauges before there is one."""


class Plans(NamedTuple):
    """What controllers and watchdogs go by."""

    parameters: CascadeParameters
    model: PlateModel
    control: ControlPlan
    watch: WatchPlan


class Present(NamedTuple):
    """What plans are built from beside the object dictionary."""

    model: PlateModel
    """In force; another one than it is not identified."""
    zero: Forces
    """In force, for a plate that was never tared."""
    texture: Texture
    """What is to play."""
    deadline_ms: int
    """Of the loop over the bus; 3 with the plate inside."""


def build_plans(
    od: ObjectDictionary, present: Present, written: Entry | None = None, raw: Any = 0
) -> Plans:
    """Build the plans as they are after a write.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    present
        All else.
    written, raw
        An entry with the raw value that it is about to take; None for the object dictionary as it
        is.

    Raises
    ------
    Abort
        VALUE if the parameters contradict each other.
    """
    name = "" if written is None else written.name

    def value(of: str) -> Any:
        return raw if of == name else od[of].value

    def si(of: str) -> float:
        return float(value(of) * od[of].si)

    parameters = _parameters(value, si)
    model = _model(si)
    zeros = [si(f"{GAUGE_ZERO}.Zero of S{number}") for number in range(1, 7)]
    s1, s2, s3, s4, s5, s6 = zeros if any(zeros) else present.zero
    identified = value("Model.State") == IdentificationState.DONE and model == present.model
    return Plans(
        parameters,
        model,
        control_plan(parameters, model, (s1, s2, s3, s4, s5, s6), present.texture),
        watch_plan(parameters, si, identified=identified, deadline_ms=present.deadline_ms),
    )


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
    return _parameters(lambda name: od[name].value, lambda name: od[name].si_value)


def _parameters(value: Callable[[str], Any], si: _Quantity) -> CascadeParameters:
    fields: dict[str, Any] = {
        field: LAWS[name](value(name)) if name in LAWS else si(name)
        for name, field in _FIELDS.items()
    }
    x3, x4, x5, x6 = [si(f"Calibration.Position of S{number}") for number in range(3, 7)]
    try:
        return CascadeParameters(
            **fields,
            lateral=(
                (si("Calibration.Fx from S1"), si("Calibration.Fx from S2")),
                (si("Calibration.Fy from S1"), si("Calibration.Fy from S2")),
            ),
            gauge_positions=(x3, x4, x5, x6),
        )
    except ValueError as error:
        raise Abort(AbortCode.VALUE, str(error)) from error


def plate_model(od: ObjectDictionary) -> PlateModel:
    """Build the model of the plate that the object dictionary holds."""
    return _model(lambda name: od[name].si_value)


def _model(si: _Quantity) -> PlateModel:
    return PlateModel(
        gain=si("Model.Gain per volt"),
        tau=si("Model.Tau"),
        f0=si("Model.Resonance"),
        load=si("Model.Load"),
        temperature=si("Model.Temperature"),
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
