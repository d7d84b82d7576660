"""A CAN bus inside one process: no threads, no waiting, the same bits in every run."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from smarttac_can.canopen.bus.bus import BusError, LogHook
from smarttac_can.canopen.bus.node import Node
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.timing import frame_bits

_STORM_FRAMES = 100_000
_MAX_DATA_BYTES = 8
_SEGMENTS = 127
"""Frames of an SDO transfer taken at a time: those of one block."""

_Receive = Callable[[Frame], list[Frame] | None]
_Hearers = tuple[tuple["Connection", _Receive], ...]


class Wire(Protocol):
    """Carrier of the frames between the parties of a `LocalBus`, one frame at a time."""

    def connect(self, port: Connection) -> None:
        """Connect a party."""

    def disconnect(self, port: Connection) -> None:
        """Disconnect a party."""

    def put(self, port: Connection, frame: Frame) -> None:
        """Accept a frame from its sender."""

    def get(self, port: Connection) -> Frame:
        """Return the last frame as another party receives it; called once per party."""


class Connection:
    """Connection of a party to a `LocalBus`, from `LocalBus.connect` or `LocalBus.attach`."""

    __slots__ = ("_bus", "_lockstep", "_node", "_others", "_receive", "_ticked")

    def __init__(self, bus: LocalBus, receive: _Receive, node: Node | None, lockstep: bool) -> None:
        self._bus = bus
        self._receive = receive
        self._node = node
        self._lockstep = lockstep
        self._others: _Hearers = ()
        self._ticked: _Hearers = ()

    def send(self, frame: Frame) -> None:
        """Send a frame to all other parties; return when no frames are left.

        During a delivery the frame is queued behind the waiting ones.

        Raises
        ------
        ValueError
            If there are more than 8 data bytes.
        BusError
            If the parties answer each other endlessly.
        """
        size = len(frame.data)
        if size > _MAX_DATA_BYTES:
            raise ValueError(f"{size} data bytes are outside 0..{_MAX_DATA_BYTES}")
        self._bus._send(self, (frame,))

    def close(self) -> None:
        """Disconnect: the party neither receives nor sends from now on."""
        self._bus._remove(self)


class LocalBus:
    """A bus that delivers frames in the order of their causes, at once and without threads.

    Time passes only when a SYNC reaches a node in lockstep, and by `advance`. Both move the timers
    of the nodes and the clock of the bus. In addition, the clock counts the longest duration of
    each frame on the bus, so a time stamp is the end of a frame.

    Parameters
    ----------
    bit_rate
        Bit rate in bit/s, above 0; used only for the time stamps.
    tick
        Time in us, above 0, by which a SYNC advances the nodes in lockstep.
    log
        Function called with the time stamp in us and the frame, for every frame.
    wire
        Carrier of the frames; None for direct delivery.

    Attributes
    ----------
    time
        Time on the bus in us since its creation; never decreases.
    """

    def __init__(
        self,
        *,
        bit_rate: int = 1_000_000,
        tick: int = 1000,
        log: LogHook | None = None,
        wire: Wire | None = None,
    ) -> None:
        if bit_rate <= 0:
            raise ValueError(f"bit_rate {bit_rate} is not above 0")
        if tick <= 0:
            raise ValueError(f"tick {tick} is not above 0")
        self._tick = tick
        self._log = log
        self._wire = wire
        # Rounded up, because a time stamp is a worst case.
        self._durations = [
            -(-frame_bits(n) * 1_000_000 // bit_rate) for n in range(_MAX_DATA_BYTES + 1)
        ]
        self.time = 0
        self._tick_end = 0
        self._lockstep = 0
        self._ports: list[Connection] = []
        self._queue: deque[tuple[Connection, Sequence[Frame]]] = deque()
        self._draining = False

    def attach(self, node: Node, *, lockstep: bool = True) -> Connection:
        """Attach a node and switch it on.

        Parameters
        ----------
        node
            Node to start now; its boot-up message goes to the parties that are already there.
        lockstep
            If True, the timers of the node advance by one tick just before it receives the SYNC of
            another party. If False, they advance only by `advance`, and SYNC is an ordinary frame;
            for nodes that have their own clock, or produce the SYNC.
        """
        port = Connection(self, node.receive, node, lockstep)
        self._add(port)
        self._send(port, node.start())
        return port

    def connect(self, listener: Callable[[Frame], None]) -> Connection:
        """Connect a party: it receives every frame of the others, and sends through its port."""
        port = Connection(self, listener, None, False)
        self._add(port)
        return port

    def advance(self, microseconds: int) -> None:
        """Let time pass for every node without a SYNC, tick by tick.

        Parameters
        ----------
        microseconds
            Time in us, 0 or more. If it is not a multiple of the tick, the last step is shorter.

        Raises
        ------
        ValueError
            If it is below 0.
        """
        if microseconds < 0:
            raise ValueError(f"microseconds {microseconds} is below 0")
        while microseconds > 0:
            step = min(microseconds, self._tick)
            microseconds -= step
            self._pass_time(step)
            for port in tuple(self._ports):
                if port._node is not None:
                    self._enqueue(port, port._node.advance(step))
            self._drain()

    def shutdown(self) -> None:
        """Shut down all nodes in the order of attachment, and deliver their frames."""
        for port in tuple(self._ports):
            if port._node is not None:
                self._send(port, port._node.shutdown())

    def _add(self, port: Connection) -> None:
        self._ports.append(port)
        if self._wire is not None:
            self._wire.connect(port)
        self._link_ports()

    def _remove(self, port: Connection) -> None:
        if port in self._ports:
            self._ports.remove(port)
            if self._wire is not None:
                self._wire.disconnect(port)
            self._link_ports()

    def _link_ports(self) -> None:
        # Computed once here, not at every delivery.
        for port in self._ports:
            others = [p for p in self._ports if p is not port]
            port._others = tuple([(p, p._receive) for p in others])
            port._ticked = tuple([(p, _receive_tick(p, self._tick)) for p in others])
        self._lockstep = sum(port._lockstep for port in self._ports)

    def _pass_time(self, microseconds: int) -> None:
        self._tick_end += microseconds
        self.time = max(self.time, self._tick_end)

    def _send(self, sender: Connection, frames: Sequence[Frame]) -> None:
        self._enqueue(sender, frames)
        self._drain()

    def _enqueue(self, sender: Connection, frames: Sequence[Frame]) -> None:
        if sender in self._ports:
            self._queue.append((sender, frames))

    def _drain(self) -> None:
        if self._draining:
            return
        self._draining = True
        queue = self._queue
        durations, log = self._durations, self._log
        wire = self._wire
        quiet = _STORM_FRAMES
        try:
            while queue or self._stream():
                sender, frames = queue.popleft()
                quiet -= len(frames)
                if quiet < 0:
                    raise BusError(f"no rest on the local bus after {_STORM_FRAMES} frames")
                for frame in frames:
                    hearers = sender._others
                    if frame.can_id == cia.SYNC_ID and self._lockstep:
                        hearers = sender._ticked
                        self._pass_time(self._tick)
                        quiet = _STORM_FRAMES
                    self.time += durations[len(frame.data)]
                    if log is not None:
                        log(self.time, frame)
                    if wire is not None:
                        wire.put(sender, frame)
                    for port, receive in hearers:
                        replies = receive(frame if wire is None else wire.get(port))
                        if replies:
                            queue.append((port, replies))
        finally:
            # After an error no frame of this delivery may appear in the next one.
            queue.clear()
            self._draining = False

    def _stream(self) -> bool:
        """Queue the next segments when no other frame waits; return whether there are any.

        Without segments the bus comes to rest.
        """
        for port in self._ports:
            if port._node is not None:
                frames = port._node.segments(_SEGMENTS)
                if frames:
                    self._queue.append((port, frames))
        return bool(self._queue)


def _receive_tick(port: Connection, tick: int) -> _Receive:
    """Return the function with which a party receives a SYNC: in lockstep its timers advance."""
    node = port._node
    if node is None or not port._lockstep:
        return port._receive
    advance, receive = node.advance, port._receive
    return lambda frame: [*advance(tick), *(receive(frame) or ())]
