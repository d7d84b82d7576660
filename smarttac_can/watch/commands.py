"""What a person may type at a watch that drives."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from smarttac_can.bench import Stimulator

HINT: Final = "mode NAME, cof C [C], amplitude UM, voltage V, frequency HZ, boundary MM, reset"
_SIDES: Final = 2


def obey(stimulator: Stimulator, text: str) -> str:
    """Do what a line asks for.

    Parameters
    ----------
    stimulator
        Connected.
    text
        Such as ``cof 0.3 0.4``.

    Returns
    -------
    str
        What was done.

    Raises
    ------
    ValueError
        If it is no such line.
    BenchError
        If the stimulator refuses, or does not answer.
    """
    name, *arguments = text.split() or [""]
    if name == "mode" and len(arguments) == 1:
        stimulator.mode = arguments[0]
    elif name == "reset" and not arguments:
        stimulator.reset_fault()
    elif name == "cof" and 1 <= len(arguments) <= _SIDES:
        values = [_number(argument) for argument in arguments]
        stimulator.cof = values if len(values) == _SIDES else values[0]
    elif name in _SET_POINTS and len(arguments) == 1:
        _SET_POINTS[name](stimulator, _number(arguments[0]))
    else:
        raise ValueError(f"{text!r} is none of: {HINT}")
    return f"done: {text.strip()}"


def _setter(name: str) -> Callable[[Stimulator, float], None]:
    return lambda stimulator, value: setattr(stimulator, name, value)


_SET_POINTS: Final[Mapping[str, Callable[[Stimulator, float], None]]] = {
    name: _setter(name) for name in ("amplitude", "voltage", "frequency", "boundary")
}


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{text!r} is not a number") from None
