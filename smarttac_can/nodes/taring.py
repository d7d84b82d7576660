"""Zeros of the gauges: those that are stored, the tare at power-on, and that by command."""

from __future__ import annotations

from smarttac_can.control.cascade import Cascade
from smarttac_can.nodes.null_window import NullWindow
from smarttac_can.nodes.plans import GAUGE_ZERO
from smarttac_can.nodes.supervisor import Supervisor
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.objects import NOT_TARED, TARE, ZERO
from smarttac_can.vocabulary.signals import TARE_SAMPLES


class Taring:
    """Has the zeros in force be those that can be read, and stored.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    supervisor
        Inhibits a tare, and records a zero.
    """

    def __init__(self, od: ObjectDictionary, supervisor: Supervisor) -> None:
        self._supervisor = supervisor
        self._window = NullWindow(od)
        self._zeros = [od[f"{GAUGE_ZERO}.Zero of S{number}"] for number in range(1, 7)]
        self._at_power_on = od["Tare at power-on"]
        self._cycles = od["Cycle.Cycles"]

    def begin(self, cascade: Cascade) -> None:
        """Begin a run with the zeros of the objects; without any, the tare at power-on is due."""
        self._awaited = bool(self._at_power_on.value)
        self._from = TARE_SAMPLES
        self.restore(cascade)

    def restore(self, cascade: Cascade) -> None:
        """Put the zeros of the objects in force; all of them 0 stand for a plate never tared."""
        if any(entry.value for entry in self._zeros):
            self._put_in_force(cascade)

    def tare_when_due(self, cascade: Cascade) -> None:
        """Make the tare at power-on if it is awaited, and there are samples for it."""
        due = self._awaited and self._cycles.value >= self._from
        if due and not self._supervisor.tare_inhibited:
            try:
                self._tare(cascade)
            except ValueError as error:
                # The next samples may be without a finger.
                self._from += TARE_SAMPLES
                self._supervisor.refuse(TARE, str(error))

    def auto_zero(self, cascade: Cascade, signature: int) -> None:
        """Tare by command.

        Raises
        ------
        Abort
            VALUE for a wrong signature; STATE where a tare is barred, without enough samples, and
            with a null outside its window. With the reason.
        """
        if signature != ZERO:
            raise Abort(
                AbortCode.VALUE, f"{NOT_TARED}the value is not the signature {ZERO:08X}h, 'zero'"
            )
        if self._supervisor.tare_inhibited:
            raise Abort(
                AbortCode.STATE,
                f"{NOT_TARED}disarm first, and take away a force that has tripped a limit",
            )
        try:
            self._tare(cascade)
        except RuntimeError as error:
            raise Abort(AbortCode.STATE, f"{NOT_TARED}{error}") from error
        except ValueError as error:
            raise Abort(AbortCode.STATE, str(error)) from error

    def _tare(self, cascade: Cascade) -> None:
        zeros = cascade.null()
        self._window.require(zeros)
        for entry, zero in zip(self._zeros, zeros, strict=True):
            entry.value = entry.quantise(zero)
        self._put_in_force(cascade)

    def _put_in_force(self, cascade: Cascade) -> None:
        s1, s2, s3, s4, s5, s6 = [entry.si_value for entry in self._zeros]
        cascade.zero = (s1, s2, s3, s4, s5, s6)
        self._awaited = False
        self._supervisor.note_zero()
