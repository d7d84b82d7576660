"""Names of objects, words, modes and emergencies, for clients and for tools that display them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import IntEnum, IntFlag
from typing import Final

from smarttac_can.canopen.od.cia import Abort, EmergencyCode
from smarttac_can.canopen.od.entry import BitField, Entry
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.states import (
    STATE_SHIFT,
    Control,
    Law,
    Mode,
    State,
    Status,
    VibrationLaw,
)
from smarttac_can.vocabulary.watchdogs import WATCHDOGS


def spoken(member: IntEnum | IntFlag) -> str:
    """Return the name of an enumeration member in lower case with spaces."""
    return (member.name or "").lower().replace("_", " ")


def _names(members: Iterable[IntEnum]) -> dict[int, str]:
    return {int(member): spoken(member) for member in members}


def _flags(flags: Iterable[Status | Control]) -> tuple[BitField, ...]:
    return tuple(BitField(spoken(flag), flag.bit_length() - 1, 1, {}) for flag in flags)


Names = Mapping[str, tuple[BitField, ...]]
"""Fields of the objects of a device whose values have names, by the name of the object."""
FIELDS: Final[Names] = {
    "Statusword": (*_flags(Status), BitField("state", STATE_SHIFT, 3, _names(State))),
    "Controlword": _flags(Control),
    "Mode": (BitField("", 0, 8, _names(Mode)),),
    "Mode display": (BitField("", 0, 8, _names(Mode)),),
    "Friction law": (BitField("", 0, 8, _names(Law)),),
    "Controller.Vibration law": (BitField("", 0, 8, _names(VibrationLaw)),),
}
"""Objects of stimulator and plate whose values have names."""
EMERGENCIES: Final[Mapping[int, str]] = _names(EmergencyCode) | _names(FaultCode)
"""Names of the emergency error codes of stimulator and plate."""


def meaning(entry: Entry, raw: object, names: Names = FIELDS) -> str:
    """Return a value with its unit, a word as its bits, or a number with a name as that name.

    Parameters
    ----------
    names
        Objects of the device whose values have names; those of stimulator and plate by default. An
        object of another device may have the name of one of theirs.
    """
    if not isinstance(raw, int):
        return repr(raw)
    fields = names.get(entry.name, ())
    if fields:
        parts = []
        unnamed = raw
        for field in fields:
            mask = (1 << field.length) - 1
            bits = raw >> field.start & mask
            unnamed &= ~(mask << field.start)
            if field.values:
                parts.append(field.values.get(bits, str(bits)))
            elif bits:
                parts.append(field.name)
        if unnamed:
            parts.append(f"{unnamed:X}h")
        return "+".join(parts) or "0"
    return entry.shown(raw)


def meaning_of_bytes(entry: Entry | None, data: bytes, names: Names = FIELDS) -> str:
    """Return the meaning of a value on the wire, or its bytes if the entry cannot have it."""
    try:
        if entry is not None:
            return meaning(entry, entry.unpack(data[: entry.size or None]), names)
    except Abort:
        pass
    return data.hex(" ")


def emergency_text(code: int) -> str:
    """Return the meaning of an emergency error code of stimulator or plate."""
    for row in WATCHDOGS.values():
        if row.code == code:
            return row.text.partition(":")[0]
    if code == EmergencyCode.RESET:
        return "error reset or no error"
    return EMERGENCIES.get(code, "a code that is not known")


START_RUN: Final = "Simulation.Start run"
FAULT_KIND: Final = "Fault.Kind"
LIFTED, STROKE, RECORDED = range(3)
"""Values of ``Finger.Motion``."""
SIMULATION: Final = ("Simulation", "Finger", "Fault", "Weight")
"""Records that belong to the simulated plate."""
ZERO: Final = int.from_bytes(b"zero", "little")
"""Signature that is written to an auto-zero object."""
TARE: Final = "AI auto-zero"
"""Record of the auto-zero objects."""
AUTO_ZERO: Final = tuple(
    f"{TARE}.AI auto-zero {channel}" for channel in ("force x", "force y", "normal force")
)
"""Auto-zero objects, one for each channel that can be tared."""
NOT_TARED: Final = "not tared: "
"""Beginning of the Message when a tare is refused."""
UNSUPERVISED: Final = "not armed: the commander is not supervised: "
"""Beginning of the Message when arming is refused without supervision; what to do follows."""
