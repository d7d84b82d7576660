"""Receive PDOs: at once or latched until SYNC, with deadline (CiA 301, 7.2.2 and 7.5.2.35)."""

from __future__ import annotations

from typing import ClassVar

from smarttac_can.device.application import Application
from smarttac_can.device.emcy import Emergency
from smarttac_can.device.frame import Frame
from smarttac_can.device.mapping import Direction
from smarttac_can.device.pdo import PDO
from smarttac_can.device.port import Port
from smarttac_can.device.sync import Sync
from smarttac_can.od.cia import (
    CYCLIC_LAST,
    EVENT_MANUFACTURER,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    EmergencyCode,
    ErrorRegister,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry


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
        the object dictionary, and it is told by `on_rpdo`.

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
