"""The gains of the two PIs over the normal force: designed once, looked up in the cycle."""

from __future__ import annotations

from typing import Final

from smarttac_can.control.design import amplitude_pi, resonance_pi
from smarttac_can.control.load import contact_load, decay_rate
from smarttac_can.control.pi import PI
from smarttac_can.vocabulary.model import TAU_MIN, PlateModel

STEP: Final = 0.02
"""Step of the table in N: two standard deviations of the normal force."""
_END: Final = 150
"""Last row: 3 N, beyond which the load grows slowly and a finger soon is a fault."""


class Schedule:
    """Designs of both loops for the plate under a finger.

    Parameters
    ----------
    model
        The unloaded plate, and what a finger adds.
    amplitude_pole, resonance_pole, dead_time
        As for `smarttac_can.control.design.amplitude_pi`.
    """

    __slots__ = ("_rows",)

    def __init__(
        self, model: PlateModel, amplitude_pole: float, resonance_pole: float, dead_time: float
    ) -> None:
        rows = []
        for row in range(_END + 1):
            tau = max(1.0 / decay_rate(model, contact_load(STEP * row)), TAU_MIN)
            loaded = PlateModel(max(model.gain * tau / model.tau, 1e-9), tau, model.f0)
            amplitude = amplitude_pi(loaded, amplitude_pole, dead_time)
            resonance = resonance_pi(loaded, resonance_pole, dead_time)
            rows.append((amplitude.Kp, resonance.Kp, amplitude.a))
        self._rows = tuple(rows)

    def tune(self, Fn: float, amplitude: PI, resonance: PI) -> None:
        """Give both PIs the gains for a normal force in N, 0 without a finger.

        What they stand at does not change: only the error moves them, by another gain.
        """
        row = int(Fn / STEP + 0.5) if Fn > 0.0 else 0
        amplitude.Kp, resonance.Kp, a = self._rows[row if row < _END else _END]
        amplitude.a = resonance.a = a
