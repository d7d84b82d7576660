"""What a refused write says: the value, and the bounds that it is outside of, in their unit."""

from __future__ import annotations

from smarttac_can.master.errors import RefusedError
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.faults import FaultKind, value_range
from smarttac_can.vocabulary.objects import FAULT_KIND


def write_action(entry: Entry, raw: float) -> str:
    """Say what was asked of the device."""
    return f"write {_shown(entry, raw)} to {entry.name}"


def refused_write(entry: Entry, raw: float, reason: Abort) -> RefusedError:
    """Say that a device refused a raw value, and why."""
    text = f"cannot {write_action(entry, raw)}: {reason}"
    if not entry.low <= raw <= entry.high:
        text += f": {bounds(entry)}"
    elif entry.name == FAULT_KIND and reason.code == AbortCode.VALUE:
        kind = FaultKind(round(raw))
        low, high = value_range(kind)
        text += f": Fault.Value of {kind.name.lower()} is {low} to {high}"
    return RefusedError(text, reason.code)


def bounds(entry: Entry) -> str:
    """Return the bounds of an object in its displayed unit, such as ``0 to 3000 nm``."""
    return f"{_number(entry, entry.low)} to {_shown(entry, entry.high)}"


def _shown(entry: Entry, raw: float) -> str:
    return f"{_number(entry, raw)} {entry.unit.symbol}".rstrip()


def _number(entry: Entry, raw: float) -> str:
    return f"{raw * float(entry.unit.number):.12g}"
