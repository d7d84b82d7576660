"""State, controlword and statusword of the stimulator."""

from __future__ import annotations

from enum import IntFlag
from typing import Final

from smarttac_can.vocabulary.named_number import NamedNumber


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
