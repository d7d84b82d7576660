"""What the stimulator publishes of a cycle in its object dictionary."""

from __future__ import annotations

from enum import IntFlag
from typing import Final

from smarttac_can.control.cascade import Cascade
from smarttac_can.nodes.analogue_input import AnalogueInput
from smarttac_can.nodes.cycle_input import Measured
from smarttac_can.nodes.state_machine import State
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.scaling import Quantiser

_VIBRATION: Final = ("W_d", "W_q", "Amplitude", "Amplitude reference", "Frequency", "Voltage")
_CONTACT: Final = (
    "Tangential force",
    "Normal force",
    "COF",
    "COF uncertainty",
    "COF reference",
    "Friction error",
    "Position",
    "Speed",
    "Force x",
    "Force y",
)
_TICK_MASK: Final = 0xFFFF


class Status(IntFlag):
    """Bits of the statusword."""

    LIVE = 1 << 0
    """The loop has had a cycle since the start of the run."""
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
_LOOP_BITS: Final = 0b11111


class ReadBack:
    """The read-only objects that follow the loop.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._published = [
            *(od[f"Vibration.{name}"] for name in _VIBRATION),
            *(od[f"Contact.{name}"] for name in _CONTACT),
            od["Plate temperature"],
        ]
        self._quantiser = Quantiser(self._published)
        self._touching = od["Contact.Touching"]
        self._mode = od["Mode display"]
        self._voltage = od["Vibration.Voltage"]
        self._statusword = od["Statusword"]
        self._tick = od["Contact.Tick"]
        self._cycles = od["Cycle.Cycles"]
        self._analogue_input = AnalogueInput(od)
        self.reset()

    def reset(self) -> None:
        """Forget the run: tick 0 next, nothing measured."""
        for entry in (*self._published, self._touching, self._mode):
            entry.value = entry.default
        self._statusword.value &= ~_LOOP_BITS
        self._cycles.value = 0
        self._tick.value = _TICK_MASK

    def show_state(self, state: State) -> None:
        """Show the state in the statusword."""
        status = self._statusword.value & _LOOP_BITS | state << STATE_SHIFT
        if state is State.FAULT:
            status |= Status.FAULT.value
        self._statusword.value = status

    def show_off(self) -> None:
        """Show mode OFF, and no voltage, before the next cycle does."""
        self._mode.value = 0
        self._voltage.value = 0
        self._statusword.value &= ~Status.DRIVING.value

    def publish(self, measured: Measured, cascade: Cascade) -> None:
        """Publish a cycle: what was measured, and the controllers after it."""
        W, _, temperature, saturation = measured.si
        contact = cascade.contact
        drive = cascade.drive
        Fx, Fy = contact.Fx, contact.Fy
        values = (
            W.real,
            W.imag,
            cascade.amplitude,
            cascade.W_ref,
            drive.frequency,
            drive.voltage,
            (Fx * Fx + Fy * Fy) ** 0.5,
            contact.Fn,
            contact.mu,
            contact.u_mu,
            cascade.mu_ref,
            cascade.E * 0.01,  # % to 1
            contact.position,
            contact.speed,
            Fx,
            Fy,
            temperature,
        )
        self._quantiser.write(values)
        self._touching.value = int(contact.touching)
        self._mode.value = int(cascade.mode)
        self._tick.value = self._tick.value + (measured.tick - self._tick.value & 0xFF) & _TICK_MASK
        self._cycles.count()
        status = self._statusword.value & ~_LOOP_BITS | Status.LIVE.value
        if drive.voltage > 0.0:
            status |= Status.DRIVING.value
        if contact.touching:
            status |= Status.TOUCHING.value
        if cascade.limited:
            status |= Status.LIMITED.value
        if saturation:
            status |= Status.SATURATED.value
        self._statusword.value = status
        self._analogue_input.update(contact.touching, saturation)
