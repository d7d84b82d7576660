"""What the stimulator publishes of a cycle in its object dictionary."""

from __future__ import annotations

from typing import Final

from smarttac_can.control.cascade import Cascade
from smarttac_can.nodes.analogue_input import AnalogueInput
from smarttac_can.nodes.cycle_input import Measured
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.scaling import QuantisedOnDemand
from smarttac_can.vocabulary.states import STATE_SHIFT, State, Status

_VIBRATION: Final = ("W_d", "W_q", "Amplitude", "Amplitude reference", "Frequency", "Voltage")
_VOLTAGE: Final = _VIBRATION.index("Voltage")
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


_LOOP_BITS: Final = 0b11111
# Plain integers: IntFlag arithmetic costs ten times as much.
_LIVE, _DRIVING, _TOUCHING, _LIMITED, _SATURATED, _FAULT = (int(bit) for bit in Status)


class ReadBack:
    """The read-only objects that follow the loop.

    Quantities are scaled when somebody reads them, from what was kept of the last cycle.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._quantities = QuantisedOnDemand(
            [
                *(od[f"Vibration.{name}"] for name in _VIBRATION),
                *(od[f"Contact.{name}"] for name in _CONTACT),
                od["Plate temperature"],
            ]
        )
        self._touching = od["Contact.Touching"]
        self._mode = od["Mode display"]
        self._statusword = od["Statusword"]
        self._tick = od["Contact.Tick"]
        self._cycles = od["Cycle.Cycles"]
        self._analogue_input = AnalogueInput(od)
        self.reset()

    def reset(self) -> None:
        """Forget the run: tick 0 next, nothing measured."""
        self._quantities.reset()
        self._touching.value = self._mode.value = 0
        self._analogue_input.reset()
        self._statusword.value &= ~_LOOP_BITS
        self._cycles.value = 0
        self._tick.value = _TICK_MASK

    def show_state(self, state: State) -> None:
        """Show the state in the statusword."""
        status = self._statusword.value & _LOOP_BITS | state << STATE_SHIFT
        if state is State.FAULT:
            status |= _FAULT
        self._statusword.value = status

    def show_off(self) -> None:
        """Show mode OFF, and no voltage, before the next cycle does."""
        self._mode.value = 0
        row = self._quantities.row
        self._quantities.row = (*row[:_VOLTAGE], 0.0, *row[_VOLTAGE + 1 :])
        self._statusword.value &= ~_DRIVING

    def mark_stale(self) -> None:
        """Show that what can be read is not live, before a next cycle makes it so."""
        self._statusword.value &= ~_LIVE

    def publish(self, measured: Measured, cascade: Cascade) -> None:
        """Publish a cycle: what was measured, and the controllers after it."""
        W, _, temperature, saturation = measured.si
        Fx, Fy, Fn, mu, u_mu, position, speed, touching = cascade.contact
        voltage, frequency = cascade.drive
        self._quantities.row = (
            W.real,
            W.imag,
            cascade.amplitude,
            cascade.W_ref,
            frequency,
            voltage,
            (Fx * Fx + Fy * Fy) ** 0.5,
            Fn,
            mu,
            u_mu,
            cascade.mu_ref,
            cascade.E * 0.01,  # % to 1
            position,
            speed,
            Fx,
            Fy,
            temperature,
        )
        self._touching.value = int(touching)
        self._mode.value = int(cascade.mode)
        self._tick.value = self._tick.value + (measured.tick - self._tick.value & 0xFF) & _TICK_MASK
        self._cycles.count()
        status = self._statusword.value & ~_LOOP_BITS | _LIVE
        if voltage > 0.0:
            status |= _DRIVING
        if touching:
            status |= _TOUCHING
        if cascade.limited:
            status |= _LIMITED
        if saturation:
            status |= _SATURATED
        self._statusword.value = status
        self._analogue_input.update(touching, saturation)
