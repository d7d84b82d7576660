"""What the values of a stimulator mean for a person: limits in the way, and an identification."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final

from smarttac_can.vocabulary.states import IdentificationState, Mode

_AT: Final = 0.999
"""Share of a limit from which a value is at it, as it is published in steps."""
_NEAR: Final = 0.95
"""The same for the amplitude, which has the noise of the pick-up."""
_JUDGED: Final = frozenset(("Vibration.Amplitude", "Vibration.Voltage", "Vibration.Frequency"))
"""Values that may be at a limit."""
_REFUSED: Final = "identification: "
"""Beginning of the Message after an identification that has failed."""


def limits_in_the_way(
    values: Mapping[str, float], mode: str, older: Collection[str]
) -> dict[str, str]:
    """Return what is known of the limits that reduce the output, by the object that it is about.

    Parameters
    ----------
    values
        Values of a `View` whose flags have LIMITED.
    mode
        Mode of the view.
    older
        Names of the values that are older than LIMITED, which say nothing of it.
    """
    values = {name: value for name, value in values.items() if name not in older}
    found = {}
    most_v = values.get("Limit.Voltage")
    if most_v is not None and values.get("Vibration.Voltage", 0.0) >= _AT * most_v:
        found["Vibration.Voltage"] = f"at its limit of {most_v:g} V"
    for bound in ("Lowest", "Highest"):
        limit = values.get(f"Limit.{bound} frequency")
        if limit is not None and values.get("Vibration.Frequency") == limit:
            found["Vibration.Frequency"] = f"at its {bound.lower()}, {limit:g} Hz"
    if found:
        return found
    most_w = values.get("Limit.Amplitude", 0.0)
    if mode == Mode.OPEN_LOOP.name.lower().replace("_", " "):
        bare_nm = values.get("Model.Gain per volt", 0.0) * values.get("Setpoint.Voltage", 0.0)
        if bare_nm > most_w * 1e3 > 0.0:
            return {"Vibration.Voltage": f"cut: a bare plate would exceed {most_w:g} um"}
    elif values.get("Vibration.Amplitude", 0.0) >= _NEAR * most_w > 0.0:
        return {"Vibration.Amplitude": f"at its limit of {most_w:g} um"}
    if not _JUDGED.isdisjoint(older):
        return {}
    # The device reports no cause: it may be the drive's bound or a step of the frequency, too.
    return {"Vibration.Voltage": "output limited"}


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
