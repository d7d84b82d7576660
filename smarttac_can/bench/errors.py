"""Errors of a stimulator that answers; their messages say what to do."""

from __future__ import annotations

from decimal import Decimal
from typing import Final

from smarttac_can.bench.given import Given, outside
from smarttac_can.bench.traces import Trace
from smarttac_can.canopen.master.errors import BenchError, RefusedError
from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.canopen.od.units import EXACT, Quantity
from smarttac_can.vocabulary.faults import FaultKind, last_sensor, value_range
from smarttac_can.vocabulary.meanings import FAULT_KIND

_SHELL_WORDS: Final = {
    "; .trace holds the recording": "",
    ": run() first, or set": ": set",
    "reset_fault()": "run smarttac reset",
    "disarm() first": "first 'mode off' in smarttac watch --drive, or its Esc",
    "then tare()": "then restart the node, which tares",
    "connect without lockstep=True": "leave out --lockstep here",
    "connect with lockstep=True": "give --lockstep here",
}
"""Calls that messages of the bench suggest, and what a person at a shell does instead."""
_OF_A_SCRIPT: Final = ".trace "
"""Beginning of notes that are only for scripts."""


class NotRunningError(BenchError):
    """The control loop gives no cycles to record."""


class BusyError(BenchError):
    """Another thread is running the loop of this stimulator; this call has changed nothing."""


class NotReadyError(BenchError):
    """A condition for arming the stimulator is not met."""


class FaultError(BenchError):
    """A watchdog has tripped, and the fault is latched.

    Attributes
    ----------
    trace
        Trace of the run that the fault ended, or None.
    """

    def __init__(self, text: str, trace: Trace | None = None) -> None:
        super().__init__(text)
        self.trace = trace


class RunInterruptedError(BenchError, KeyboardInterrupt):
    """Ctrl-C has ended a run; it ends a script that catches neither `BenchError` nor Ctrl-C.

    Attributes
    ----------
    trace
        Trace of the run until then; None if nothing was recorded.
    """


def in_shell_words(text: object) -> str:
    """Return a message of the bench with shell commands instead of calls.

    Returns
    -------
    str
        Empty if the message is only for scripts.
    """
    message = str(text)
    if message.startswith(_OF_A_SCRIPT):
        return ""
    for call, words in _SHELL_WORDS.items():
        message = message.replace(call, words)
    return message


def write_action(entry: Entry, raw: float | bytes) -> str:
    """Return the text for writing a raw value, or bytes, to an object."""
    return f"write {'' if isinstance(raw, bytes) else f'{entry.shown(raw)} to '}{entry.name}"


def refused_write(
    entry: Entry, raw: float | bytes, reason: Abort, value: Given | None = None
) -> RefusedError:
    """Return the error of a device that has refused a value, in the words of who gave it.

    Parameters
    ----------
    entry
        Object of the device.
    raw
        Raw value, or bytes.
    reason
        Abort code of the device.
    value
        The value as it was given; None to name the object and its displayed unit.
    """
    if isinstance(raw, bytes):
        return RefusedError(f"cannot {write_action(entry, raw)}: {reason}", reason.code)
    if value is None:
        number = EXACT.multiply(Decimal(str(raw)), entry.unit.number)
        value = Given(entry.name, Quantity(number, entry.unit.symbol))
    name, (number, symbol) = value
    if not entry.low <= raw <= entry.high:
        low, high = (entry.unit.times(bound, symbol) for bound in (entry.low, entry.high))
        of = "" if name == entry.name else f"{entry.name}: "
        return RefusedError(
            f"{outside(name, float(number), low, high, symbol)} ({of}{reason})", reason.code
        )
    text = f"cannot write {value} to {entry.name}: {reason}"
    if entry.name == FAULT_KIND and reason.code == AbortCode.VALUE:
        kind = FaultKind(round(raw))
        low, high = value_range(kind)
        most = last_sensor(kind)
        text += f": {kind.name.lower()} is for a Fault.Sensor of 1 to {most}"
        text += f" and a Fault.Value of {low} to {high}"
    return RefusedError(text, reason.code)
