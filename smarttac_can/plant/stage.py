"""The power stage: what it puts out, which need not be what it is told."""

from __future__ import annotations


class PowerStage:
    """A simulated power stage, sound at first."""

    __slots__ = ("_stuck",)

    def __init__(self) -> None:
        self._stuck = 0.0

    def put_out(self, told: float) -> float:
        """Return the voltage at its output in V, as hardware there reads it back.

        At 0 V the output is disconnected, so that much a stuck stage obeys.

        Parameters
        ----------
        told
            What it is told, in V, 0 or more.
        """
        return self._stuck if told and self._stuck else told

    def stick(self, voltage: float) -> None:
        """Put out a voltage in V, whatever it is told above 0 V; 0 mends it."""
        self._stuck = voltage
