"""A node on a bus with faults: its power, its clock, its process and its CAN controller."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Final, Protocol

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import QueueFullError
from smarttac_can.host.frame_faults import FrameFault
from smarttac_can.host.node import ConnectedNode, HostedNode, kind, without_queue
from smarttac_can.host.outbox import Outbox

if TYPE_CHECKING:
    from smarttac_can.host.faulty_bus import FaultyBus

QUEUE_FRAMES: Final = 1000
"""Frames of a party that wait at most while the bus has no room; an assumption."""
RECEIVED_FRAMES: Final = 256
"""Frames that wait at most for a process that stands: about what the 208 KiB hold that a socket
has by default on Linux; an assumption."""


class Transmitter:
    """The way of one party's frames to the bus."""

    __slots__ = ("_behind", "_held", "bus")

    def __init__(self, bus: FaultyBus) -> None:
        self.bus = bus
        self._held: list[tuple[int, Frame]] = []
        self._behind: list[Frame] = []

    def passed(self, frames: Iterable[Frame]) -> list[Frame]:
        """Return what becomes of the frames that a party sends now."""
        if not (self.bus.disturbed or self._held or self._behind):
            return list(frames)
        out = self._due()
        for frame in frames:
            sent = self._disturb(frame)
            if sent is None:
                continue
            out += sent
            out += self._behind
            self._behind = []
        return self._fitting(out)

    def _due(self) -> list[Frame]:
        cycle = self.bus.cycle
        due = [frame for when, frame in self._held if when <= cycle]
        self._held = [(when, frame) for when, frame in self._held if when > cycle]
        return due

    def _disturb(self, frame: Frame) -> list[Frame] | None:
        """Return the frames sent now in place of one, None if it goes behind the next."""
        bus = self.bus
        for disturbance in bus.disturbances:
            if disturbance.can_ids and frame.can_id not in disturbance.can_ids:
                continue
            if disturbance.share < 1.0 and bus.random.random() >= disturbance.share:
                continue
            frame_fault = disturbance.frame_fault
            if frame_fault is FrameFault.LOSS:
                return []
            if frame_fault is FrameFault.DUPLICATION:
                return [frame, frame]
            if frame_fault is FrameFault.REORDERING and not self._behind:
                self._behind.append(frame)
                return None
            if frame_fault is FrameFault.DELAY:
                self._held.append((bus.cycle + disturbance.cycles, frame))
                return []
            if frame_fault is FrameFault.CORRUPTION and frame.data:
                data = bytearray(frame.data)
                bit = bus.random.randrange(8 * len(data))
                data[bit // 8] ^= 1 << bit % 8
                return [Frame(frame.can_id, bytes(data), frame.rtr)]
        return [frame]

    def _fitting(self, frames: list[Frame]) -> list[Frame]:
        """Leave for the next cycle what a babbling node leaves no room for in this one.

        What the queue of a party has no room for, either, is lost.
        """
        out = []
        for frame in frames:
            if self.bus.has_room(frame):
                out.append(frame)
            elif len(self._held) < QUEUE_FRAMES:
                self._held.append((self.bus.cycle + 1, frame))
        return out


class WholeNode(HostedNode, ConnectedNode, Protocol):
    """A node with all that hosts ask of one."""


class _Controller:
    """A CAN controller that hands frames on, once it has room."""

    __slots__ = ("bus", "full_until", "sent")

    def __init__(self, bus: FaultyBus) -> None:
        self.bus = bus
        self.full_until = 0
        self.sent: list[Frame] = []

    def send(self, frame: Frame) -> None:
        if self.bus.cycle < self.full_until:
            raise QueueFullError("the controller has no room")
        self.sent.append(frame)


class Station:
    """A node with its own power, clock, process and CAN controller.

    Parameters
    ----------
    node
        Started by `start`.
    transmitter
        Takes what reaches the bus.
    lockstep
        Whether SYNC is its clock, also after a pause; otherwise time has passed then.
    """

    __slots__ = (
        "_controller",
        "_lockstep",
        "_missed",
        "_outbox",
        "_receive",
        "_waiting",
        "clock_runs",
        "connected",
        "node",
        "paused",
        "powered",
        "transmitter",
    )

    def __init__(self, node: WholeNode, transmitter: Transmitter, lockstep: bool) -> None:
        self.node = node
        self._receive = without_queue(node)
        self.transmitter = transmitter
        self._lockstep = lockstep
        self.powered = True
        self.clock_runs = True
        self.paused = False
        self.connected = True
        self._missed: list[Frame | int] = []
        self._waiting = 0
        self._controller = _Controller(transmitter.bus)
        self._outbox: Outbox | None = None

    def start(self) -> list[Frame]:
        """Switch the power on."""
        return self._sent(self.node.start())

    def receive(self, frame: Frame) -> list[Frame]:
        """Take a frame from the bus, if it can."""
        if self.paused:
            self._waiting += 1
            if self._waiting <= RECEIVED_FRAMES:
                self._missed.append(frame)
        elif self.powered and self.connected:
            return self._sent(self._receive(frame))
        return []

    def advance(self, microseconds: int) -> list[Frame]:
        """Let time pass."""
        if self.paused:
            self._missed.append(microseconds)
        elif self.powered:
            return self._sent(self.node.advance(microseconds) if self.clock_runs else [])
        return []

    def segments(self, _most: int) -> list[Frame]:
        """Return nothing: they follow their request at once."""
        return []

    def shutdown(self) -> list[Frame]:
        """Leave the plate at 0 V."""
        return self._sent(self.node.shutdown()) if self.powered else []

    def catch_up(self) -> list[Frame]:
        """Go on after a pause with the frames that wait and the time that passed meanwhile.

        In real time the time comes first, and what is overdue by then, as for a process of its own.
        """
        self.paused = False
        missed, self._missed, self._waiting = self._missed, [], 0
        out = []
        if not self._lockstep:
            self.node.clock.now += sum(item for item in missed if isinstance(item, int))
            out += self._sent(self.node.overdue())
            out += self._hear_what_waits([item for item in missed if isinstance(item, Frame)])
            missed = [0]
        for item in missed:
            out += self.advance(item) if isinstance(item, int) else self.receive(item)
        return out

    def _hear_what_waits(self, frames: list[Frame]) -> list[Frame]:
        """Take frames of which it is known what newer ones wait behind them."""
        out: list[Frame] = []
        if not (self.powered and self.connected):
            return out
        newest = {kind(frame): at for at, frame in enumerate(frames)}
        for at, frame in enumerate(frames):
            hear = self._receive if at == newest[kind(frame)] else self.node.overtaken
            out += self._sent(hear(frame))
        return out

    def clog(self, until: int) -> None:
        """Take no more frames before a cycle of the bus: they wait in the node's outbox."""
        self._controller.full_until = until
        self._outbox = Outbox(self.node, self._controller, lambda _reason: None)

    def bus_off(self) -> None:
        """Leave the bus; what the node says of it reaches nobody."""
        self.node.bus_off()
        self.connected = False

    def bus_recovered(self) -> list[Frame]:
        """Be on the bus again; return what the node says of it."""
        self.connected = True
        return self._sent(self.node.bus_recovered())

    def _sent(self, frames: list[Frame]) -> list[Frame]:
        """Return what reaches the bus of frames that the node sends now."""
        if not self.connected:
            return []
        outbox, controller = self._outbox, self._controller
        if outbox is None:
            return self.transmitter.passed(frames)
        outbox.put(frames)
        while outbox.hand_over():
            pass
        sent, controller.sent = controller.sent, []
        if sent and outbox.empty:
            self._outbox = None
        return self.transmitter.passed(sent)
