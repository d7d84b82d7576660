"""The plate inside a stimulator: what crosses the bus with a plate node is copied."""

from __future__ import annotations

from smarttac_can.nodes.frame_check import CheckedFrames
from smarttac_can.nodes.loop_frames import (
    received_drive,
    received_measurement,
    sent_drive,
    sent_measurement,
)
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.faults import FaultKind
from smarttac_can.vocabulary.objects import FAULT_KIND, SIMULATION


class PlateInside:
    """Copies integers between two object dictionaries, as the PDOs of the loop would.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    plate
        Function block of the plate.

    Raises
    ------
    ValueError
        If the PDOs of the two EDS files do not carry the same.

    Attributes
    ----------
    plate
        As given.
    """

    def __init__(self, od: ObjectDictionary, plate: PlateBlock) -> None:
        self._od = od
        self.plate = plate
        self._sent, self._received = sent_measurement(plate.od), received_measurement(od)
        _require_same(self._sent, self._received)
        sent, received = sent_drive(od), received_drive(plate.od)
        _require_same(sent, received)
        self._driven = list(zip(sent.entries, received.entries, strict=True))

    def power_on(self) -> None:
        """Begin with the values that the objects of the simulation have now."""
        self.plate.od.reset()
        for entry in self._od:
            if entry.name.partition(".")[0] in SIMULATION:
                self.plate.od[entry.name].value = entry.value

    def start_run(self) -> None:
        """Put the plate to rest at tick 0, without a fault of its own."""
        self.plate.start_run()
        self._od[FAULT_KIND].value = FaultKind.NONE

    def measure(self) -> list[int]:
        """Step the plate and sample; return the values in the order of the bus, with no check."""
        self.plate.cycle()
        values = [entry.value for entry in self._sent.entries]
        for entry, value in zip(self._received.entries, values, strict=True):
            entry.value = value
        return values

    def drive(self) -> None:
        """Have the plate take the drive."""
        for source, target in self._driven:
            target.value = source.value
        self.plate.take_drive()


def _require_same(sent: CheckedFrames, received: CheckedFrames) -> None:
    """Raise ValueError unless both ends map the same objects in the same order."""
    if len(sent.entries) != len(received.entries):
        raise ValueError("the PDOs of the loop carry different numbers of objects")
    for source, target in zip(sent.entries, received.entries, strict=True):
        what = source.name.rpartition(".")[2].lower()
        if not target.name.lower().endswith(what):
            raise ValueError(f"{source.name} and {target.name} are mapped at the same place")
