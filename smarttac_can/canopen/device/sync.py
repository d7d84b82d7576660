"""SYNC producer and consumer, and TIME consumer (CiA 301, 7.2.5 and 7.2.6)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Final

from smarttac_can.canopen.device.emcy import Emergency
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import CONFIGURABLE
from smarttac_can.canopen.device.port import Port
from smarttac_can.canopen.device.service import Service, check_can_id, settable, usable
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, DataType, EmergencyCode, ErrorRegister
from smarttac_can.canopen.od.data_types import SIZES
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry


class Sync(Service):
    """Receive SYNC, or produce it and act on the produced SYNC.

    Parameters
    ----------
    on_sync
        Function that is called at every SYNC.

    Attributes
    ----------
    can_id
        CAN-ID of SYNC.
    counter
        Counter of the last SYNC, 0 if it carries none.
    own
        Whether this device produced the last SYNC.

    Notes
    -----
    After a SYNC that was late by more than a quarter of the period, the next one follows a whole
    period later, so that the nodes have time to answer each one.
    """

    states: ClassVar = CONFIGURABLE

    def __init__(
        self,
        port: Port,
        od: ObjectDictionary,
        emergency: Emergency,
        on_sync: Callable[[], None],
    ) -> None:
        super().__init__(
            port, od, (cia.SYNC_COB_ID, cia.SYNC_PERIOD, cia.SYNC_COUNTER, cia.SYNC_WINDOW)
        )
        self._emergency = emergency
        self._on_sync = on_sync
        self._timer = port.clock.timer(self._produce)
        self.can_id = cia.SYNC_ID
        self.counter = 0
        self.own = False
        self._usable = True
        self._produces = False
        self._period = 0
        self._overflow = 0
        self._counter = 0
        self._wrong_length = False
        self._window = 0
        self._heard = 0

    @property
    def missed(self) -> int:
        """Number of periods that were missed before the last SYNC that it produced."""
        return self._timer.missed

    @property
    def due(self) -> int:
        """Device time in us of the next SYNC that it produces; `NEVER` if it is no producer."""
        return self._timer.due

    @property
    def produces(self) -> bool:
        """Whether it produces SYNC: the producer bit and a period are set."""
        return self._produces and self._period > 0

    @property
    def sends(self) -> tuple[int, ...]:
        """CAN-ID of SYNC, if it is the producer."""
        return (self.can_id,) if self.produces else ()

    @property
    def window_open(self) -> bool:
        """Whether synchronous RPDOs are accepted: within the SYNC window, or without a window."""
        return not self._window or self.port.clock.now - self._heard <= self._window

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse changes of COB-ID and counter that CiA 301 forbids while they are in use.

        Raises
        ------
        Abort
            STATE for another CAN-ID of a producer, or another counter while there is a period;
            VALUE for a value out of range.
        """
        if entry.index == cia.SYNC_COB_ID:
            same = entry.value & cia.CAN_ID_MASK == value & cia.CAN_ID_MASK
            produces = entry.value & value & cia.COB_SYNC_PRODUCER
            if produces and not same and settable(entry, entry.value & ~cia.COB_SYNC_PRODUCER):
                raise Abort(AbortCode.STATE)
            check_can_id(value)
        elif entry.index == cia.SYNC_COUNTER and value != entry.value:
            if self._period and settable(self.od.get(cia.SYNC_PERIOD), 0):
                raise Abort(AbortCode.STATE)
            if value == 1 or value > cia.SYNC_COUNTER_LAST:
                raise Abort(AbortCode.VALUE)

    def apply(self, entry: Entry) -> None:
        """Apply a new period or producer bit; the counter continues unless it was written."""
        self.configure()
        if entry.index == cia.SYNC_COUNTER:
            self._counter = 0
        if entry.index != cia.SYNC_WINDOW:
            self._start_or_stop()

    def configure(self) -> None:
        """Read COB-ID, period and window in us, and the overflow value of the counter."""
        cob_id = self.od.number(cia.SYNC_COB_ID, absent=cia.SYNC_ID)
        self.can_id = cob_id & cia.CAN_ID_MASK
        self._usable = usable(cob_id)
        self._produces = bool(cob_id & cia.COB_SYNC_PRODUCER) and self._usable
        self._period = self.od.number(cia.SYNC_PERIOD)
        self._overflow = self.od.number(cia.SYNC_COUNTER)
        self._window = self.od.number(cia.SYNC_WINDOW)

    def begin(self) -> None:
        """Reset the counter, so that it starts at 1, and start to produce SYNC if enabled."""
        self._counter = 0
        self._start_or_stop()

    def cease(self) -> None:
        """Stop producing SYNC."""
        self._timer.stop()

    def listen(self) -> None:
        """Listen to the CAN-ID of SYNC, unless the EDS has one of another service there."""
        if self._usable:
            self.port.listen(self.can_id, self.receive)

    def receive(self, frame: Frame) -> None:
        """Take a SYNC; a SYNC of the wrong length is ignored and reported."""
        data = frame.data
        if frame.rtr:
            return
        if len(data) != (1 if self._overflow else 0):
            self._wrong_length = True
            self._emergency.report(
                EmergencyCode.SYNC_LENGTH, ErrorRegister.COMMUNICATION, bytes((len(data),))
            )
            return
        if self._wrong_length:
            self._wrong_length = False
            self._emergency.clear(EmergencyCode.SYNC_LENGTH)
        self._act(data[0] if data else 0, own=False)

    def _start_or_stop(self) -> None:
        if self.alive and self.produces:
            spacing = self._period - self._period // 4
            self._timer.start(self._period, periodic=True, spacing=spacing)
        else:
            self._timer.stop()

    def _produce(self) -> None:
        if self._overflow:
            self._counter = self._counter % self._overflow + 1
            self.port.out.append(Frame(self.can_id, bytes((self._counter,))))
        else:
            self.port.out.append(Frame(self.can_id))
        self._act(self._counter, own=True)

    def _act(self, counter: int, own: bool) -> None:
        self._heard = self.port.clock.now
        self.counter = counter
        self.own = own
        self._on_sync()


_DAY_MS: Final = 86_400_000


class TimeStamp(Service):
    """Keep the time of day, by device time, from the last TIME message on."""

    states: ClassVar = CONFIGURABLE

    def __init__(self, port: Port, od: ObjectDictionary) -> None:
        super().__init__(port, od, (cia.TIME_COB_ID,))
        self._cob_id = 0
        self._received: int | None = None
        self._received_at = 0

    @property
    def microseconds(self) -> int | None:
        """Time since 1984-01-01 in us; None before the first TIME."""
        if self._received is None:
            return None
        return self._received + self.port.clock.now - self._received_at

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse another CAN-ID while in use, and the producer bit, which is not supported.

        Raises
        ------
        Abort
            STATE for another CAN-ID while in use, VALUE for an invalid COB-ID.
        """
        same = entry.value & cia.CAN_ID_MASK == value & cia.CAN_ID_MASK
        consumes = entry.value & value & cia.COB_TIME_CONSUMER
        if consumes and not same and settable(entry, entry.value & ~cia.COB_TIME_CONSUMER):
            raise Abort(AbortCode.STATE)
        if value & cia.COB_TIME_PRODUCER:
            raise Abort(AbortCode.VALUE)
        check_can_id(value)

    def configure(self) -> None:
        """Read the COB-ID; the time continues."""
        self._cob_id = self.od.number(cia.TIME_COB_ID)

    def listen(self) -> None:
        """Listen to the CAN-ID of TIME, if the consumer bit is set."""
        if self._cob_id & cia.COB_TIME_CONSUMER:
            self.port.listen(self._cob_id & cia.CAN_ID_MASK, self.receive)

    def receive(self, frame: Frame) -> None:
        """Take a TIME message: ms after midnight in 28 bits, days since 1984-01-01."""
        data = frame.data
        if len(data) != SIZES[DataType.TIME_OF_DAY] or frame.rtr:
            return
        milliseconds = int.from_bytes(data[:4], "little") & 0x0FFF_FFFF
        days = int.from_bytes(data[4:], "little")
        self._received = 1000 * (days * _DAY_MS + milliseconds)
        self._received_at = self.port.clock.now
