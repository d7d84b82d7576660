"""Interface of a plate to its node: the protocol of a front end for real hardware."""

from __future__ import annotations

from typing import Protocol

from smarttac_can.vocabulary.signals import Drive, Measurement


class Plate(Protocol):
    """Power stage, vibration pick-up, strain gauges and thermometer, as a plate node uses them.

    A front end in Python implements it and replaces the simulated plate. All values are in SI
    units; scaling, tick counts, checks and deadlines are done by the node. Each call must return
    immediately; waiting for hardware belongs in a thread of the front end. The node calls from one
    thread, with one exception: while a call hangs, a last drive of 0 V may come from another
    thread.
    """

    def put_out(self, drive: Drive) -> float:
        """Put out a drive, from now until the next one.

        The first drive has 0 V, and so has the last. At 0 V the output is disconnected.

        Parameters
        ----------
        drive
            Voltage in V, 0..200, and frequency in Hz.

        Returns
        -------
        float
            Voltage in V at the output, as read back; the commanded voltage if it cannot be read.
        """
        ...

    def sample(self) -> Measurement | None:
        """Return the measurement at this tick; called at most once per millisecond.

        Returns
        -------
        Measurement or None
            Newest measurement; None if there is none since the last call. Returning the object of
            the last call again counts as None.
        """
        ...

    def close(self) -> None:
        """Release the hardware; this is the last call."""
        ...


class TimedPlate(Plate, Protocol):
    """A plate whose calls are timed by code that has a clock."""

    @property
    def took_us(self) -> int:
        """Duration of the last call in us; 0 without a clock."""
        ...
