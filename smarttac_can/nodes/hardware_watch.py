"""What hardware says of the power stage: whether it may drive, and what it puts out."""

from __future__ import annotations

from typing import Final

from smarttac_can.device.device import Device
from smarttac_can.nodes.front_end import STAGE_TOLERANCE
from smarttac_can.nodes.lock import LONGER, OTHER, Rule
from smarttac_can.nodes.loop_frames import PLATE_RPDOS
from smarttac_can.nodes.watches import full_bucket, leaked
from smarttac_can.od.cia import (
    PDO_COB_ID,
    PDO_EVENT,
    PDO_TRANSMISSION,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    Abort,
    AbortCode,
)
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.fault_codes import FaultCode

READ_BACK_CYCLES: Final = 3
"""Cycles in a row with a wrong reading that are a fault; those now and then fill a leaky bucket.
Two more pass before, at most: a reading may be a cycle old, and so may what it is compared with."""
_FULL: Final = full_bucket(READ_BACK_CYCLES)


class HardwareWatch:
    """The inputs ``Enable`` and ``Stage read-back``, each of which is watched while it is mapped.

    An input is mapped while a valid RPDO of the plate has it in its mapping. The stage may drive
    then while each such RPDO has come within its event timer, an ``Enable`` that is mapped is 1,
    and a read-back that is mapped is the voltage that the stage was commanded. A reading is
    compared with that of now and of the last two cycles: it may be a cycle old.

    Parameters
    ----------
    device
        The plate's.

    Attributes
    ----------
    sources
        RPDOs that have one of the inputs in their mapping, and whether it is the read-back.
    reads_back
        Whether the read-back is mapped.
    cause
        What keeps the stage from a voltage; None if nothing does.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        od = device.od
        self._enable = od["Enable"]
        self._read_back = od["Stage read-back"]
        self._inputs: tuple[Entry, ...] = ()
        self._rules: dict[Entry, Rule] = {}
        self.sources: dict[int, bool] = {}
        self.reads_back = False
        self.cause: FaultCode | None = None
        self._commanded = (0.0, 0.0)
        self._wrong = False
        self._wrong_cycles = 0

    def configure(self) -> None:
        """Look up what is mapped; for when PDOs have changed, or the NMT state has."""
        carries = self._device.carries
        both = (self._enable, self._read_back)
        self._inputs = tuple(e for e in both if any(carries(n, e) for n in PLATE_RPDOS))
        self.sources = {
            number: carries(number, self._read_back)
            for number in PLATE_RPDOS
            if any(carries(number, entry) for entry in both)
        }
        self.reads_back = self._read_back in self._inputs
        if not self.reads_back:
            self._wrong = False
            self._wrong_cycles = 0
        self._rules = dict(rule for number in self.sources for rule in self._of_rpdo(number))
        self.look()

    def hear(self, number: int, commanded: float) -> None:
        """Take what one of the sources has brought.

        Parameters
        ----------
        number
            That of the RPDO.
        commanded
            What the stage is commanded now, in V.
        """
        if self.sources[number]:
            reading = float(self._read_back.value * self._read_back.si)
            of_late = (commanded, *self._commanded)
            most, least = max(of_late), min(of_late)
            self._wrong = not least - STAGE_TOLERANCE <= reading <= most + STAGE_TOLERANCE
        self.look()

    def cycle(self, commanded: float) -> None:
        """Count a cycle of the loop at whose end the stage was commanded a voltage in V."""
        self._commanded = (commanded, self._commanded[0])
        self._wrong_cycles = leaked(self._wrong_cycles, _FULL, self._wrong)
        self.look()

    def look(self) -> None:
        """See what keeps the stage from a voltage."""
        heard = all(map(self._device.in_time, self.sources))
        enabled = self._enable.value or self._enable not in self._inputs
        self.cause = None
        if not (heard and enabled):
            self.cause = FaultCode.NOT_ENABLED
        elif self._wrong_cycles >= _FULL:
            self.cause = FaultCode.STAGE

    def require(self, entry: Entry, value: int, *, in_use: bool) -> None:
        """Refuse a write that would take the place of the hardware, or end the watch over it.

        Parameters
        ----------
        entry, value
            What is written, raw.
        in_use
            Whether the stage is.

        Raises
        ------
        Abort
            STATE for another value of an input that is mapped, and while the stage is in use for
            what would be laxer.
        """
        if entry in self._inputs and OTHER.holds(entry.value, value):
            raise Abort(AbortCode.STATE)
        rule = self._rules.get(entry)
        if in_use and rule is not None and rule.holds(entry.value, value):
            raise Abort(AbortCode.STATE)

    def _of_rpdo(self, number: int) -> list[tuple[Entry, Rule]]:
        """List what does not become laxer of an RPDO."""
        objects = self._device.od.objects
        communication = objects[RPDO_COMMUNICATION + number - 1].entries
        mapping = objects[RPDO_MAPPING + number - 1].entries
        return [
            (communication[PDO_COB_ID], OTHER),
            (communication[PDO_TRANSMISSION], OTHER),
            (communication[PDO_EVENT], LONGER),
            *((entry, OTHER) for entry in mapping.values()),
        ]
