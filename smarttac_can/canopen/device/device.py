"""A CANopen device without input or output: it takes frames and time, and returns frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, ClassVar, Final

from smarttac_can.canopen.device.emcy import Emergency, EmergencyConsumer, ErrorBehaviour
from smarttac_can.canopen.device.error_control import (
    Guarding,
    HeartbeatConsumer,
    HeartbeatProducer,
    Losses,
)
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.lss import LSS
from smarttac_can.canopen.device.nmt import ALL_STATES, COMMANDS, NMTState
from smarttac_can.canopen.device.pdo import ProcessData
from smarttac_can.canopen.device.port import Clock, Identifiers, Port
from smarttac_can.canopen.device.sdo import SDOServer
from smarttac_can.canopen.device.service import Access, Application, Service
from smarttac_can.canopen.device.storage import Memory, ParameterStorage, Storage
from smarttac_can.canopen.device.sync import Sync, TimeStamp
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import DataType, EmergencyCode, ErrorRegister
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry

_NO_AUTOSTART: Final = 4
_COMMAND_BYTES: Final = 2


GONE_AFTER_US: Final = 3_000_000
"""Time in us without frames after which the other device counts as gone: three periods of 1 s."""


class Collision(Service):
    """Detect another device that sends with identifiers of this device.

    A bus does not return a sender its own frames. Remote frames are ignored: they request a frame,
    and any node may send them.

    Parameters
    ----------
    services
        Function that returns the services whose identifiers are supervised.

    Attributes
    ----------
    can_id
        Identifier with which the other device was detected, 0 without such a device.
    """

    states: ClassVar = ALL_STATES

    def __init__(
        self,
        port: Port,
        od: ObjectDictionary,
        application: Application,
        services: Callable[[], Iterable[Service]],
    ) -> None:
        super().__init__(port, od, ())
        self._application = application
        self._services = services
        self._timer = port.clock.timer(self._on_silence)
        self.can_id = 0

    def cease(self) -> None:
        """Clear the detection, as in a reset."""
        self._timer.stop()
        self.can_id = 0

    def listen(self) -> None:
        """Listen to the identifiers with which only this device may send."""
        for can_id in sorted({can_id for service in self._services() for can_id in service.sends}):
            self.port.listen(can_id, self._receive)

    def _receive(self, frame: Frame) -> None:
        if frame.rtr:
            return
        self._timer.start(GONE_AFTER_US)
        if not self.can_id:
            self.can_id = frame.can_id
            self._application.on_collision(True)

    def _on_silence(self) -> None:
        self.can_id = 0
        self._application.on_collision(False)


_CODES = range(1, 1 << 16)
_REGISTERS = range(1 << 8)


class Device:
    """A CiA 301 device, built from an object dictionary.

    The objects in the EDS determine its services. It does not read a clock: `advance` moves its
    time.

    Parameters
    ----------
    od
        Object dictionary from `load_eds`; the device owns its values from now on.
    application
        Application hooks; None for a device that only communicates.
    autostart
        Whether to enter OPERATIONAL after power-on and reset node without an NMT command. Bit 2 of
        object 1F80h does the same if the object exists and the bit is 0.
    storage
        Storage of the parameters; None to keep them only as long as the device exists.
    node_id
        Node-ID. 1..127 overrides a stored node-ID. 255 uses the stored one, and waits for LSS
        without one. None uses the stored one, or else that of `od`.
    clock
        Device time, if the application has timers of its own; its timers fire before those made
        later.
    loop_tpdos
        Numbers of the TPDOs that belong to a control loop.
    loop_rpdos
        Numbers of the RPDOs that are passed to `Application.on_loop_rpdo` as bytes.
    emergencies_of
        Node-ID, 1..127, whose emergency messages are passed to the application; 0 for none.

    Attributes
    ----------
    clock
        Device time, and the time at which the next timer expires.
    nmt_state
        Present NMT state; INITIALISING before `start`.
    ids
        CAN-IDs of the device; replaced by a new object when they change.
    """

    def __init__(
        self,
        od: ObjectDictionary,
        application: Application | None = None,
        *,
        autostart: bool = False,
        storage: Storage | None = None,
        node_id: int | None = None,
        clock: Clock | None = None,
        loop_tpdos: tuple[int, ...] = (),
        loop_rpdos: tuple[int, ...] = (),
        emergencies_of: int = 0,
    ) -> None:
        if node_id is not None and not (
            1 <= node_id <= cia.LAST_NODE_ID or node_id == cia.UNCONFIGURED
        ):
            raise ValueError(f"node_id {node_id} is outside 1..127 and not {cia.UNCONFIGURED}")
        self.od = od
        application = application or Application()
        self._application = application
        self._node_id = node_id
        self.clock = clock or Clock()
        self._port = port = Port(self.clock)
        self._autostart = autostart
        self.nmt_state = NMTState.INITIALISING
        self._emergency = emergency = Emergency(port, od)
        self._storage = ParameterStorage(port, od, emergency, storage or Memory(), application)
        self._lss = LSS(port, od, self._storage, self._reset_node)
        self._time_stamp = TimeStamp(port, od)
        if (eds := od.get(cia.STORE_EDS)) is not None and eds.data_type == DataType.DOMAIN:
            eds.default = eds.value = od.text.encode("latin-1", "replace")
        self._heartbeat = heartbeat = HeartbeatProducer(port, od)
        self._collision = Collision(port, od, application, lambda: self._services)
        self._error_behaviour = ErrorBehaviour(port, od, self._enter)
        self._pdos = pdos = ProcessData(port, od, emergency, application, loop_tpdos, loop_rpdos)
        self._access = access = Access(od, application, self._take_parameters)
        servers = [i for i in od.objects if cia.SDO_SERVER_FIRST < i <= cia.SDO_SERVER_LAST]
        losses = Losses(emergency, application, self._error_behaviour.react)
        self._watches = HeartbeatConsumer(port, od, application, losses)
        self._guarding = Guarding(port, od, losses)
        # They enter a state in this order.
        # Emergency is first: errors that the others report while they cease are then queued.
        self._services: tuple[Service, ...] = (
            emergency,
            self._storage,
            self._lss,
            self._time_stamp,
            heartbeat,
            self._collision,
            self._error_behaviour,
            self._watches,
            EmergencyConsumer(port, od, application, emergencies_of),
            self._guarding,
            pdos.sync,
            *(SDOServer(port, od, index, access) for index in (cia.SDO_SERVER_FIRST, *servers)),
            *pdos.rpdos.values(),
            *pdos.tpdos.values(),
        )
        access.ask(self._services)
        self.ids = Identifiers()

    @property
    def node_id(self) -> int:
        """Node-ID, 1..127; 255 while the device has none."""
        return self._lss.node_id

    @property
    def sync(self) -> Sync:
        """Consumer or producer of SYNC."""
        return self._pdos.sync

    @property
    def bit_rate(self) -> int | None:
        """Bit rate in kbit/s that LSS has activated, None before; the host has to switch it."""
        return self._lss.bit_rate

    @property
    def storage_torn(self) -> bool:
        """Whether the stored parameters were invalid, so that the defaults apply."""
        return self._storage.torn

    @property
    def collision(self) -> int:
        """Identifier of this device that another device has used, 0 for none; see `Collision`."""
        return self._collision.can_id

    @property
    def supervised_in_time(self) -> frozenset[int]:
        """Node-IDs of the supervised nodes whose heartbeat is in time."""
        return self._watches.in_time

    @property
    def guarded(self) -> bool:
        """Whether a master guards this node, so that a loss of the master would be detected."""
        return self._guarding.timer.running

    @property
    def time(self) -> int | None:
        """Time since 1984-01-01 in us; None before the first TIME."""
        return self._time_stamp.microseconds

    def start(self) -> list[Frame]:
        """Power on."""
        self._storage.load()
        fixed = self._node_id not in (None, cia.UNCONFIGURED)
        default = self.od.node_id if self._node_id is None else self._node_id
        self._lss.load(default if fixed else self._storage.image.node_id or default)
        self._reset_node()
        return self._port.take()

    def receive(self, frame: Frame) -> list[Frame]:
        """Take a frame from the bus and return the frames it causes."""
        port = self._port
        handlers = port.listeners.get(frame.can_id)
        if handlers is None:
            return []
        for handler in handlers:
            handler(frame)
        return port.take() if port.out else []

    def advance(self, microseconds: int) -> list[Frame]:
        """Advance time by 0 or more us; each timer fires at most once. Return the frames due."""
        self.clock.advance(microseconds)
        port = self._port
        return port.take() if port.out else []

    def segments(self, most: int) -> list[Frame]:
        """Return up to ``most`` next frames of transfers that only the bus limits.

        Empty if there are none. These are the segments of SDO block uploads. They are available
        from the request for them until the end of their transfer. If they are never requested, the
        transfer times out.
        """
        return self._port.segments(most)

    def timer_frames(self) -> dict[int, Frame]:
        """Return the frames that timers would send now, by CAN-ID: heartbeat, and timed TPDOs."""
        frames = [
            self._heartbeat.timer_frame(),
            *[tpdo.timer_frame() for tpdo in self._pdos.tpdos.values()],
        ]
        return {frame.can_id: frame for frame in frames if frame is not None}

    def take(self) -> list[Frame]:
        """Return the frames that `trigger` and `emergency` have caused outside of the hooks."""
        return self._port.take()

    def carries(self, rpdo: int, entry: Entry) -> bool:
        """Return whether an RPDO, numbered from 1, is valid and has the entry in its mapping."""
        pdo = self._pdos.rpdos[rpdo]
        return pdo.valid and pdo.mapping is not None and entry in pdo.mapping.entries

    def in_time(self, rpdo: int) -> bool:
        """Return whether an RPDO, numbered from 1, has a deadline and is within it."""
        return self._pdos.rpdos[rpdo].deadline.running

    def heartbeat_level(self, ahead: int) -> float:
        """Return the largest elapsed fraction of the time-outs of supervised nodes and guarding.

        Parameters
        ----------
        ahead
            Time in us from now for which to compute it.
        """
        return self.clock.level((*self._watches.timers, self._guarding.timer), ahead)

    def rpdo_level(self, rpdos: tuple[int, ...], ahead: int) -> float:
        """Return the largest elapsed fraction of the deadlines of some RPDOs.

        Parameters
        ----------
        rpdos
            Numbers from 1.
        ahead
            Time in us from now for which to compute it.
        """
        return self.clock.level([self._pdos.rpdos[number].deadline for number in rpdos], ahead)

    def put(self, entry: Entry, value: Any) -> None:
        """Set a parameter that the application has chosen, without the checks of a write.

        Parameters
        ----------
        entry
            Entry of the object dictionary of the device.
        value
            Raw value, which must be valid for the entry.
        """
        self._access.put(entry, value)

    def trigger(self, tpdo: int) -> None:
        """Trigger a TPDO, numbered from 1; `TPDO.trigger` describes the effect for each type."""
        self._pdos.tpdos[tpdo].trigger()

    def emergency(self, code: int, register: int, vendor: bytes = b"") -> None:
        """Report an error of the application, unless it is already reported.

        Parameters
        ----------
        code
            Emergency error code, 1..65535.
        register
            Bits of the error register, 0..255; the generic bit is added.
        vendor
            Manufacturer-specific bytes, up to 5; the first two also go into the error history.

        Raises
        ------
        ValueError
            If one of them is outside its bounds.
        """
        if code not in _CODES:
            raise ValueError(f"code {code} is outside 1..65535")
        if register not in _REGISTERS:
            raise ValueError(f"register {register} is outside 0..255")
        if len(vendor) > cia.EMCY_VENDOR_BYTES:
            raise ValueError(f"vendor of {len(vendor)} bytes is outside 0..5")
        self._emergency.report(code, register, vendor)

    def clear_emergency(self, code: int) -> None:
        """Clear an error of the application; an error that was not reported has no effect."""
        self._emergency.clear(code)

    def bus_off(self) -> list[Frame]:
        """Record that the CAN controller went bus-off, which is a communication error."""
        self._error_behaviour.react()
        return self._port.take()

    def bus_recovered(self) -> list[Frame]:
        """Report that the CAN controller has recovered from bus-off."""
        self._emergency.report(EmergencyCode.BUS_OFF_RECOVERED, ErrorRegister.COMMUNICATION)
        self._emergency.clear(EmergencyCode.BUS_OFF_RECOVERED)
        return self._port.take()

    def _on_nmt(self, frame: Frame) -> None:
        """Enter the state that is commanded to this node or to all."""
        data = frame.data
        if (
            len(data) != _COMMAND_BYTES
            or data[0] not in COMMANDS
            or data[1] not in (0, self.node_id)
            or frame.rtr
        ):
            return
        state = COMMANDS[data[0]]
        if state in (NMTState.RESET_APPLICATION, NMTState.RESET_COMMUNICATION):
            self._initialise(state)
        elif self.nmt_state not in (state, NMTState.INITIALISING):
            self._enter(state)

    def _enter(self, state: NMTState) -> None:
        """Enter a lasting state."""
        self.nmt_state = state
        for service in self._services:
            service.enter(state)
        self._listen()
        self._application.on_state(state)

    def _reset_node(self) -> None:
        """Restart with the node-ID of LSS."""
        self._initialise(NMTState.RESET_APPLICATION)

    def _initialise(self, state: NMTState) -> None:
        power_on = state is NMTState.RESET_APPLICATION or self.nmt_state is NMTState.INITIALISING
        self.nmt_state = state
        for service in self._services:
            service.enter(state)
        self._lss.node_id = self._lss.pending
        if self._lss.node_id == cia.UNCONFIGURED:
            self._enter(NMTState.INITIALISING)
            return
        self.od.renumber(self._lss.node_id)
        first, last = (
            (0, cia.LAST_INDEX) if power_on else (cia.COMMUNICATION_FIRST, cia.COMMUNICATION_LAST)
        )
        self.od.reset(first, last)
        self._storage.restore(first, last)
        if power_on:
            self.nmt_state = NMTState.RESET_APPLICATION
            self._application.on_state(self.nmt_state)
        self.nmt_state = NMTState.RESET_COMMUNICATION
        self._application.on_state(self.nmt_state)
        self._storage.note_presets()
        for service in self._services:
            service.configure()
        self._heartbeat.boot_up()
        self._storage.report()
        self._enter(NMTState.PRE_OPERATIONAL)
        startup = self.od.number(cia.NMT_STARTUP, absent=_NO_AUTOSTART)
        if power_on and (self._autostart or not startup & _NO_AUTOSTART):
            self._enter(NMTState.OPERATIONAL)

    def _listen(self) -> None:
        # The host filters frames before the device sees an NMT command in front of them, so the
        # filter covers all NMT states. A device without node-ID has no other state.
        waiting = self.nmt_state is NMTState.INITIALISING
        self._register([service for service in self._services if service.alive or not waiting])
        heard = frozenset(self._port.listeners)
        self._register([service for service in self._services if service.alive])
        self._pdos.follow_parameters()
        sync, emcy = self.sync.can_id, self._emergency.can_id
        urgent = (sync, emcy, cia.HEARTBEAT_ID + self.od.node_id, *self._pdos.loop_ids)
        sent = frozenset(can_id for service in self._services for can_id in service.sends)
        self.ids = Identifiers(heard, frozenset(urgent), emcy, sent, sync)

    def _register(self, services: Iterable[Service]) -> None:
        self._port.listeners.clear()
        self._port.listen(cia.NMT_ID, self._on_nmt)
        for service in services:
            service.listen()

    def _take_parameters(self) -> None:
        self._listen()
        self._application.on_parameters()
