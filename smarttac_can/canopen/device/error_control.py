"""Error control: heartbeat producer and consumer, node and life guarding (CiA 301, 7.2.8.3.2)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Final

from smarttac_can.canopen.device.emcy import Emergency
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import ALL_STATES
from smarttac_can.canopen.device.port import Port
from smarttac_can.canopen.device.service import Application, Service
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, EmergencyCode, ErrorRegister
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry

_STATE: Final = 0x7F


def supervised_node(watch: int) -> int:
    """Return the node-ID that an entry of the heartbeat consumer supervises, 0 for none."""
    node_id, time = watch >> 16 & 0xFF, watch & 0xFFFF
    return node_id if time and node_id <= cia.LAST_NODE_ID else 0


class HeartbeatProducer(Service):
    """Send the NMT state every producer time, and immediately when that time is written.

    After a reset the boot-up message counts as the first one.
    """

    states: ClassVar = ALL_STATES
    begins_anew: ClassVar = True

    def __init__(self, port: Port, od: ObjectDictionary) -> None:
        super().__init__(port, od, (cia.HEARTBEAT_PRODUCER,))
        self._timer = port.clock.timer(self._send)
        self._period = 0

    @property
    def sends(self) -> tuple[int, ...]:
        """CAN-ID of error control, which node guarding also uses."""
        return (cia.HEARTBEAT_ID + self.od.node_id,)

    def boot_up(self) -> None:
        """Send the boot-up message, a heartbeat with the value 0."""
        self.port.out.append(Frame(cia.HEARTBEAT_ID + self.od.node_id, cia.BOOT_UP))

    def timer_frame(self) -> Frame | None:
        """Return the next heartbeat with the present state; None without a producer time."""
        return self._made() if self._period else None

    def apply(self, entry: Entry) -> None:
        """Restart with the written producer time, and send a heartbeat immediately."""
        super().apply(entry)
        if self._period:
            self._send()

    def configure(self) -> None:
        """Read the producer time in ms; 0 disables the heartbeat."""
        self._period = 1000 * self.od.number(cia.HEARTBEAT_PRODUCER)

    def begin(self) -> None:
        """Send a heartbeat every producer time from now on."""
        if self._period:
            self._timer.start(self._period, periodic=True)

    def cease(self) -> None:
        """Stop the heartbeat."""
        self._timer.stop()

    def _send(self) -> None:
        self.port.out.append(self._made())

    def _made(self) -> Frame:
        return Frame(cia.HEARTBEAT_ID + self.od.node_id, bytes((self.state,)))


class Losses:
    """Report the loss of a supervised node by EMCY 8130h, and clear it when the node is back.

    Parameters
    ----------
    react
        Function called at a loss, after the application.
    """

    def __init__(
        self, emergency: Emergency, application: Application, react: Callable[[], None]
    ) -> None:
        self._emergency = emergency
        self._application = application
        self._react = react

    def report(self, node_id: int) -> None:
        """Report that a node is silent; node-ID 0 is the master that guards this node."""
        self._emergency.report(
            EmergencyCode.ERROR_CONTROL, ErrorRegister.COMMUNICATION, bytes((node_id,)), node_id
        )
        self._application.on_error_control(node_id, True)
        self._react()

    def clear(self, node_id: int) -> None:
        """Clear the loss of a node, if it was reported."""
        if self._emergency.clear(EmergencyCode.ERROR_CONTROL, node_id):
            self._application.on_error_control(node_id, False)


class Monitor:
    """Supervision of one other node, from its first heartbeat on.

    Attributes
    ----------
    timer
        Timer that runs from one heartbeat to the next.
    """

    def __init__(
        self, port: Port, lost: Callable[[int], None], heard: Callable[[int, int], None]
    ) -> None:
        self.timer = port.clock.timer(self._expire)
        self._lost = lost
        self._heard = heard
        self.parameter = 0

    @property
    def node_id(self) -> int:
        """Node-ID of the supervised node; 0 or above 127 for none."""
        return self.parameter >> 16 & 0xFF

    @property
    def period(self) -> int:
        """Consumer time in us, 0 for none."""
        return 1000 * (self.parameter & 0xFFFF)

    def follow(self, parameter: int) -> None:
        """Set another consumer time for the same node, which counts from its last heartbeat."""
        self.parameter = parameter
        self.timer.follow(self.period)

    def receive(self, frame: Frame) -> None:
        """Take a heartbeat or boot-up message of the node."""
        if len(frame.data) == 1 and not frame.rtr:
            self.timer.start(self.period)
            self._heard(self.node_id, frame.data[0] & _STATE)

    def _expire(self) -> None:
        self._lost(self.node_id)


class HeartbeatConsumer(Service):
    """Supervise the heartbeats of other nodes.

    Attributes
    ----------
    timers
        Timers of the entries of the heartbeat consumer.
    """

    states: ClassVar = ALL_STATES

    def __init__(
        self, port: Port, od: ObjectDictionary, application: Application, losses: Losses
    ) -> None:
        super().__init__(port, od, (cia.HEARTBEAT_CONSUMER,))
        self._application = application
        self._losses = losses
        watched = od.objects.get(cia.HEARTBEAT_CONSUMER)
        entries = [] if watched is None else [e for s, e in watched.entries.items() if s]
        self._monitors = {e.subindex: Monitor(port, losses.report, self._heard) for e in entries}
        self.timers = [monitor.timer for monitor in self._monitors.values()]

    @property
    def in_time(self) -> frozenset[int]:
        """Supervised nodes whose heartbeat was received within the consumer time."""
        return frozenset(m.node_id for m in self._monitors.values() if m.timer.running)

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse reserved bits, and a second entry for the same node.

        Raises
        ------
        Abort
            VALUE for a reserved bit, PARAMETER for a node that another entry supervises.
        """
        if value >> 24:
            raise Abort(AbortCode.VALUE)
        node_id, period = value >> 16 & 0xFF, value & 0xFFFF
        others = [m for s, m in self._monitors.items() if s != entry.subindex and m.period]
        if (
            period
            and 1 <= node_id <= cia.LAST_NODE_ID
            and node_id in [other.node_id for other in others]
        ):
            raise Abort(AbortCode.PARAMETER)

    def apply(self, entry: Entry) -> None:
        """Apply one entry. Its supervision continues for the same node, and so do all others."""
        monitor = self._monitors[entry.subindex]
        value = entry.value
        if value & 0xFFFF and value >> 16 & 0xFF == monitor.node_id:
            monitor.follow(value)
            return
        monitor.timer.stop()
        if monitor.period and monitor.node_id:
            # An entry not in use has no loss to clear: that is another entry's, or with node-ID 0
            # the guarding master's.
            self._losses.clear(monitor.node_id)
        monitor.parameter = value

    def configure(self) -> None:
        """Read which nodes to supervise."""
        for subindex, monitor in self._monitors.items():
            monitor.parameter = self.od.entry(cia.HEARTBEAT_CONSUMER, subindex).value

    def cease(self) -> None:
        """Stop all supervision; each restarts with the next heartbeat of its node."""
        for monitor in self._monitors.values():
            monitor.timer.stop()

    def listen(self) -> None:
        """Listen to the heartbeats of the supervised nodes."""
        for monitor in self._monitors.values():
            if monitor.period and 1 <= monitor.node_id <= cia.LAST_NODE_ID:
                self.port.listen(cia.HEARTBEAT_ID + monitor.node_id, monitor.receive)

    def _heard(self, node_id: int, state: int) -> None:
        self._losses.clear(node_id)
        self._application.on_heartbeat(node_id, state)


_TOGGLE: Final = 0x80
_LIFE_GUARDING: Final = 0


class Guarding(Service):
    """Answer the master's remote frames with the NMT state, and detect when they stop.

    The first remote frame starts life guarding. EMCY 8130h is sent if none is received for the life
    time; the next remote frame clears it.

    Attributes
    ----------
    timer
        Timer that runs from one remote frame to the next.
    """

    states: ClassVar = ALL_STATES

    def __init__(self, port: Port, od: ObjectDictionary, losses: Losses) -> None:
        super().__init__(port, od, (cia.GUARD_TIME, cia.LIFE_TIME_FACTOR, cia.HEARTBEAT_PRODUCER))
        self._losses = losses
        self.timer = port.clock.timer(lambda: losses.report(_LIFE_GUARDING))
        self._toggle = 0
        self._active = False
        self._life_time = 0

    def configure(self) -> None:
        """Read the parameters; the guard time is in ms."""
        number = self.od.number
        supported = cia.GUARD_TIME in self.od.objects and cia.LIFE_TIME_FACTOR in self.od.objects
        self._active = supported and not number(cia.HEARTBEAT_PRODUCER)
        self._life_time = 1000 * number(cia.GUARD_TIME) * number(cia.LIFE_TIME_FACTOR)
        self._toggle = 0

    def apply(self, entry: Entry) -> None:
        """Apply new parameters; another life time counts from the last remote frame."""
        self.configure()
        if self.timer.running and self._active and self._life_time:
            self.timer.follow(self._life_time)
        else:
            super().apply(entry)

    def cease(self) -> None:
        """Stop life guarding, and wait for a first remote frame."""
        self.timer.stop()
        self._losses.clear(_LIFE_GUARDING)

    def listen(self) -> None:
        """Listen to remote frames that request the NMT state, unless the heartbeat is enabled."""
        if self._active:
            self.port.listen(cia.HEARTBEAT_ID + self.od.node_id, self.receive)

    def receive(self, frame: Frame) -> None:
        """Answer a remote frame with state and toggle bit, and restart the life time."""
        if not frame.rtr:
            return
        self.port.out.append(Frame(frame.can_id, bytes((self._toggle | self.state,))))
        self._toggle ^= _TOGGLE
        if self._life_time:
            self.timer.start(self._life_time)
            self._losses.clear(_LIFE_GUARDING)
