"""A local bus on which frames and nodes go wrong, on purpose and the same way in every run."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import LogHook
from smarttac_can.host.frame_faults import Disturbance, FrameFault, require_can_id
from smarttac_can.host.local_bus import Connection, LocalBus, Wire
from smarttac_can.host.node import Node, without_queue
from smarttac_can.od.cia import SYNC_ID
from smarttac_can.vocabulary.signals import TICK_US

QUEUE_FRAMES: Final = 1000
"""Frames of a party that wait at most while the bus has no room; an assumption."""


class _Transmitter:
    """The way of one party's frames to the bus."""

    __slots__ = ("_behind", "_bus", "_held")

    def __init__(self, bus: FaultyBus) -> None:
        self._bus = bus
        self._held: list[tuple[int, Frame]] = []
        self._behind: list[Frame] = []

    def passed(self, frames: Iterable[Frame]) -> list[Frame]:
        """Return what becomes of the frames that a party sends now."""
        if not (self._bus.disturbed or self._held or self._behind):
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
        cycle = self._bus.cycle
        due = [frame for when, frame in self._held if when <= cycle]
        self._held = [(when, frame) for when, frame in self._held if when > cycle]
        return due

    def _disturb(self, frame: Frame) -> list[Frame] | None:
        """Return the frames sent now in place of one, None if it goes behind the next."""
        bus = self._bus
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
            if self._bus.has_room(frame):
                out.append(frame)
            elif len(self._held) < QUEUE_FRAMES:
                self._held.append((self._bus.cycle + 1, frame))
        return out


class _Station:
    """A node with its own power, clock and process."""

    __slots__ = ("_missed", "_receive", "clock_runs", "node", "paused", "powered", "transmitter")

    def __init__(self, node: Node, transmitter: _Transmitter) -> None:
        self.node = node
        self._receive = without_queue(node)
        self.transmitter = transmitter
        self.powered = True
        self.clock_runs = True
        self.paused = False
        self._missed: list[Frame | int] = []

    def start(self) -> list[Frame]:
        return self.transmitter.passed(self.node.start())

    def receive(self, frame: Frame) -> list[Frame]:
        if self.paused:
            self._missed.append(frame)
        elif self.powered:
            return self.transmitter.passed(self._receive(frame))
        return []

    def advance(self, microseconds: int) -> list[Frame]:
        if self.paused:
            self._missed.append(microseconds)
        elif self.powered:
            return self.transmitter.passed(
                self.node.advance(microseconds) if self.clock_runs else ()
            )
        return []

    def segments(self, most: int) -> list[Frame]:
        return []

    def shutdown(self) -> list[Frame]:
        return self.transmitter.passed(self.node.shutdown()) if self.powered else []

    def catch_up(self) -> list[Frame]:
        """Go on after a pause with all the frames and the time that came meanwhile."""
        self.paused = False
        missed, self._missed = self._missed, []
        out = []
        for item in missed:
            out += self.advance(item) if isinstance(item, int) else self.receive(item)
        return out


class _DisturbedConnection(Connection):
    """A place whose frames may go wrong."""

    __slots__ = ("_transmitter",)

    def __init__(
        self, bus: FaultyBus, receive: Callable[[Frame], None], transmitter: _Transmitter
    ) -> None:
        super().__init__(bus, receive, None, False)
        self._transmitter = transmitter

    def send(self, frame: Frame) -> None:
        """Send a frame, if nothing happens to it."""
        self._bus._send(self, self._transmitter.passed((frame,)))


class FaultyBus(LocalBus):
    """A `LocalBus` with faults, none at first.

    Frames go wrong on their way to the bus, so the log holds what everyone could hear. Nodes go
    wrong by their port.

    Parameters
    ----------
    seed
        Of everything that is drawn at random.
    sync_id, bit_rate, log, wire
        As for `LocalBus`.

    Attributes
    ----------
    disturbances
        Those in force; the first that befalls a frame is the only one.
    """

    def __init__(
        self,
        seed: int = 1,
        *,
        sync_id: int = SYNC_ID,
        bit_rate: int = 1_000_000,
        log: LogHook | None = None,
        wire: Wire | None = None,
    ) -> None:
        super().__init__(sync_id=sync_id, bit_rate=bit_rate, log=log, wire=wire)
        self.random = random.Random(seed)
        self.disturbances: list[Disturbance] = []
        self.cycle = 0
        self._stations: dict[Connection, _Station] = {}
        self._babbler: Connection | None = None
        self._babble = Frame(0)
        self._babble_time = 0
        self._room = 0

    @property
    def disturbed(self) -> bool:
        """Whether anything happens to frames now."""
        return bool(self.disturbances) or self._babbler is not None

    def attach(self, node: Node, *, lockstep: bool = True) -> Connection:
        """Plug in a node and switch it on; see `LocalBus.attach`."""
        station = _Station(node, _Transmitter(self))
        port = super().attach(station, lockstep=lockstep)
        self._stations[port] = station
        return port

    def connect(self, listener: Callable[[Frame], None]) -> Connection:
        """Plug in a party; what it sends may go wrong as well."""
        port = _DisturbedConnection(self, listener, _Transmitter(self))
        self._add(port)
        return port

    def power_off(self, port: Connection) -> None:
        """Cut a node's power: it says nothing more, and what it drives is at 0 V."""
        station = self._stations[port]
        if station.powered:
            station.node.shutdown()
            station.powered = False

    def power_on(self, port: Connection) -> None:
        """Give a node its power back; it starts as after power-on."""
        station = self._stations[port]
        station.powered = True
        self._send(port, station.start())

    def pause(self, port: Connection) -> None:
        """Stop a node's process: it neither hears nor ages."""
        self._stations[port].paused = True

    def resume(self, port: Connection) -> None:
        """Let a process go on: it takes all frames and all time that it missed, in order."""
        self._send(port, self._stations[port].catch_up())

    def stop_clock(self, port: Connection) -> None:
        """Stop a node's clock; it goes on hearing frames."""
        self._stations[port].clock_runs = False

    def start_clock(self, port: Connection) -> None:
        """Let a node's clock go on from where it stopped."""
        self._stations[port].clock_runs = True

    def jump(self, port: Connection, microseconds: int) -> None:
        """Put a node's clock forward at once, 0 or more us."""
        if microseconds < 0:
            raise ValueError(f"microseconds {microseconds} is below 0")
        self._send(port, self._stations[port].advance(microseconds))

    def answer(self, port: Connection, frames: Iterable[Frame]) -> None:
        """Send what a node says because of something that only its own host noticed."""
        self._send(port, self._stations[port].transmitter.passed(frames))

    def babble(self, frames: int, can_id: int = 0x001) -> None:
        """Have a broken node send 8 bytes that many times in every cycle; 0 ends it.

        Frames of a lower priority that no longer fit into a cycle wait for the next one. SYNC
        always passes here: that it does not is `FrameFault.LOSS`.
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
        self._room = max(0, TICK_US - self._babble_time)

        def answer(frame: Frame) -> list[Frame]:
            return [self._babble] * frames if frame.can_id == self._sync_id else []

        self._babbler = Connection(self, answer, None, False)
        self._add(self._babbler)

    def has_room(self, frame: Frame) -> bool:
        """Tell whether a frame still fits into this cycle; it is then taken into account."""
        if self._babbler is None or frame.can_id in (self._sync_id, self._babble.can_id):
            return True
        if frame.can_id < self._babble.can_id:
            return True
        self._room -= self._durations[len(frame.data)]
        return self._room >= 0

    def _pass_time(self, microseconds: int) -> None:
        super()._pass_time(microseconds)
        self.cycle = self._tick_end // TICK_US
        self._room = max(0, TICK_US - self._babble_time)
