"""What is looked at in every cycle of a soak, whatever happens in it."""

from __future__ import annotations

from typing import Final
from zlib import crc32

from smarttac_can.trials.driven_time import DrivenTime
from smarttac_can.trials.invariants import Invariants
from smarttac_can.trials.margins import Margins
from smarttac_can.trials.process_size import SAMPLE_CYCLES, ProcessSize
from smarttac_can.trials.rig import Rig
from smarttac_can.trials.soak_report import SoakReport
from smarttac_can.trials.trip_cause import TripCause
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import State

# What every cycle asks for stands here: looking a member of an enumeration up costs much more.
_RUNNING: Final = State.RUNNING
_FAULT: Final = State.FAULT


class SoakWatch:
    """Sees what must hold, how near the watches of a rig are, and why one has tripped.

    Parameters
    ----------
    rig
        Has a plate node; it is observed from now on.

    Attributes
    ----------
    invariants
        What must hold.
    margins
        How near the watches are while nothing is broken.
    mode
        In which the rig is driven.
    sound
        Whether nothing is broken, nor about to be.
    cause
        Why a watch has tripped at last, as the plate shows; None for no reason.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._machine = rig.stimulator.block.supervisor.machine
        self.invariants = Invariants(rig)
        self.margins = Margins(rig)
        self.mode = Mode.OPEN_LOOP
        self.sound = False
        self.cause: str | None = None
        self._state = State.READY
        self._trip_cause = TripCause(rig)
        self._driven = DrivenTime(rig)
        self._size = ProcessSize()
        self._check_sum = 0
        rig.observe = self._look

    def end_sound(self) -> None:
        """Keep how near the watches were: from now on something is broken, or about to be."""
        self.sound = False
        self.margins.keep()

    def sum_up(self, report: SoakReport) -> None:
        """Put into a report what was seen."""
        report.driving_s = self._driven.by_mode()
        report.friction_law_s = self._driven.by_friction_law()
        report.vibration_law_s = self._driven.by_vibration_law()
        report.margins = self.margins.table()
        report.rss_mib = self._size.mib
        if (grown := self._size.complaint()) is not None:
            self.invariants.violate(grown)
        report.violations = self.invariants.violations
        report.violated = self.invariants.violated
        report.fingerprint = f"{self._check_sum:08x}"

    def _look(self) -> None:
        self.invariants.check()
        self._trip_cause.look()
        self._look_closer()
        voltage = self._rig.stage.read()
        if voltage:
            self._driven.count(self.mode)
        self._check_sum = crc32(voltage.to_bytes(4, "little"), self._check_sum)
        if self._rig.cycles % SAMPLE_CYCLES == 0:
            self._size.sample()

    def _look_closer(self) -> None:
        """See how near the watches are while nothing is broken, or why one has tripped."""
        before, self._state = self._state, self._machine.state
        if self._state is _FAULT:
            self.sound = False
            if before is not _FAULT:
                self.cause = self._trip_cause.of(self._rig.od["Diagnosis.Latched"].value)
        elif self.sound and self._state is _RUNNING:
            self.margins.look()
