"""Commands for a stimulator that a person types as a line, for all user interfaces."""

from __future__ import annotations

from typing import Final

from smarttac_can.bench import Stimulator

_SET_POINTS: Final = {
    "amplitude": "amplitude UM",
    "voltage": "voltage V",
    "frequency": "frequency HZ",
    "boundary": "boundary MM",
}
_USAGES: Final = {
    "mode": "mode NAME",
    "cof": "cof C [C]",
    **_SET_POINTS,
    "law": "law NAME",
    "vibration": "vibration NAME",
    "slot": "slot N",
    "reset": "reset",
}
HINT: Final = ", ".join(_USAGES.values())
_SIDES: Final = 2
_STAYS: Final = "-"
"""Stands in a command for the COF of a side that does not change."""


def obey(stimulator: Stimulator, text: str) -> str:
    """Execute a command.

    Parameters
    ----------
    stimulator
        Connected stimulator.
    text
        Command, such as ``cof 0.3 0.4``, ``cof - 0.4`` or ``boundary 5000 um``.

    Returns
    -------
    str
        Report of what was done.

    Raises
    ------
    ValueError
        If the command is invalid.
    BenchError
        If the stimulator refuses, or does not answer.
    """
    name, *arguments = text.split() or [""]
    if name == "mode" and len(arguments) == 1:
        stimulator.mode = arguments[0]
    elif name == "law" and len(arguments) == 1:
        stimulator.law = arguments[0]
    elif name == "vibration" and len(arguments) == 1:
        stimulator.vibration_law = arguments[0]
    elif name == "slot" and len(arguments) == 1 and arguments[0].isdecimal():
        stimulator.texture_slot = int(arguments[0])
    elif name == "reset" and not arguments:
        stimulator.reset_fault()
    elif name == "cof" and 1 <= len(arguments) <= _SIDES:
        present = stimulator.cof if _STAYS in arguments else (0.0, 0.0)
        values = [
            side if argument == _STAYS else _given(argument)
            for argument, side in zip(arguments, present, strict=False)
        ]
        stimulator.cof = values if len(values) == _SIDES else values[0]
    elif name in _SET_POINTS and arguments:
        setattr(stimulator, name, _given(" ".join(arguments)))
    elif name in _USAGES:
        raise ValueError(f"{text.strip()!r} is not of the form: {_USAGES[name]}")
    else:
        raise ValueError(f"{text!r} is none of: {HINT}")
    return f"done: {text.strip()}"


def _given(text: str) -> float | str:
    """Return a number, or a text with a unit for a set-point of the bench."""
    try:
        return float(text)
    except ValueError:
        return text
