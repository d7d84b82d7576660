"""A local bus on which frames and nodes go wrong, on purpose and the same way in every run."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import LogHook
from smarttac_can.host.faulty_station import Station, Transmitter, WholeNode
from smarttac_can.host.frame_faults import Disturbance, require_can_id
from smarttac_can.host.local_bus import Connection, LocalBus, Wire
from smarttac_can.od.cia import SYNC_ID
from smarttac_can.vocabulary.signals import TICK_US


class _DisturbedConnection(Connection):
    """A place whose frames may go wrong."""

    __slots__ = ("_transmitter",)

    def __init__(
        self, bus: FaultyBus, receive: Callable[[Frame], None], transmitter: Transmitter
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
        self._stations: dict[Connection, Station] = {}
        self._babbler: Connection | None = None
        self._babble = Frame(0)
        self._babble_time = 0
        self._room = 0

    @property
    def disturbed(self) -> bool:
        """Whether anything happens to frames now."""
        return bool(self.disturbances) or self._babbler is not None

    def attach(  # type: ignore[override] # what goes wrong here is up to a node's host
        self, node: WholeNode, *, lockstep: bool = True
    ) -> Connection:
        """Plug in a node and switch it on; see `LocalBus.attach`."""
        station = Station(node, Transmitter(self), lockstep)
        port = super().attach(station, lockstep=lockstep)
        self._stations[port] = station
        return port

    def connect(self, listener: Callable[[Frame], None]) -> Connection:
        """Plug in a party; what it sends may go wrong as well."""
        port = _DisturbedConnection(self, listener, Transmitter(self))
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
        """Let a process go on with what it missed: time before frames, unless in lockstep."""
        self._send(port, self._stations[port].catch_up())

    def clog(self, port: Connection, cycles: int) -> None:
        """Have a node's CAN controller take no frames for some cycles, 1 or more.

        They wait in an `Outbox`, which tells the node.
        """
        if cycles < 1:
            raise ValueError(f"cycles {cycles} is below 1")
        self._stations[port].clog(self.cycle + cycles)

    def bus_off(self, port: Connection) -> None:
        """Have a node's CAN controller leave the bus, and its host notice."""
        self._stations[port].bus_off()

    def bus_recovered(self, port: Connection) -> None:
        """Have it be on the bus again."""
        self._send(port, self._stations[port].bus_recovered())

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
