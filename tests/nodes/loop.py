"""Two nodes by the clock, and a master: a loop for tests to break."""

from __future__ import annotations

import struct
from collections.abc import Callable

from line import START, Line

from smarttac_can.bench.open_link import PLATE_ID, plate_od, stimulator_od
from smarttac_can.device.frame import Frame
from smarttac_can.master import requests
from smarttac_can.nodes.analogue_input import ZERO
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.state_machine import State
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.cia import SYNC_COUNTER_LAST
from smarttac_can.trials.rig import TARE_CYCLES

OPEN_LOOP, AMPLITUDE, AMPLITUDE_RESONANCE, FRICTION, IDENTIFY = DRIVING = range(1, 6)
MASTER, MASTER_LOST_MS = 1, 30
SETPOINT_DEADLINE_MS = 5


class Loop:
    """Two nodes by the clock and a master that has a SYNC and a heartbeat in each cycle."""

    def __init__(self, mode: int = OPEN_LOOP) -> None:
        self.lost: set[int] = set()
        self.syncs = 1
        self.heartbeat = True
        self.setpoints = True
        self.plate = PlateNode(plate_od(), deadline_ms=3)
        self.node = StimulatorNode(stimulator_od(), plate_node_id=PLATE_ID, deadline_ms=3)
        for node in (self.plate, self.node):
            node.receive = self._lossy(node.receive)  # type: ignore[method-assign]
        self.line = Line(self.plate, self.node, lockstep=False)
        self.line.master.sync_counter = SYNC_COUNTER_LAST
        self.mode = mode
        watched, deadline = self.node.od.entry(0x1016, 1), self.node.od.entry(0x1401, 5)
        assert self.line.write_entry(self.node, watched, MASTER << 16 | MASTER_LOST_MS) == 0
        assert self.line.write_entry(self.node, deadline, SETPOINT_DEADLINE_MS) == 0
        for each in (self.plate, self.node):
            for index, raw in ((0x1006, 0), (0x1019, SYNC_COUNTER_LAST), (0x1006, 1000)):
                assert self.line.write_entry(each, each.od.entry(index), raw) == 0
        self.line.nmt(START)
        self.begin()

    def begin(self) -> None:
        """Tare, touch, and drive in the mode."""
        write = self.line.write
        assert write(self.plate, "Finger.Motion", int(self.mode != IDENTIFY)) == 0
        for node in (self.plate, self.node):
            assert write(node, "Simulation.Start run", 1) == 0
        self.cycle(TARE_CYCLES)
        assert write(self.node, "AI auto-zero.AI auto-zero normal force", ZERO) == 0
        assert write(self.node, "Setpoint.Amplitude", 1000) == 0
        self.cycle(400 if self.mode != IDENTIFY else 2)
        self.line.run(self.node, self.mode)
        self.cycle(60 if self.mode != IDENTIFY else 130)
        assert self.voltage > 0
        assert self.state is State.RUNNING

    @property
    def voltage(self) -> int:
        return int(self.plate.od["Stage.Voltage"].value)

    @property
    def state(self) -> State:
        return self.node.block.state

    def cycle(self, count: int = 1) -> None:
        for _ in range(count):
            self.line.advance(1)
            if self.heartbeat:
                self.line.send(requests.heartbeat(MASTER))
            if self.setpoints:
                self.line.send(Frame(0x320, struct.pack("<HI", 2000, 4_339_000)))
            self.line.sync(self.syncs)

    def break_plate(self, kind: int, sensor: int = 1, value: int = 0) -> None:
        for name, raw in (("Sensor", sensor), ("Value", value), ("Kind", kind)):
            assert self.line.write(self.plate, f"Fault.{name}", raw) == 0

    def limit(self, name: str, raw: int) -> None:
        assert self.line.write(self.node, f"Limit.{name}", raw) == 0

    def said(self, frames: list[Frame]) -> None:
        for frame in frames:
            self.line.ports[1].send(frame)

    def _lossy(self, receive: Callable[[Frame], list[Frame]]) -> Callable[[Frame], list[Frame]]:
        return lambda frame: [] if frame.can_id in self.lost else receive(frame)
