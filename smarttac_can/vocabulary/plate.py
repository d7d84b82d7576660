"""What a plate looks like to its node: the protocol of a front end for real hardware."""

from __future__ import annotations

from typing import Protocol

from smarttac_can.vocabulary.signals import Drive, Measurement


class Plate(Protocol):
    """Power stage, vibration pick-up, strain gauges and thermometer, as a plate node uses them.

    A front end in Python implements it and stands in for the simulated plate. All is in SI units;
    scaling, tick counts, checks and deadlines belong to the node. Each call has to return at once:
    who has to wait for hardware does so in a thread of its own. The node calls from one thread, but
    for a last drive of 0 V from another one while a call hangs.
    """

    def put_out(self, drive: Drive) -> float:
        """Put a drive out, from now until the next one.

        The first drive is one of 0 V, and so is the last. At 0 V the output is disconnected.

        Parameters
        ----------
        drive
            Voltage in V, 0..200, and frequency in Hz.

        Returns
        -------
        float
            The voltage in V that is at the output now, as it is read back; the commanded one
            where nothing can read it.
        """
        ...

    def sample(self) -> Measurement | None:
        """Return what is measured at this tick, once a millisecond at most.

        Returns
        -------
        Measurement or None
            The newest one; None if there is none since the last call. The object of the call
            before counts as none.
        """
        ...

    def close(self) -> None:
        """Let go of the hardware; the last call of all."""
        ...


class TimedPlate(Plate, Protocol):
    """A plate whose calls are timed by whoever has a clock."""

    @property
    def took_us(self) -> int:
        """How long the last call took, in us; 0 where no clock counts."""
        ...
