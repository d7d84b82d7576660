"""What the process of a node does while the transmit queue of its interface is full."""

import struct

from nodes_on_a_bus import stimulator_with_plate

from smarttac_can.cli.state_lines import StateLines
from smarttac_can.control.cascade import Mode
from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import QueueFullError
from smarttac_can.host.lasting_bus import LastingBus
from smarttac_can.nodes.state_machine import State
from smarttac_can.nodes.watchdogs import Watchdog


class Queue:
    """A bus that takes frames or not."""

    def __init__(self) -> None:
        self.full = False
        self.sent: list[Frame] = []

    def send(self, frame: Frame) -> None:
        if self.full:
            raise QueueFullError("queue full")
        self.sent.append(frame)

    def receive(self, timeout: float) -> Frame | None:
        return None

    def close(self) -> None:
        pass


def test_the_emergency_message_waits_for_the_queue() -> None:
    node, queue, said = stimulator_with_plate(), Queue(), []
    lines = StateLines("stimulator", "here", node, said.append)
    bus = LastingBus(lambda: queue, lost=lines.lost, back=lines.back, full=lines.full)

    def take(frames: list[Frame]) -> None:
        for frame in frames:
            bus.send(frame)

    take(lines.start())
    take(lines.receive(Frame(0, b"\1\0")))
    for _ in range(100):
        take(lines.advance(1000))
    for controlword in (0, 1, 3):
        take(lines.receive(Frame(0x220, struct.pack("<HB", controlword, Mode.OPEN_LOOP))))
    assert node.block.interlock.state is State.RUNNING
    queue.full = True
    for _ in range(300):
        take(lines.advance(1000))
    assert node.block.interlock.state is State.FAULT
    assert said.count("stimulator 32 queue full") > 1
    queue.full = False
    queue.sent.clear()
    take(lines.advance(100_000))
    assert queue.sent[0] == Frame(
        0x0A0, struct.pack("<HBB4x", 0x8111, 0x11, Watchdog.TRANSMIT_QUEUE)
    )
    assert [frame.can_id for frame in queue.sent].count(0x0A0) == 1
