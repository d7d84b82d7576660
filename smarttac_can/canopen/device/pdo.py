"""PDOs, sent and received, with all transmission types (CiA 301, 7.2.2, 7.5.2.35 and 7.5.2.37)."""

from __future__ import annotations

from typing import Any, ClassVar

from smarttac_can.canopen.device.emcy import Emergency
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.mapping import Direction, Mapping, check_mapping, compile_mapping
from smarttac_can.canopen.device.nmt import OPERATIONAL_ONLY
from smarttac_can.canopen.device.port import Port
from smarttac_can.canopen.device.service import Application, Service, check_cob_id, settable, usable
from smarttac_can.canopen.device.sync import Sync
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, EmergencyCode, ErrorRegister
from smarttac_can.canopen.od.data_types import bounds
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry


class PDO(Service):
    """One process data object.

    Attributes
    ----------
    number
        Number, from 1.
    valid
        Whether the PDO is enabled and its mapping is valid.
    transmission
        Transmission type.
    """

    states: ClassVar = OPERATIONAL_ONLY
    direction: ClassVar[Direction]
    first_event_type: ClassVar[int]
    """Lowest event-driven type; the types between the last cyclic one and this one are reserved."""

    records: ClassVar[tuple[int, int]]
    """Communication and mapping record of PDO 1."""

    def __init__(self, port: Port, od: ObjectDictionary, number: int) -> None:
        communication, mapping = self.records
        super().__init__(port, od, (communication + number - 1, mapping + number - 1))
        self.number = number
        self.valid = False
        self.transmission = 0
        self.cob_id = cia.COB_INVALID
        self.can_id = 0
        self.event_time = 0
        self.mapping: Mapping | None = None

    @classmethod
    def numbers(cls, od: ObjectDictionary) -> list[int]:
        """Return the numbers of the PDOs in the EDS."""
        return [
            number + 1
            for number in range(cia.PDO_COUNT)
            if od.get(cls.records[0] + number, cia.PDO_COB_ID)
            and cls.records[1] + number in od.objects
        ]

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse reserved values, and changes that the standard forbids while the PDO is valid."""
        communication, mapping = self.objects
        cob_id = self.od.entry(communication, cia.PDO_COB_ID)
        in_use = self.valid and settable(cob_id, cob_id.value | cia.COB_INVALID)
        if entry.index == mapping:
            check_mapping(self.od, entry, value, self.direction, in_use=in_use)
        elif entry.subindex == cia.PDO_COB_ID:
            check_cob_id(entry, value)
            if not value & cia.COB_INVALID:
                compile_mapping(self.od, mapping, self.direction)
        elif entry.subindex == cia.PDO_TRANSMISSION:
            if cia.CYCLIC_LAST < value < self.first_event_type:
                raise Abort(AbortCode.VALUE)
        elif (
            entry.subindex in (cia.PDO_INHIBIT, cia.PDO_SYNC_START)
            and in_use
            and value != entry.value
        ):
            raise Abort(AbortCode.STATE)

    def configure(self) -> None:
        """Read both records; a PDO with an invalid mapping or CAN-ID becomes invalid."""
        communication, mapping = self.objects
        cob_id = self.od.entry(communication, cia.PDO_COB_ID)
        try:
            self.mapping = compile_mapping(self.od, mapping, self.direction)
        except Abort:
            self.mapping = None
        self.cob_id = cob_id.value
        if self.mapping is None or not usable(self.cob_id):
            self.cob_id |= cia.COB_INVALID
            cob_id.value = min(self.cob_id, int(bounds(cob_id.data_type)[1]))
        self.can_id = self.cob_id & cia.CAN_ID_MASK
        self.valid = not self.cob_id & cia.COB_INVALID
        self.transmission = self.od.number(communication, cia.PDO_TRANSMISSION)
        self.event_time = 1000 * self.od.number(communication, cia.PDO_EVENT)


class RPDO(PDO):
    """One receive PDO.

    A PDO with a value outside the limits of its entry is ignored as a whole, and 8200h (protocol
    error) is reported with the PDO number, the index and the sub-index. A frame that is too short
    is ignored and reported as 8210h. Of a frame that is too long the first bytes are used, and
    8220h is reported. The next PDO without an error clears it. A synchronous PDO that arrives after
    the SYNC window has closed is dropped. The deadline restarts when values take effect, not when a
    frame arrives: for a synchronous PDO this is at SYNC.

    Parameters
    ----------
    as_bytes
        Whether the application takes the bytes in `on_loop_rpdo`. Otherwise the values are written
        to the object dictionary, and `on_rpdo` is called.

    Attributes
    ----------
    deadline
        Timer that runs from one PDO to the next.
    """

    direction: ClassVar = Direction.RECEIVE
    first_event_type: ClassVar = cia.EVENT_MANUFACTURER
    records: ClassVar = (cia.RPDO_COMMUNICATION, cia.RPDO_MAPPING)

    def __init__(
        self,
        port: Port,
        od: ObjectDictionary,
        number: int,
        *,
        emergency: Emergency,
        sync: Sync,
        application: Application,
        as_bytes: bool,
    ) -> None:
        super().__init__(port, od, number)
        self._as_bytes = as_bytes
        self._emergency = emergency
        self._sync = sync
        self._application = application
        self.deadline = port.clock.timer(self._on_deadline)
        self._late = False
        self._faults: set[EmergencyCode] = set()
        self._latch: bytes | None = None

    @property
    def synchronous(self) -> bool:
        """Whether the PDO takes effect at SYNC."""
        return self.alive and self.valid and self.transmission <= cia.CYCLIC_LAST

    def apply(self, entry: Entry) -> None:
        """Apply new parameters; a missed deadline stays missed."""
        self._drop()
        self.configure()
        if not (self.alive and self.valid and self.event_time):
            self._end_deadline()

    def configure(self) -> None:
        """Read both records; a changed deadline counts from the last PDO, or from the next."""
        super().configure()
        # Without a new start, as shortening it step by step would otherwise replace a PDO.
        self.deadline.follow(self.event_time)
        self.deadline.delay = self.event_time

    def cease(self) -> None:
        """Drop the values that wait for SYNC, and end the deadline; a missed one is cleared."""
        self._drop()
        self._end_deadline()

    def _end_deadline(self) -> None:
        self.deadline.stop()
        self._in_time()

    def _drop(self) -> None:
        self._latch = None
        for code in sorted(self._faults):
            self._clear(code)

    def listen(self) -> None:
        """Listen to the CAN-ID of the PDO, if it is valid and has content."""
        if self.valid and self.mapping is not None and self.mapping.size:
            self.port.listen(self.can_id, self.receive)

    def receive(self, frame: Frame) -> None:
        """Check length and limits of a received PDO; apply it now or at the next SYNC."""
        mapping = self.mapping
        if frame.rtr or mapping is None:
            return
        data = frame.data
        size = mapping.size
        if len(data) != size or self._faults:
            self._judge_length(len(data), size)
            if len(data) < size:
                return
            data = data[:size]
        if mapping.bounded:
            broken = mapping.broken(data)
            if broken is not None:
                self._report(EmergencyCode.PROTOCOL, _where(broken))
                return
        if self._faults:
            self._clear(EmergencyCode.PROTOCOL)
        if self.transmission > cia.CYCLIC_LAST:
            self._deliver(data)
        elif self._sync.window_open:
            self._latch = data

    def _judge_length(self, length: int, size: int) -> None:
        """Report a wrong length, and clear the length errors that no longer apply."""
        lengths = bytes((length, size))
        if length >= size:
            self._clear(EmergencyCode.PDO_LENGTH)
        if length <= size:
            self._clear(EmergencyCode.PDO_LENGTH_EXCEEDED)
        if length < size:
            self._report(EmergencyCode.PDO_LENGTH, lengths)
        elif length > size:
            self._report(EmergencyCode.PDO_LENGTH_EXCEEDED, lengths)

    def on_sync(self) -> None:
        """Apply the values that wait for SYNC."""
        data, self._latch = self._latch, None
        if data is not None:
            self._deliver(data)

    def _deliver(self, data: bytes) -> None:
        if self.mapping is None:
            return
        if self.event_time:
            self.deadline.restart()
            if self._late:
                self._in_time()
        if self._as_bytes:
            self._application.on_loop_rpdo(self.number, data)
        else:
            self.mapping.write(data)
            self._application.on_rpdo(self.number)

    def _report(self, code: EmergencyCode, vendor: bytes) -> None:
        self._faults.add(code)
        vendor = self.number.to_bytes(2, "little") + vendor
        self._emergency.report(code, ErrorRegister.COMMUNICATION, vendor, self.number)

    def _clear(self, code: EmergencyCode) -> None:
        self._faults.discard(code)
        self._emergency.clear(code, self.number)

    def _in_time(self) -> None:
        if self._late:
            self._late = False
            self._emergency.clear(EmergencyCode.RPDO_TIME_OUT, self.number)
            self._application.on_rpdo_timeout(self.number, False)

    def _on_deadline(self) -> None:
        self._late = True
        self._emergency.report(
            EmergencyCode.RPDO_TIME_OUT,
            ErrorRegister.COMMUNICATION,
            self.number.to_bytes(2, "little"),
            self.number,
        )
        self._application.on_rpdo_timeout(self.number, True)


def _where(entry: Entry) -> bytes:
    return entry.index.to_bytes(2, "little") + bytes((entry.subindex,))


class TPDO(PDO):
    """One transmit PDO.

    Type 254 is sent at every trigger, type 255 at a trigger with changed data; both are also sent
    when the event timer elapses. After a trigger, type 0 is sent at the next SYNC.
    """

    direction: ClassVar = Direction.TRANSMIT
    first_event_type: ClassVar = cia.RTR_SYNC
    records: ClassVar = (cia.TPDO_COMMUNICATION, cia.TPDO_MAPPING)

    def __init__(self, port: Port, od: ObjectDictionary, number: int) -> None:
        super().__init__(port, od, number)
        self._event = port.clock.timer(self._on_event_timer)
        self._inhibit = port.clock.timer(self._on_inhibit_end)
        self._inhibit_time = 0
        self._start_value = 0
        self._sends = False
        self._pending = False
        self._awaits_start = False
        self._count = 0
        self._last: bytes | None = None
        self._sampled: bytes | None = None

    @property
    def synchronous(self) -> bool:
        """Whether the PDO is sent or sampled at SYNC."""
        return self._sends and (
            self.transmission <= cia.CYCLIC_LAST or self.transmission == cia.RTR_SYNC
        )

    @property
    def sends(self) -> tuple[int, ...]:
        """CAN-ID of the PDO, while it is valid."""
        return (self.can_id,) if self.valid else ()

    def timer_frame(self) -> Frame | None:
        """Return the frame that the event timer would send now; None without one."""
        timed = self._sends and self.event_time and self.transmission >= cia.EVENT_MANUFACTURER
        return Frame(self.can_id, self._sample()) if timed else None

    def configure(self) -> None:
        """Read both records, the inhibit time and the SYNC start value."""
        super().configure()
        communication, _ = self.objects
        self._inhibit_time = 100 * self.od.number(communication, cia.PDO_INHIBIT)
        self._start_value = self.od.number(communication, cia.PDO_SYNC_START)

    def begin(self) -> None:
        """Start the event timer and the count of SYNCs, without sending yet."""
        self._sends = self.valid and self.mapping is not None and self.mapping.size > 0
        self._awaits_start = self._start_value != 0
        self._count = 0
        if self._sends and self.event_time and self.transmission >= cia.EVENT_MANUFACTURER:
            self._event.start(self.event_time, periodic=True)

    def cease(self) -> None:
        """Stop sending, and clear pending events."""
        self._sends = self._pending = False
        self._last = self._sampled = None
        self._event.stop()
        self._inhibit.stop()

    def listen(self) -> None:
        """Listen to remote frames, if the COB-ID allows them."""
        if self._sends and not self.cob_id & cia.COB_NO_RTR:
            self.port.listen(self.can_id, self._on_remote)

    def trigger(self) -> None:
        """Take an event of the application, and send the PDO according to its type.

        Types 254 and 255 are sent immediately, or after the inhibit time; type 255 only if the data
        have changed. Type 0 is sent at the next SYNC. Types 1..240, 252 and 253 ignore events.
        """
        if not self._sends or self.mapping is None:
            return
        transmission = self.transmission
        if transmission < cia.EVENT_MANUFACTURER:
            self._pending = transmission == cia.ACYCLIC
            return
        data = self.mapping.sample()
        if transmission == cia.EVENT_PROFILE and data == self._last:
            return
        if self._inhibit_time and self._inhibit.running:
            self._pending = True
            return
        self._send(data)
        if self.event_time:
            self._event.restart()

    def on_sync(self, counter: int) -> None:
        """Sample the PDO, and send it if it is due at this SYNC.

        Parameters
        ----------
        counter
            Counter of the SYNC; 0 if it carries none, the start value is then ignored.
        """
        transmission = self.transmission
        if transmission == cia.ACYCLIC:
            if self._pending:
                self._pending = False
                self._send(self._sample())
            return
        if transmission == cia.RTR_SYNC:
            self._sampled = self._sample()
            return
        if self._awaits_start and counter:
            if counter != self._start_value:
                return
            self._awaits_start = False
        self._count += 1
        if self._count >= transmission:
            self._count = 0
            self._send(self._sample())

    def _sample(self) -> bytes:
        return b"" if self.mapping is None else self.mapping.sample()

    def _send(self, data: bytes) -> None:
        self._last = data
        self.port.out.append(tuple.__new__(Frame, (self.can_id, data, False)))
        if self._inhibit_time:
            self._inhibit.start(self._inhibit_time)

    def _on_event_timer(self) -> None:
        if self._inhibit.running:
            self._pending = True
        else:
            self._send(self._sample())

    def _on_inhibit_end(self) -> None:
        if self._pending and self.transmission >= cia.EVENT_MANUFACTURER:
            self._pending = False
            self._send(self._sample())

    def _on_remote(self, frame: Frame) -> None:
        if not frame.rtr:
            return
        if self.transmission == cia.RTR_SYNC and self._sampled is not None:
            self._send(self._sampled)
        else:
            self._send(self._sample())


class ProcessData:
    """The PDOs of a device, and SYNC, at which RPDOs take effect and TPDOs are sampled.

    Parameters
    ----------
    loop_tpdos, loop_rpdos
        As for `Device`.

    Attributes
    ----------
    sync
        Consumer or producer of SYNC.
    rpdos, tpdos
        PDOs in the EDS, by number.
    """

    def __init__(
        self,
        port: Port,
        od: ObjectDictionary,
        emergency: Emergency,
        application: Application,
        loop_tpdos: tuple[int, ...],
        loop_rpdos: tuple[int, ...],
    ) -> None:
        self._application = application
        self.sync = Sync(port, od, emergency, self._on_sync)
        self.rpdos = {
            n: RPDO(
                port, od, n, emergency=emergency, sync=self.sync, application=application,
                as_bytes=n in loop_rpdos,
            )
            for n in RPDO.numbers(od)
        }  # fmt: skip
        self.tpdos = {n: TPDO(port, od, n) for n in TPDO.numbers(od)}
        self._loop = [self.tpdos[number] for number in loop_tpdos]
        self._latching: list[RPDO] = []
        self._sampling: list[TPDO] = []

    @property
    def loop_ids(self) -> list[int]:
        """CAN-IDs of the valid TPDOs of the loop."""
        return [tpdo.can_id for tpdo in self._loop if tpdo.valid]

    def follow_parameters(self) -> None:
        """Update which PDOs act at SYNC."""
        self._latching = [rpdo for rpdo in self.rpdos.values() if rpdo.synchronous]
        self._sampling = [tpdo for tpdo in self.tpdos.values() if tpdo.synchronous]

    def _on_sync(self) -> None:
        for rpdo in self._latching:
            rpdo.on_sync()
        if self._application.on_sync():
            counter = self.sync.counter
            for tpdo in self._sampling:
                tpdo.on_sync(counter)
