"""The plate inside a stimulator: what crosses the bus with a plate node is copied."""

from __future__ import annotations

from smarttac_can.nodes.loop_frames import (
    received_drive,
    received_measurement,
    sent_drive,
    sent_measurement,
)
from smarttac_can.nodes.plate_block import PlateBlock
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
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
        self._measured = _pairs(sent_measurement(plate.od), received_measurement(od))
        self._driven = _pairs(sent_drive(od), received_drive(plate.od))

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

    def measure(self) -> None:
        """Have the plate step and sample; the measurement arrives."""
        self.plate.cycle()
        for source, target in self._measured:
            target.value = source.value

    def drive(self) -> None:
        """Have the plate take the drive."""
        for source, target in self._driven:
            target.value = source.value
        self.plate.take_drive()


def _pairs(sources: list[Entry], targets: list[Entry]) -> list[tuple[Entry, Entry]]:
    """Link entries as a TPDO and an RPDO would; the check is for what crosses a bus."""
    if len(sources) != len(targets):
        raise ValueError("the PDOs of the loop carry different numbers of objects")
    pairs = list(zip(sources[:-1], targets[:-1], strict=True))
    for source, target in pairs:
        what = source.name.rpartition(".")[2].lower()
        if not target.name.lower().endswith(what):
            raise ValueError(f"{source.name} and {target.name} are mapped at the same place")
    return pairs
