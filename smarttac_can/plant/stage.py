"""The power stage: its output, which may differ from the commanded voltage."""

from __future__ import annotations


class PowerStage:
    """A simulated power stage, initially sound."""

    __slots__ = ("_stuck",)

    def __init__(self) -> None:
        self._stuck = 0.0

    def put_out(self, commanded: float) -> float:
        """Return the voltage at its output in V, as hardware would read it back.

        At 0 V the output is disconnected, so even a stuck stage is at 0 V.

        Parameters
        ----------
        commanded
            Commanded voltage in V, 0 or more.
        """
        return self._stuck if commanded and self._stuck else commanded

    def stick(self, voltage: float) -> None:
        """Put out a voltage in V for every command above 0 V; 0 removes the fault."""
        self._stuck = voltage
