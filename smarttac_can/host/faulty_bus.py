"""A local bus with injected faults of frames and nodes, the same in every run."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from typing import Final

from smarttac_can.canopen.bus.bus import LogHook, QueueFullError
from smarttac_can.canopen.bus.local_bus import Connection, LocalBus, Wire
from smarttac_can.canopen.bus.node import HostedNode, is_overtaken, without_queue
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od import cia
from smarttac_can.host.outbox import Outbox
from smarttac_can.vocabulary.signals import TICK_US


class FrameFault(Enum):
    """Fault of a frame between its sender and the bus."""

    LOSS = "loss"
    """The frame is not sent."""
    DUPLICATION = "duplication"
    """The frame is sent twice in a row."""
    REORDERING = "reordering"
    """The frame is sent after the next frame of its sender."""
    DELAY = "delay"
    """The frame is sent some cycles later, before the frames of its sender in that cycle."""
    CORRUPTION = "corruption"
    """One bit of the data is flipped, as by a faulty memory; the CRC of the frame is correct."""


def require_can_id(can_id: int) -> None:
    """Raise ValueError unless an identifier has 11 bits."""
    if not 0 <= can_id <= cia.CAN_ID_MASK:
        raise ValueError(f"identifier {can_id:X}h is outside 0h..{cia.CAN_ID_MASK:X}h")


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A fault, and the frames that it affects."""

    frame_fault: FrameFault
    can_ids: frozenset[int] = frozenset()
    """Identifiers of these frames; empty for all frames."""
    share: float = 1.0
    """Fraction of these frames that is affected at random, 0..1."""
    cycles: int = 1
    """Cycles of a delay, 1 or more."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise ValueError(f"share {self.share} is outside 0..1")
        if self.cycles < 1:
            raise ValueError(f"cycles {self.cycles} is below 1")
        for can_id in self.can_ids:
            require_can_id(can_id)


QUEUE_FRAMES: Final = 1000
"""Most frames of a party that wait while the bus has no room; an assumption."""
RECEIVED_FRAMES: Final = 256
"""Most frames that wait for a paused process: about the default 208 KiB of a socket on Linux; an
assumption."""


class Transmitter:
    """Applies the disturbances to the frames of one party."""

    __slots__ = ("_held", "_postponed", "bus")

    def __init__(self, bus: FaultyBus) -> None:
        self.bus = bus
        self._held: list[tuple[int, Frame]] = []
        self._postponed: list[Frame] = []

    def passed(self, frames: Iterable[Frame]) -> list[Frame]:
        """Return the frames that reach the bus when a party sends `frames`."""
        if not (self.bus.disturbed or self._held or self._postponed):
            return list(frames)
        out = self._due()
        for frame in frames:
            sent = self._disturb(frame)
            if sent is None:
                continue
            out += sent
            out += self._postponed
            self._postponed = []
        return self._fitting(out)

    def _due(self) -> list[Frame]:
        cycle = self.bus.cycle
        due = [frame for when, frame in self._held if when <= cycle]
        self._held = [(when, frame) for when, frame in self._held if when > cycle]
        return due

    def _disturb(self, frame: Frame) -> list[Frame] | None:
        """Return the frames sent now in place of one; None if it follows the next one."""
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
            if frame_fault is FrameFault.REORDERING and not self._postponed:
                self._postponed.append(frame)
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
        """Queue for the next cycle the frames for which a babbling node leaves no room.

        Frames are lost when the queue of the party is full.
        """
        out = []
        for frame in frames:
            if self.bus.has_room(frame):
                out.append(frame)
            elif len(self._held) < QUEUE_FRAMES:
                self._held.append((self.bus.cycle + 1, frame))
        return out


class _Controller:
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
        Node, started by `start`.
    transmitter
        Transmitter for the frames of the node.
    lockstep
        Whether SYNC is its clock, also after a pause; otherwise time passes during a pause.
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

    def __init__(self, node: HostedNode, transmitter: Transmitter, lockstep: bool) -> None:
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
        """Receive a frame from the bus if power, process and controller allow it."""
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
        """Return an empty list: segments directly follow their request."""
        return []

    def shutdown(self) -> list[Frame]:
        """Leave the plate at 0 V."""
        return self._sent(self.node.shutdown()) if self.powered else []

    def catch_up(self) -> list[Frame]:
        """Resume after a pause, with the frames and the time that were missed.

        In real time, time and overdue timers come before the frames, as for a separate process.
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
        """Receive frames, each with the knowledge of the newer ones that wait."""
        out: list[Frame] = []
        if not (self.powered and self.connected):
            return out
        for at, frame in enumerate(frames, 1):
            overtaken = is_overtaken(frame, frames[at:])
            out += self._sent(self.node.overtaken(frame) if overtaken else self._receive(frame))
        return out

    def clog(self, until: int) -> None:
        """Refuse frames until a cycle of the bus; they wait in the outbox of the node."""
        self._controller.full_until = until
        self._outbox = Outbox(self.node, self._controller, lambda _reason: None)

    def bus_off(self) -> None:
        """Leave the bus; the frames of the node for this are lost."""
        self.node.bus_off()
        self.connected = False

    def bus_recovered(self) -> list[Frame]:
        """Rejoin the bus; return the frames of the node for this."""
        self.connected = True
        return self._sent(self.node.bus_recovered())

    def _sent(self, frames: list[Frame]) -> list[Frame]:
        """Return the frames that reach the bus when the node sends `frames`."""
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


class _DisturbedConnection(Connection):
    __slots__ = ("_transmitter",)

    def __init__(
        self, bus: FaultyBus, receive: Callable[[Frame], None], transmitter: Transmitter
    ) -> None:
        super().__init__(bus, receive, None, False)
        self._transmitter = transmitter

    def send(self, frame: Frame) -> None:
        """Send a frame, subject to the disturbances."""
        self._bus._send(self, self._transmitter.passed((frame,)))


class FaultyBus(LocalBus):
    """A `LocalBus` with faults; at first there are none.

    Frames are disturbed before they reach the bus, so the log holds what every party could receive.
    Faults of nodes are addressed by the port of the node.

    Parameters
    ----------
    seed
        Seed of all random draws.
    log, wire
        As for `LocalBus`.

    Attributes
    ----------
    disturbances
        Disturbances in force; only the first one that affects a frame is applied.
    """

    def __init__(
        self,
        seed: int = 1,
        *,
        log: LogHook | None = None,
        wire: Wire | None = None,
    ) -> None:
        super().__init__(tick=TICK_US, log=log, wire=wire)
        self.random = random.Random(seed)
        self.disturbances: list[Disturbance] = []
        self.cycle = 0
        self._stations: dict[Connection, Station] = {}
        self._babbler: Connection | None = None
        self._babble = Frame(0)
        self._babble_time = 0
        self._room = 0

    @property
    def disturbed(self) -> bool:
        """Whether frames may be disturbed now."""
        return bool(self.disturbances) or self._babbler is not None

    def attach(  # type: ignore[override] # faults need all methods of a node
        self, node: HostedNode, *, lockstep: bool = True
    ) -> Connection:
        """Attach a node and switch it on; see `LocalBus.attach`."""
        station = Station(node, Transmitter(self), lockstep)
        port = super().attach(station, lockstep=lockstep)
        self._stations[port] = station
        return port

    def connect(self, listener: Callable[[Frame], None]) -> Connection:
        """Connect a party; its frames may be disturbed as well."""
        port = _DisturbedConnection(self, listener, Transmitter(self))
        self._add(port)
        return port

    def power_off(self, port: Connection) -> None:
        """Cut the power of a node: it sends nothing more, and its output is at 0 V."""
        station = self._stations[port]
        if station.powered:
            station.node.shutdown()
            station.powered = False

    def power_on(self, port: Connection) -> None:
        """Restore the power of a node; it starts as after power-on."""
        station = self._stations[port]
        station.powered = True
        self._send(port, station.start())

    def pause(self, port: Connection) -> None:
        """Pause the process of a node: it receives nothing, and its time stands still."""
        self._stations[port].paused = True

    def resume(self, port: Connection) -> None:
        """Resume a process with what it missed: time before frames, unless in lockstep."""
        self._send(port, self._stations[port].catch_up())

    def clog(self, port: Connection, cycles: int) -> None:
        """Let a node's CAN controller refuse frames for some cycles, 1 or more.

        The frames wait in an `Outbox`, which informs the node.
        """
        if cycles < 1:
            raise ValueError(f"cycles {cycles} is below 1")
        self._stations[port].clog(self.cycle + cycles)

    def bus_off(self, port: Connection) -> None:
        """Disconnect a node's CAN controller from the bus; its host notices."""
        self._stations[port].bus_off()

    def bus_recovered(self, port: Connection) -> None:
        """Reconnect the CAN controller of a node to the bus."""
        self._send(port, self._stations[port].bus_recovered())

    def stop_clock(self, port: Connection) -> None:
        """Stop the clock of a node; it still receives frames."""
        self._stations[port].clock_runs = False

    def start_clock(self, port: Connection) -> None:
        """Let the clock of a node go on from where it stopped."""
        self._stations[port].clock_runs = True

    def jump(self, port: Connection, microseconds: int) -> None:
        """Advance the clock of a node at once, by 0 or more us.

        Raises
        ------
        ValueError
            If it is below 0.
        """
        if microseconds < 0:
            raise ValueError(f"microseconds {microseconds} is below 0")
        self._send(port, self._stations[port].advance(microseconds))

    def babble(self, frames: int, can_id: int = 0x001) -> None:
        """Let a faulty node send 8 bytes that many times in every cycle; 0 ends it.

        Frames of a lower priority that no longer fit into a cycle wait for the next one. SYNC is
        never delayed here; use `FrameFault.LOSS` to lose it.

        Raises
        ------
        ValueError
            If `frames` is below 0, or `can_id` is outside 0..7FFh.
        """
        if frames < 0:
            raise ValueError(f"frames {frames} is below 0")
        require_can_id(can_id)
        if self._babbler is not None:
            self._babbler.close()
            self._babbler = None
        if not frames:
            return
        self._babble = Frame(can_id, bytes(8))
        self._babble_time = frames * self._durations[8]
        self._room = max(0, self._tick - self._babble_time)

        def answer(frame: Frame) -> list[Frame]:
            return [self._babble] * frames if frame.can_id == cia.SYNC_ID else []

        self._babbler = Connection(self, answer, None, False)
        self._add(self._babbler)

    def has_room(self, frame: Frame) -> bool:
        """Return whether a frame still fits into this cycle, and count it."""
        if self._babbler is None or frame.can_id in (cia.SYNC_ID, self._babble.can_id):
            return True
        if frame.can_id < self._babble.can_id:
            return True
        self._room -= self._durations[len(frame.data)]
        return self._room >= 0

    def _pass_time(self, microseconds: int) -> None:
        super()._pass_time(microseconds)
        self.cycle = self._tick_end // self._tick
        self._room = max(0, self._tick - self._babble_time)
