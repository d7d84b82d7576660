"""What a refused write says: the value, and the bounds that it is outside of, in their unit."""

from __future__ import annotations

from smarttac_can.bench.errors import RefusedError
from smarttac_can.od.cia import Abort
from smarttac_can.od.dictionary import Entry


def write_action(entry: Entry, raw: float) -> str:
    """Say what was asked of the device."""
    return f"write {_shown(entry, raw)} to {entry.name}"


def refused_write(entry: Entry, raw: float, reason: Abort) -> RefusedError:
    """Say that a device refused a raw value, and why."""
    text = f"cannot {write_action(entry, raw)}: {reason}"
    if not entry.low <= raw <= entry.high:
        text += f": {_number(entry, entry.low)} to {_shown(entry, entry.high)}"
    return RefusedError(text)


def _shown(entry: Entry, raw: float) -> str:
    return f"{_number(entry, raw)} {entry.unit}".rstrip()


def _number(entry: Entry, raw: float) -> str:
    return f"{raw * entry.factor:.12g}"
