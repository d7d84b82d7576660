"""What the values of a stimulator mean for a person: limits in the way, and an identification."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from smarttac_can.vocabulary.states import IdentificationState, Mode

_AT: Final = 0.999
"""Share of a limit from which a value is at it, as it is published in steps."""
_NEAR: Final = 0.95
"""The same for the amplitude, which has the noise of the pick-up."""
_REFUSED: Final = "identification: "
"""Beginning of the Message after an identification that has failed."""


def limits_in_the_way(values: Mapping[str, float], mode: str) -> dict[str, str]:
    """Return the limits that reduce the output, in words, by the object that each one acts on.

    Parameters
    ----------
    values
        Values of a `View` whose flags have LIMITED.
    mode
        Mode of the view.
    """
    voltage, frequency = values.get("Vibration.Voltage", 0.0), values.get("Vibration.Frequency")
    found = {}
    most_v = values.get("Limit.Voltage")
    if most_v is not None and voltage >= _AT * most_v:
        found["Vibration.Voltage"] = f"at its limit of {most_v:g} V"
    for bound in ("Lowest", "Highest"):
        limit = values.get(f"Limit.{bound} frequency")
        if limit is not None and frequency == limit:
            found["Vibration.Frequency"] = f"at its {bound.lower()}, {limit:g} Hz"
    if found:
        return found
    most_w = values.get("Limit.Amplitude", 0.0)
    if mode == Mode.OPEN_LOOP.name.lower().replace("_", " "):
        return {"Vibration.Voltage": f"cut: a bare plate would exceed {most_w:g} um"}
    if values.get("Vibration.Amplitude", 0.0) >= _NEAR * most_w > 0.0:
        return {"Vibration.Amplitude": f"at its limit of {most_w:g} um"}
    bound_w = values.get("Limit.Amplitude by drive")
    to = "" if bound_w is None else f" to {bound_w:g} um"
    return {"Vibration.Voltage": f"cut{to} by the drive's bound"}


def identification(values: Mapping[str, float], message: str | None) -> str:
    """Return how the last identification has ended; empty before the first.

    Parameters
    ----------
    values
        Values of a `View`.
    message
        Message of the device: why it was refused, or a remark; None if it is not known.
    """
    state = values.get("Model.State")
    if state == IdentificationState.RUNNING:
        return f"identification: {values.get('Model.Progress', 0.0):.0f} %"
    if state == IdentificationState.FAILED:
        return f"identification refused: {(message or 'it was stopped').removeprefix(_REFUSED)}"
    if state != IdentificationState.DONE:
        return ""
    remark = f"; {message}" if message else ""
    return (
        f"identified: gain {values['Model.Gain per volt']:.2f} nm/V, "
        f"tau {values['Model.Tau']:.1f} us, f0 {values['Model.Resonance']:.1f} Hz, "
        f"softening {values['Model.Softening'] / 1e3:.2f} Hz/um, "
        f"dead time {values['Controller.Dead time']:.0f} us{remark}"
    )
