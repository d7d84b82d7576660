"""The gains of the two PIs over the normal force: each designed once, then looked up."""

from __future__ import annotations

from typing import Final

from smarttac_can.control.design import amplitude_pi, resonance_pi
from smarttac_can.control.pi import PI
from smarttac_can.vocabulary.model import GAIN_MIN, TAU_MIN, PlateModel, contact_load

STEP: Final = 0.05
"""Step of the table in N: a time constant of 3 % at 0.5 N."""
ROWS: Final = 61
"""The last one is 3 N, beyond which the load grows slowly and a finger soon is a fault."""
Gains = tuple[float, float, float]
"""Kp of amplitude and resonance, and their a."""


def row_of(Fn: float, rows: int) -> int:
    """Return the row of a table of so many rows for a normal force in N, 0 without a finger."""
    return min(int(Fn / STEP + 0.5), rows - 1) if Fn > 0.0 else 0


class Schedule:
    """Designs of both loops for the plate under a finger.

    Parameters
    ----------
    model
        The unloaded plate, and what a finger adds.
    amplitude_pole, resonance_pole, dead_time
        As for `smarttac_can.control.design.amplitude_pi`.
    """

    __slots__ = ("_model", "_placed", "_rows")

    def __init__(
        self, model: PlateModel, amplitude_pole: float, resonance_pole: float, dead_time: float
    ) -> None:
        self._model = model
        self._placed = (amplitude_pole, resonance_pole, dead_time)
        self._rows: list[Gains | None] = [None] * ROWS

    def tune(self, Fn: float, amplitude: PI, resonance: PI) -> None:
        """Give both PIs the gains for a normal force in N, 0 without a finger.

        What they stand at does not change: only the error moves them, by another gain.
        """
        row = row_of(Fn, ROWS)
        amplitude.Kp, resonance.Kp, a = self._rows[row] or self.gains(row)
        amplitude.a = resonance.a = a

    def tune_amplitude(self, Fn: float, amplitude: PI) -> None:
        """Do so with the PI of the amplitude alone."""
        row = row_of(Fn, ROWS)
        amplitude.Kp, _, amplitude.a = self._rows[row] or self.gains(row)

    def gains(self, row: int) -> Gains:
        """Design both loops for a row when it is first asked for: all at once would be a cycle."""
        model = self._model
        amplitude_pole, resonance_pole, dead_time = self._placed
        tau = max(1.0 / model.decay_rate(contact_load(STEP * row)), TAU_MIN)
        loaded = PlateModel(max(model.gain * tau / model.tau, GAIN_MIN), tau, model.f0)
        amplitude = amplitude_pi(loaded, amplitude_pole, dead_time)
        resonance = resonance_pi(loaded, resonance_pole, dead_time)
        self._rows[row] = gains = (amplitude.Kp, resonance.Kp, amplitude.a)
        return gains
