"""Modes, laws and states of the stimulator, its controlword and its statusword."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag
from typing import Final

_OF_NUMBERS: Final = tuple("bcdnoxXeEfFgG%")


class NamedNumber(IntEnum):
    """An IntEnum that prints its name: ``RUNNING`` and not ``3``."""

    def __str__(self) -> str:
        return self.name

    def __format__(self, spec: str) -> str:
        """Format the name, or the number for ``d`` and other numeric types."""
        return format(int(self) if spec.endswith(_OF_NUMBERS) else self.name, spec)


class Mode(NamedNumber):
    """Modes of the cascade."""

    OFF = 0
    """0 V at the frequency of the set-point."""
    OPEN_LOOP = 1
    """Voltage and frequency of the set-point."""
    AMPLITUDE = 2
    """Amplitude by voltage, at the frequency of the set-point."""
    AMPLITUDE_RESONANCE = 3
    """Amplitude by voltage, and the resonance tracked by frequency."""
    FRICTION = 4
    """COF by amplitude, with both loops of AMPLITUDE_RESONANCE."""
    IDENTIFY = 5
    """Identification of the unloaded plate; changes to OFF at its end."""
    TEXTURE = 6
    """COF by amplitude as in FRICTION, with a reference from a table."""


class Law(NamedNumber):
    """Laws by which the amplitude follows the COF; the paper leaves open to what dW is added."""

    MEASURED = 0
    """``W_ref = |W| + dW``: integral action through the inner loop."""
    ACCUMULATE = 1
    """``W_ref += dW``: integral action before the inner loop; less margin than MEASURED."""
    NOMINAL = 2
    """``W_ref = W_nominal + dW``: proportional action; it leaves a static error."""
    PREDICTIVE = 3
    """``W_ref`` from the friction map of the finger, learned during the run; without dW."""


class VibrationLaw(NamedNumber):
    """Laws of the amplitude and resonance loops."""

    PI = 0
    """Two PIs designed for the bare plate, as in the paper. In mode TEXTURE the PI of the amplitude
    is that of `SCHEDULED`."""
    SCHEDULED = 1
    """The same two PIs, designed for the plate under the present finger."""
    PREDICTIVE = 2
    """One-step prediction with a plate model that is updated each tick, with its dead time."""


LAWS: Final[Mapping[str, type[Law] | type[VibrationLaw]]] = {
    "Friction law": Law,
    "Controller.Vibration law": VibrationLaw,
}
"""Objects that choose a law, and the available laws."""


class State(NamedNumber):
    """States of the device; bits 8 to 10 of the statusword hold the number."""

    NOT_READY = 0
    """A condition is not met: measurements, a zero, a calibration, or NMT OPERATIONAL."""
    READY = 1
    """All conditions are met; at 0 V."""
    ARMED = 2
    """Faults trip; still at 0 V."""
    RUNNING = 3
    """The mode is active: the only state with a voltage."""
    QUICK_STOP = 4
    """At 0 V until the quick stop bit of the controlword is cleared."""
    FAULT = 5
    """At 0 V until the fault is gone and was reset."""


class Control(IntFlag):
    """Bits of the controlword."""

    ARM = 1 << 0
    RUN = 1 << 1
    QUICK_STOP = 1 << 2
    FAULT_RESET = 1 << 7


CONTROL_MASK: Final = int(Control.ARM | Control.RUN | Control.QUICK_STOP | Control.FAULT_RESET)
"""Bits that a controlword may contain."""


class IdentificationState(NamedNumber):
    """Progress of an identification."""

    IDLE = 0
    RUNNING = 1
    DONE = 2
    FAILED = 3


class Status(IntFlag):
    """Bits of the statusword."""

    LIVE = 1 << 0
    """The loop has cycles: the values that are read are those of the present cycle."""
    DRIVING = 1 << 1
    """The voltage is above 0."""
    TOUCHING = 1 << 2
    """A finger touches."""
    LIMITED = 1 << 3
    """A limit of voltage, amplitude or frequency reduces the output of the controllers."""
    SATURATED = 1 << 4
    """A sensor is at the end of its range."""
    FAULT = 1 << 5
    """A fault is latched."""


STATE_SHIFT: Final = 8
"""Lowest of the bits 8 to 10 of the statusword, which hold the number of the state."""
_STATE_BITS: Final = 0b111


def state_in(statusword: int) -> State:
    """Return the state in a statusword.

    Raises
    ------
    ValueError
        There is no state with its number, so it is not a statusword of a stimulator.
    """
    return State(statusword >> STATE_SHIFT & _STATE_BITS)


def known_state(statusword: int) -> State | None:
    """Return the state in a statusword; None if there is no such state."""
    try:
        return state_in(statusword)
    except ValueError:
        return None
