"""What a power stage that is left alone with a voltage does until the plate's deadline ends it."""

from __future__ import annotations

from math import exp, log
from typing import Any, Final, NamedTuple

from smarttac_can.bench.simulation import plate_od, stimulator_od

SHORTEST_MS: Final = 3
"""The deadline that the dose is compared with, in ms."""
_QUIET: Final = 0.05


class FrozenStage(NamedTuple):
    """A stage frozen at a voltage, and a plate of first order at its resonance.

    With the final amplitude as 1, ``tau W' = 1 - W`` until the deadline ends it, then
    ``tau W' = -W``. All times count from the moment at which it freezes.
    """

    deadline_ms: float
    """Deadline of the plate, long enough for 5 % of the final amplitude to be reached."""
    tau_ms: float
    """Time constant of the plate, above 0."""
    voltage_v: float
    final_um: float
    """Amplitude peak-to-peak that this voltage has in the end."""

    @property
    def reached(self) -> float:
        """Share of the final amplitude that a plate at rest reaches, 0..1."""
        return 1.0 - exp(-self.deadline_ms / self.tau_ms)

    @property
    def quiet_ms(self) -> float:
        """Time in ms after which the amplitude of a plate at rest is below 5 % again."""
        return self.deadline_ms + self.tau_ms * log(self.reached / _QUIET)

    @property
    def dose_from_rest(self) -> float:
        """Integral of W^2 over all time, of a plate at rest, in ms of the final amplitude."""
        return self.deadline_ms - self.tau_ms * self.reached

    @property
    def dose_from_final(self) -> float:
        """The same of a plate that has the final amplitude already."""
        return self.deadline_ms + 0.5 * self.tau_ms

    def as_json(self) -> dict[str, Any]:
        """Return what it does; doses relative to those of the shortest deadline."""
        shortest = self._replace(deadline_ms=SHORTEST_MS)
        return {
            "voltage_v": self.voltage_v,
            "final_um": round(self.final_um, 3),
            "reached_share": round(self.reached, 4),
            "below_5_percent_ms": round(self.quiet_ms, 2),
            "dose_ratio": round(self.dose_from_final / shortest.dose_from_final, 2),
            "dose_ratio_from_rest": round(self.dose_from_rest / shortest.dose_from_rest, 2),
        }


def frozen_stage(deadline_ms: float) -> FrozenStage:
    """Return the worst of the default limits: the plate's highest voltage, at its resonance."""
    voltage = plate_od()["Limit.Voltage"].si_value
    model = stimulator_od()
    return FrozenStage(
        deadline_ms,
        tau_ms=model["Model.Tau"].si_value * 1e3,
        voltage_v=voltage,
        final_um=model["Model.Gain per volt"].si_value * voltage * 1e6,
    )
