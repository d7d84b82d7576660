"""PDOs, sent and received, with all transmission types (CiA 301, 7.2.2, 7.5.2.35 and 7.5.2.37)."""

from __future__ import annotations

from typing import Any, ClassVar

from smarttac_can.device.emcy import Emergency
from smarttac_can.device.frame import Frame
from smarttac_can.device.mapping import Direction, Mapping, check_mapping, compile_mapping
from smarttac_can.device.nmt import OPERATIONAL_ONLY
from smarttac_can.device.port import Port
from smarttac_can.device.service import Application, Service, check_cob_id
from smarttac_can.device.sync import Sync
from smarttac_can.od.cia import (
    ACYCLIC,
    CAN_ID_MASK,
    COB_INVALID,
    COB_NO_RTR,
    CYCLIC_LAST,
    EVENT_MANUFACTURER,
    EVENT_PROFILE,
    PDO_COB_ID,
    PDO_COUNT,
    PDO_EVENT,
    PDO_INHIBIT,
    PDO_SYNC_START,
    PDO_TRANSMISSION,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    RTR_SYNC,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
    Abort,
    AbortCode,
    EmergencyCode,
    ErrorRegister,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry


class PDO(Service):
    """One process data object.

    Attributes
    ----------
    number
        From 1.
    valid
        Whether it is enabled and its mapping can be resolved.
    transmission
        Transmission type.
    """

    states: ClassVar = OPERATIONAL_ONLY
    direction: ClassVar[Direction]
    first_event_type: ClassVar[int]
    """Transmission types between the last cyclic one and this are reserved."""

    records: ClassVar[tuple[int, int]]
    """Communication and mapping record of the first one."""

    def __init__(self, port: Port, od: ObjectDictionary, number: int) -> None:
        communication, mapping = self.records
        super().__init__(port, od, (communication + number - 1, mapping + number - 1))
        self.number = number
        self.valid = False
        self.transmission = 0
        self.cob_id = COB_INVALID
        self.can_id = 0
        self.event_time = 0
        self.mapping: Mapping | None = None

    @classmethod
    def numbers(cls, od: ObjectDictionary) -> list[int]:
        """Return the numbers of those that the EDS has."""
        return [
            number + 1 for number in range(PDO_COUNT)
            if all(first + number in od.objects for first in cls.records)
        ]  # fmt: skip

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse what the standard forbids while the PDO is valid, and reserved values."""
        mapping = self.objects[1]
        if entry.index == mapping:
            check_mapping(self.od, entry, value, self.direction, valid=self.valid)
        elif entry.subindex == PDO_COB_ID:
            check_cob_id(entry.value, value)
            if not value & COB_INVALID:
                compile_mapping(self.od, mapping, self.direction)
        elif entry.subindex == PDO_TRANSMISSION:
            if CYCLIC_LAST < value < self.first_event_type:
                raise Abort(AbortCode.VALUE)
        elif (
            entry.subindex in (PDO_INHIBIT, PDO_SYNC_START) and self.valid and value != entry.value
        ):
            raise Abort(AbortCode.STATE)

    def configure(self) -> None:
        """Read both records; a PDO whose mapping cannot be resolved becomes invalid."""
        communication, mapping = self.objects
        cob_id = self.od.entry(communication, PDO_COB_ID)
        try:
            self.mapping = compile_mapping(self.od, mapping, self.direction)
        except Abort:
            self.mapping = None
            cob_id.value |= COB_INVALID
        self.cob_id = cob_id.value
        self.can_id = self.cob_id & CAN_ID_MASK
        self.valid = not self.cob_id & COB_INVALID
        self.transmission = self.od.number(communication, PDO_TRANSMISSION)
        self.event_time = 1000 * self.od.number(communication, PDO_EVENT)


class RPDO(PDO):
    """One receive PDO.

    A PDO with any value outside the limits of its entry is ignored as a whole and reported as
    8200h (protocol error) with the PDO number, the index and the sub-index. A frame too short is
    ignored and reported as 8210h, of one too long the first bytes are used and 8220h is reported.
    Each error is taken back by the next PDO without it. A synchronous PDO that comes after the SYNC
    window has closed is dropped. A deadline is kept by values that are in force, not by frames:
    those of a synchronous PDO are at SYNC.

    Parameters
    ----------
    as_bytes
        Whether the application takes the bytes, by `on_loop_rpdo`; else their values are put into
        the object dictionary, and `on_rpdo` is called.

    Attributes
    ----------
    deadline
        Runs from one PDO to the next.
    """

    direction: ClassVar = Direction.RECEIVE
    first_event_type: ClassVar = EVENT_MANUFACTURER
    records: ClassVar = (RPDO_COMMUNICATION, RPDO_MAPPING)

    def __init__(
        self,
        port: Port,
        od: ObjectDictionary,
        number: int,
        *,
        emergency: Emergency,
        sync: Sync,
        application: Application,
        as_bytes: bool = False,
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
        """Whether it waits for SYNC."""
        return self.alive and self.valid and self.transmission <= CYCLIC_LAST

    @property
    def in_time(self) -> bool:
        """Whether it has a deadline, and is within it."""
        return self.deadline.running

    def apply(self, entry: Entry) -> None:
        """Take the new parameters; a deadline that was missed stays missed."""
        self._drop()
        self.configure()
        if not (self.alive and self.valid and self.event_time):
            self._end_deadline()

    def configure(self) -> None:
        """Read both records; another deadline counts from the last PDO, or is for the next."""
        super().configure()
        # From now on, whoever shortens it step by step would do the work of a PDO.
        self.deadline.follow(self.event_time)
        self.deadline.delay = self.event_time

    def cease(self) -> None:
        """Drop the values that wait for SYNC, and end the deadline; a missed one counts as over."""
        self._drop()
        self._end_deadline()

    def _end_deadline(self) -> None:
        self.deadline.stop()
        self._in_time()

    def _drop(self) -> None:
        self._latch = None
        for code in sorted(self._faults):
            self._settle(code)

    def listen(self) -> None:
        """Listen to the PDO's CAN-ID, if it is valid and carries something."""
        if self.valid and self.mapping is not None and self.mapping.size:
            self.port.listen(self.can_id, self.receive)

    def receive(self, frame: Frame) -> None:
        """Check length and limits of a received PDO; put it in force now or at the next SYNC."""
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
            self._settle(EmergencyCode.PROTOCOL)
        if self.transmission > CYCLIC_LAST:
            self._deliver(data)
        elif self._sync.window_open:
            self._latch = data

    def _judge_length(self, length: int, size: int) -> None:
        """Report a wrong length, and take back what the frame before was reported for."""
        lengths = bytes((length, size))
        if length >= size:
            self._settle(EmergencyCode.PDO_LENGTH)
        if length <= size:
            self._settle(EmergencyCode.PDO_LENGTH_EXCEEDED)
        if length < size:
            self._report(EmergencyCode.PDO_LENGTH, lengths)
        elif length > size:
            self._report(EmergencyCode.PDO_LENGTH_EXCEEDED, lengths)

    def on_sync(self) -> None:
        """Put what was latched in force."""
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
        if code not in self._faults:
            self._faults.add(code)
            vendor = self.number.to_bytes(2, "little") + vendor
            self._emergency.report(code, ErrorRegister.COMMUNICATION, vendor, self.number)

    def _settle(self, code: EmergencyCode) -> None:
        if code in self._faults:
            self._faults.remove(code)
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

    Type 254 goes out at every trigger, type 255 at a trigger that finds changed data; both also
    when the event timer elapses. Type 0 waits after a trigger for the next SYNC.
    """

    direction: ClassVar = Direction.TRANSMIT
    first_event_type: ClassVar = RTR_SYNC
    records: ClassVar = (TPDO_COMMUNICATION, TPDO_MAPPING)

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
        """Whether it has something to do at a SYNC."""
        return self._sends and (self.transmission <= CYCLIC_LAST or self.transmission == RTR_SYNC)

    @property
    def sends(self) -> tuple[int, ...]:
        """Its own, while it is valid."""
        return (self.can_id,) if self.valid else ()

    def unasked(self) -> Frame | None:
        """Return what the event timer would send now; None if there is none."""
        timed = self._sends and self.event_time and self.transmission >= EVENT_MANUFACTURER
        return Frame(self.can_id, self._sample()) if timed else None

    def configure(self) -> None:
        """Read inhibit time, SYNC start value, and what every PDO has."""
        super().configure()
        communication, _ = self.objects
        self._inhibit_time = 100 * self.od.number(communication, PDO_INHIBIT)
        self._start_value = self.od.number(communication, PDO_SYNC_START)

    def begin(self) -> None:
        """Start counting SYNCs and time; nothing goes out by itself yet."""
        self._sends = self.valid and self.mapping is not None and self.mapping.size > 0
        self._awaits_start = self._start_value != 0
        self._count = 0
        if self._sends and self.event_time and self.transmission >= EVENT_MANUFACTURER:
            self._event.start(self.event_time, periodic=True)

    def cease(self) -> None:
        """Send nothing any more, and forget events that wait."""
        self._sends = self._pending = False
        self._last = self._sampled = None
        self._event.stop()
        self._inhibit.stop()

    def listen(self) -> None:
        """Listen to remote frames, where the COB-ID allows them."""
        if self._sends and not self.cob_id & COB_NO_RTR:
            self.port.listen(self.can_id, self._on_remote)

    def trigger(self) -> None:
        """Take an event of the application: at once, at the next SYNC, or never, by the type.

        Types 254 and 255 send at once, or after the inhibit time; type 255 only if the data are
        new. Type 0 sends at the next SYNC. Types 1..240, 252 and 253 have no events.
        """
        if not self._sends or self.mapping is None:
            return
        transmission = self.transmission
        if transmission < EVENT_MANUFACTURER:
            self._pending = transmission == ACYCLIC
            return
        data = self.mapping.sample()
        if transmission == EVENT_PROFILE and data == self._last:
            return
        if self._inhibit_time and self._inhibit.running:
            self._pending = True
            return
        self._send(data)
        if self.event_time:
            self._event.restart()

    def on_sync(self, counter: int) -> None:
        """Sample and send if it is this PDO's turn.

        Parameters
        ----------
        counter
            Of the SYNC, 0 where SYNC carries none; then the start value is not looked at.
        """
        transmission = self.transmission
        if transmission == ACYCLIC:
            if self._pending:
                self._pending = False
                self._send(self._sample())
            return
        if transmission == RTR_SYNC:
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
        if self._pending and self.transmission >= EVENT_MANUFACTURER:
            self._pending = False
            self._send(self._sample())

    def _on_remote(self, frame: Frame) -> None:
        if not frame.rtr:
            return
        if self.transmission == RTR_SYNC and self._sampled is not None:
            self._send(self._sampled)
        else:
            self._send(self._sample())


class ProcessData:
    """The PDOs of a device, and SYNC, which puts RPDOs in force and samples TPDOs.

    Parameters
    ----------
    loop_tpdos, loop_rpdos
        As for `Device`.

    Attributes
    ----------
    sync
        Consumer or producer of SYNC.
    rpdos, tpdos
        Those that the EDS has, by number.
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
        """Find anew which PDOs have something to do at SYNC."""
        self._latching = [rpdo for rpdo in self.rpdos.values() if rpdo.synchronous]
        self._sampling = [tpdo for tpdo in self.tpdos.values() if tpdo.synchronous]

    def _on_sync(self) -> None:
        for rpdo in self._latching:
            rpdo.on_sync()
        if self._application.on_sync():
            counter = self.sync.counter
            for tpdo in self._sampling:
                tpdo.on_sync(counter)
