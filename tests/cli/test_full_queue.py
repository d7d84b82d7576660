"""What the process of a node does while the transmit queue of its interface is full.

All runs in simulated time: the clock moves only while the node waits for a frame.
"""

import struct
from collections import deque
from collections.abc import Callable, Iterable
from itertools import pairwise

from nodes_on_a_bus import both, stimulator_with_plate

from smarttac_can.cli.nodes import StateLines
from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import QueueFullError
from smarttac_can.host.reconnecting_bus import ReconnectingBus
from smarttac_can.host.runner import run_node
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.states import StageState
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.states import Mode, State
from smarttac_can.vocabulary.watchdogs import Watchdog

SYNC, START = Frame(0x80), Frame(0, b"\1\0")
TICK_US = 1000
RUNNING_MS = 400
"""From here on the plate is driven."""
Node = StimulatorNode | PlateNode


class Queue:
    """A bus whose transmit queue is full at times, and its clock.

    Parameters
    ----------
    comes
        Frames that come at a time in ms, at a distance of 1 ms.
    answer
        What the others answer to a frame of the node.
    full
        Times in us at which the queue begins to be full, and ends to be.
    end
        Time in us at which the node is told to stop.
    """

    def __init__(
        self,
        comes: Callable[[int], Iterable[Frame]],
        answer: Callable[[Frame], Iterable[Frame]],
        full: list[tuple[int, int]],
        end: int,
    ) -> None:
        self.comes = comes
        self.answer = answer
        self.full = full
        self.end = end
        self.now = 0
        self.ticks = 0
        self.inbox: deque[Frame] = deque()
        self.sent: list[tuple[int, Frame]] = []
        self.watch: list[Callable[[int], None]] = []

    def clock(self) -> int:
        return self.now * 1000

    def rest(self, seconds: float) -> None:
        self.now += round(seconds * 1e6)

    def stop(self) -> bool:
        return self.now >= self.end

    def send(self, frame: Frame) -> None:
        if any(begin <= self.now < end for begin, end in self.full):
            raise QueueFullError("queue full")
        self.sent.append((self.now, frame))
        self.inbox.extend(self.answer(frame))

    def wait(self, timeout: float) -> None:
        for look in self.watch:
            look(self.now)
        end = self.now + round(timeout * 1e6)
        if not self.inbox and (self.ticks + 1) * TICK_US <= end:
            self.ticks += 1
            self.now = max(self.now, self.ticks * TICK_US)
            self.inbox.extend(self.comes(self.ticks))
        if not self.inbox:
            self.now = end

    def read(self, frames: deque[Frame]) -> bool:
        for look in self.watch:
            look(self.now)
        frames.extend(self.inbox)
        self.inbox.clear()
        return False

    def block(self, can_ids: frozenset[int]) -> None:
        pass

    def close(self) -> None:
        pass

    def sent_between(self, begin: int, end: int) -> list[Frame]:
        return [frame for time, frame in self.sent if begin <= time < end]


def master(milliseconds: int) -> list[Frame]:
    """Start the nodes, and drive open loop."""
    if milliseconds == 2:
        return [START]
    if milliseconds == 300:
        commands = [struct.pack("<HB", controlword, Mode.OPEN_LOOP) for controlword in (0, 1, 3)]
        setpoint = Frame(0x320, struct.pack("<HI", 2000, 4_339_000))
        return [setpoint, *(Frame(0x220, command) for command in commands)]
    return []


class Run:
    """A node in its process, until a time in us."""

    def __init__(self, node: Node, bus: Queue) -> None:
        name = "stimulator" if isinstance(node, StimulatorNode) else "plate"
        self.said: list[str] = []
        self.broken_at: list[int] = []
        """When its plate came to 0 V by a fault."""
        self.bus = bus
        self._node = node
        self._was_broken = False
        self.driven_before = False
        bus.watch.append(self._look)
        lines = StateLines(name, "here", node, self.said.append)
        lasting = ReconnectingBus(lambda: bus, node, lost=lines.lost, back=lines.back)
        run_node(node, lasting, bus.stop, observer=lines, clock=bus.clock, rest=bus.rest)

    def _look(self, now: int) -> None:
        block = self._node.block
        if isinstance(self._node, StimulatorNode):
            self.driven_before |= block.state is State.RUNNING
            broken = block.state is State.FAULT
        else:
            self.driven_before |= block.state is StageState.IN_USE
            broken = block.state is StageState.TRIPPED
        if broken and not self._was_broken:
            self.broken_at.append(now)
        self._was_broken = broken

    def told_full(self) -> list[str]:
        return [line for line in self.said if "queue full" in line]


def with_partner(node: Node, partner: Node, full: list[tuple[int, int]], end: int) -> Run:
    """Run a node of the loop; the other one and the master are behind the queue."""

    def comes(milliseconds: int) -> list[Frame]:
        said = partner.advance(TICK_US)
        for frame in (*master(milliseconds), SYNC):
            said += [frame, *partner.receive(frame)]
        return said

    partner.start()
    return Run(node, Queue(comes, partner.receive, full, end))


def alone(full: list[tuple[int, int]], end: int) -> Run:
    """Run a stimulator with the plate inside."""
    return Run(stimulator_with_plate(), Queue(master, lambda _: [], full, end))


def emcy(code: int, register: int, vendor: int = 0) -> bytes:
    return struct.pack("<HBB4x", code, register, vendor)


FULL = (RUNNING_MS * TICK_US - 500, (RUNNING_MS + 100) * TICK_US + 500)
"""Between two ticks, for a hundred of them."""
FAULT_AT = (RUNNING_MS + 1) * TICK_US
"""The end of the cycle whose frames could not be handed over."""
END = (RUNNING_MS + 150) * TICK_US
TRANSMIT_QUEUE = emcy(FaultCode.TRANSMIT_QUEUE, 0x11, Watchdog.TRANSMIT_QUEUE)


def test_stimulator_whose_drive_was_not_taken_stops_in_that_cycle() -> None:
    plate, node = both()
    run = with_partner(node, plate, [FULL], END)
    assert run.driven_before
    assert run.broken_at == [FAULT_AT]
    first, *_ = run.bus.sent_between(FULL[1], FULL[1] + 200)
    assert first == Frame(0x0A0, TRANSMIT_QUEUE)
    emergencies = [frame for _, frame in run.bus.sent if frame.can_id == 0x0A0]
    assert emergencies.count(first) == 1
    assert run.told_full() == ["stimulator 32 queue full"]
    drives = [f for f in run.bus.sent_between(FULL[1], END) if f.can_id == 0x221]
    assert drives, "the plate hears of it"
    assert all(frame.data[:2] == bytes(2) for frame in drives), "at 0 V"
    assert plate.od["Stage.Voltage"].read() == 0


def test_plate_whose_measurement_was_not_taken_is_barred_in_that_cycle() -> None:
    plate, node = both()
    run = with_partner(plate, node, [FULL], END)
    assert run.driven_before
    assert run.broken_at == [FAULT_AT]
    first, *_ = run.bus.sent_between(FULL[1], END)
    assert first == Frame(0x0A1, emcy(FaultCode.DRIVE_LOST, 0x11))
    assert [frame for _, frame in run.bus.sent].count(first) == 1
    assert run.told_full() == ["plate 33 queue full"]


def test_stimulator_with_the_plate_inside_stops_when_its_heartbeat_is_not_taken() -> None:
    full = (RUNNING_MS * TICK_US - 500, 1_100_500)
    run = alone([full], 1_200_000)
    assert run.driven_before
    heartbeat_at = 500_000
    assert run.broken_at == [heartbeat_at + TICK_US]
    first, *rest = run.bus.sent_between(full[1], 1_200_000)
    assert first == Frame(0x0A0, TRANSMIT_QUEUE)
    assert first not in rest
    assert run.told_full() == ["stimulator 32 queue full"]


def test_a_queue_that_is_full_for_less_than_a_cycle_is_no_fault() -> None:
    short = [(begin, begin + 900) for begin in range(RUNNING_MS * TICK_US, END, 2 * TICK_US)]
    for under_test, can_id, tick_at in ((0, 0x1A1, 4), (1, 0x221, 6)):
        nodes = both()
        run = with_partner(nodes[under_test], nodes[1 - under_test], short, END)
        assert run.driven_before
        assert (run.broken_at, run.told_full()) == ([], [])
        sent = run.bus.sent_between(0, END)
        ticks = [frame.data[tick_at] for frame in sent if frame.can_id == can_id]
        assert all((later - earlier) % 256 == 1 for earlier, later in pairwise(ticks))


def test_each_episode_has_a_line() -> None:
    plate, node = both()
    later = tuple(time + 200 * TICK_US for time in FULL)
    run = with_partner(node, plate, [FULL, later], END + 200 * TICK_US)
    assert run.told_full() == ["stimulator 32 queue full"] * 2
    assert run.broken_at == [FAULT_AT], "the first one is still latched"
