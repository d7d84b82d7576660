"""A stimulator with the plate inside, cycle by cycle, without a node or a bus."""

from __future__ import annotations

from smarttac_can.bench.simulation import plate_od, stimulator_od
from smarttac_can.canopen.od.cia import Abort
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.science.plant.finger import Trajectory
from smarttac_can.vocabulary.states import State


class Loop:
    """A stimulator that is ready, with 20 V to put out in open loop."""

    def __init__(self, recording: Trajectory | None = None) -> None:
        self.plate = PlateBlock(plate_od(), recording)
        self.block = StimulatorBlock(stimulator_od(), self.plate)
        self.tick(70)
        assert self.block.state is State.READY
        assert self.write("Setpoint.Voltage", 2000) == 0

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.block.tick()

    def write(self, name: str, raw: int | bytes) -> int:
        """Write as by SDO; return the abort code, 0 for success."""
        try:
            self.block.write(name, raw)
        except Abort as abort:
            return abort.code
        return 0

    def run(self, mode: int) -> None:
        for name, raw in (("Controlword", 0), ("Controlword", 1), ("Mode", mode)):
            assert self.write(name, raw) == 0
        assert self.write("Controlword", 3) == 0

    def shown(self, *names: str) -> list[int]:
        return [int(self.block.od[name].read()) for name in names]

    @property
    def message(self) -> str:
        return str(self.block.od["Message"].value)

    @property
    def latched(self) -> int:
        return int(self.block.od["Diagnosis.Latched"].value)
