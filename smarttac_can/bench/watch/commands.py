"""What a person types as a line for a stimulator, and what does it, for all screens."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

from smarttac_can.bench import BenchError, Stimulator
from smarttac_can.bench.watch.listener import Listener
from smarttac_can.bench.watch.watcher import Watcher

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
    "arm": "arm",
    "tare": "tare",
    "identify": "identify",
}
HINT: Final = ", ".join(_USAGES.values())
_STEPS: Final[Mapping[str, Callable[[Stimulator], object]]] = {
    "reset": Stimulator.reset_fault,
    "arm": Stimulator.arm,
    "tare": Stimulator.tare,
    "identify": Stimulator.identify,
}
"""Steps without an argument."""
_SPOKEN: Final = {
    "cof": "COF",
    "law": "friction law",
    "vibration": "vibration law",
    "slot": "texture",
    "reset": "fault reset",
    "arm": "armed at 0 V",
    "tare": "tared",
    "identify": "identified",
}
_UNITS: Final = {"amplitude": "um", "voltage": "V", "frequency": "Hz", "boundary": "mm"}
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
        Report of what was done, in words.

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
    elif name in _STEPS and not arguments:
        _STEPS[name](stimulator)
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
    return f"done: {in_words(text)}"


def in_words(text: str) -> str:
    """Return a command as a person says it: ``COF right 0.2`` for ``cof - 0.2``."""
    name, *arguments = text.split()
    if name == "cof" and len(arguments) == _SIDES and _STAYS in arguments:
        side = arguments.index(_STAYS)
        return f"COF {('right', 'left')[side]} {arguments[1 - side]}"
    unit = _UNITS.get(name, "") if len(arguments) == 1 else ""
    spoken = _SPOKEN.get(name, name)
    return " ".join([spoken, *arguments, *([unit] if unit else [])]).replace("_", " ")


def _given(text: str) -> float | str:
    """Return a number, or a text with a unit for a set-point of the bench."""
    try:
        return float(text)
    except ValueError:
        return text


def answered(do: Callable[[], str], words: Callable[[object], str] = str) -> str:
    """Call a function; return its result, or the words for its error, as printable text.

    The Message of a device may contain control characters for a terminal.
    """
    try:
        answer = do()
    except (BenchError, ValueError) as error:
        answer = words(error)
    return "".join(c if c.isprintable() else "?" for c in answer)


class Operator:
    """Keeps a watcher up to date with its bus, and does the commands of a person one by one.

    A thread of its own waits for the answers of the stimulator.

    Parameters
    ----------
    watcher
        Watcher of the stimulator.
    listener
        Running listener that supplies the frames, and sends those of the watcher.
    """

    def __init__(self, watcher: Watcher, listener: Listener) -> None:
        self._watcher, self._listener = watcher, listener
        self._worker = ThreadPoolExecutor(1, "drive")
        self._doing: Future[str] | None = None

    @property
    def busy(self) -> bool:
        """Whether a command is in progress."""
        return self._doing is not None

    def begin(self, command: Callable[[], str]) -> None:
        """Begin a command, which returns its result as text."""
        self._doing = self._worker.submit(command)

    def step(self, now: float) -> str | None:
        """Exchange frames with the bus at a time in s; return the result of a command that ended.

        A command in progress must not arm after a stop: until it has ended, the stop is repeated.
        """
        watcher, result = self._watcher, None
        watcher.lost = self._listener.lost
        for at, frame in self._listener.heard():
            watcher.receive(at, frame)
        if self._doing is not None and watcher.stopping:
            watcher.stop()
        if self._doing is not None and self._doing.done():
            result, self._doing = self._doing.result(), None
        for frame in watcher.advance(now):
            self._listener.send(frame)
        return result

    def end(self) -> None:
        """Wait for the end of the command in progress."""
        self._worker.shutdown()
