"""Modes, laws and states of the stimulator, its controlword and its statusword."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag
from typing import Final

_OF_NUMBERS: Final = tuple("bcdnoxXeEfFgG%")


class NamedNumber(IntEnum):
    """An IntEnum that a person who prints it can read: ``RUNNING`` and not ``3``."""

    def __str__(self) -> str:
        return self.name

    def __format__(self, spec: str) -> str:
        """Format the name, or by ``d`` and the like the number."""
        return format(int(self) if spec.endswith(_OF_NUMBERS) else self.name, spec)


class Mode(NamedNumber):
    """What the cascade controls."""

    OFF = 0
    """0 V at the frequency of the set-point."""
    OPEN_LOOP = 1
    """Voltage and frequency of the set-point."""
    AMPLITUDE = 2
    """Amplitude by voltage, at the frequency of the set-point."""
    AMPLITUDE_RESONANCE = 3
    """Amplitude by voltage, and the resonance tracked by frequency."""
    FRICTION = 4
    """COF by amplitude, over both loops of the mode before."""
    IDENTIFY = 5
    """Identification of the unloaded plate; ends by itself in OFF."""
    TEXTURE = 6
    """COF by amplitude as in FRICTION; its reference is played from a table."""


class Law(NamedNumber):
    """How the amplitude follows the COF; to what the step dW is added the paper leaves open."""

    MEASURED = 0
    """``W_ref = |W| + dW``: integral action through the inner loop."""
    ACCUMULATE = 1
    """``W_ref += dW``: integral action before the inner loop; less margin than the above."""
    NOMINAL = 2
    """``W_ref = W_nominal + dW``: proportional action; it leaves a static error."""
    PREDICTIVE = 3
    """``W_ref`` by the friction map of the finger, which is learned on the way; without dW."""


class VibrationLaw(NamedNumber):
    """How amplitude and resonance are regulated."""

    PI = 0
    """Two PIs designed for the bare plate, as in the paper; in mode TEXTURE that of the
    amplitude as `SCHEDULED`."""
    SCHEDULED = 1
    """The same two, designed for the plate under the finger that presses now."""
    PREDICTIVE = 2
    """One step of a plate that is learned from tick to tick, through its dead time."""


LAWS: Final[Mapping[str, type[Law] | type[VibrationLaw]]] = {
    "Friction law": Law,
    "Controller.Vibration law": VibrationLaw,
}
"""Objects that choose a law, and what there is."""


class State(NamedNumber):
    """States of the device; the statusword carries the number in bits 8 to 10."""

    NOT_READY = 0
    """Something is missing: measurements, a zero, a calibration, or NMT OPERATIONAL."""
    READY = 1
    """All is there; at 0 V."""
    ARMED = 2
    """A fault trips; still at 0 V."""
    RUNNING = 3
    """The mode drives: the only state with a voltage."""
    QUICK_STOP = 4
    """At 0 V until the controlword lets go."""
    FAULT = 5
    """At 0 V until the fault is gone and reset."""


class Control(IntFlag):
    """Bits of the controlword."""

    ARM = 1 << 0
    RUN = 1 << 1
    QUICK_STOP = 1 << 2
    FAULT_RESET = 1 << 7


CONTROL_MASK: Final = int(Control.ARM | Control.RUN | Control.QUICK_STOP | Control.FAULT_RESET)
"""Bits that a controlword may have."""


class IdentificationState(NamedNumber):
    """How far an identification is."""

    IDLE = 0
    RUNNING = 1
    DONE = 2
    FAILED = 3


class Status(IntFlag):
    """Bits of the statusword."""

    LIVE = 1 << 0
    """The loop has its cycles: what is read back is that of now, not of the last one there was."""
    DRIVING = 1 << 1
    """The voltage is above 0."""
    TOUCHING = 1 << 2
    """A finger touches."""
    LIMITED = 1 << 3
    """A limit of voltage, amplitude or frequency cuts off what the controllers ask for."""
    SATURATED = 1 << 4
    """A sensor is at the end of its range."""
    FAULT = 1 << 5
    """A fault is latched."""


STATE_SHIFT: Final = 8
"""Bits 8 to 10 of the statusword are the number of the state."""
_STATE_BITS: Final = 0b111


def state_in(statusword: int) -> State:
    """Return the state that a statusword carries.

    Raises
    ------
    ValueError
        If there is no state of its number: a statusword of something else.
    """
    return State(statusword >> STATE_SHIFT & _STATE_BITS)


def known_state(statusword: int) -> State | None:
    """Return the state that a statusword carries; None if there is no such state."""
    try:
        return state_in(statusword)
    except ValueError:
        return None
