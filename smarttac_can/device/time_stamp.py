"""TIME consumer (CiA 301, 7.2.6)."""

from __future__ import annotations

from typing import Any, ClassVar, Final

from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import CONFIGURABLE
from smarttac_can.device.port import Port
from smarttac_can.device.service import Service
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_EXTENDED,
    COB_TIME_CONSUMER,
    COB_TIME_PRODUCER,
    TIME_COB_ID,
    Abort,
    AbortCode,
    DataType,
    restricted,
)
from smarttac_can.od.data_types import SIZES
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry

_DAY_MS: Final = 86_400_000


class TimeStamp(Service):
    """Knows the time of day since it was told, by device time."""

    states: ClassVar = CONFIGURABLE

    def __init__(self, port: Port, od: ObjectDictionary) -> None:
        super().__init__(port, od, (TIME_COB_ID,))
        self._cob_id = 0
        self._told: int | None = None
        self._told_at = 0

    @property
    def microseconds(self) -> int | None:
        """Time since 1984-01-01 in us; None before the first TIME."""
        if self._told is None:
            return None
        return self._told + self.port.clock.now - self._told_at

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse another CAN-ID while in use, and the producer bit, as this device produces none.

        Raises
        ------
        Abort
            STATE for another CAN-ID while in use, VALUE for one that cannot be.
        """
        same = entry.value & CAN_ID_MASK == value & CAN_ID_MASK
        if entry.value & value & COB_TIME_CONSUMER and not same:
            raise Abort(AbortCode.STATE)
        can_id = value & (COB_EXTENDED - 1)
        if value & (COB_EXTENDED | COB_TIME_PRODUCER) or can_id > CAN_ID_MASK:
            raise Abort(AbortCode.VALUE)
        if restricted(can_id):
            raise Abort(AbortCode.VALUE)

    def configure(self) -> None:
        """Read the COB-ID; the time goes on."""
        self._cob_id = self.od.number(TIME_COB_ID)

    def listen(self) -> None:
        """Listen to the CAN-ID of TIME, if the consumer bit is set."""
        if self._cob_id & COB_TIME_CONSUMER:
            self.port.listen(self._cob_id & CAN_ID_MASK, self.receive)

    def receive(self, frame: Frame) -> None:
        """Take a TIME_OF_DAY: ms after midnight in 28 bits, days since 1984-01-01."""
        data = frame.data
        if len(data) != SIZES[DataType.TIME_OF_DAY] or frame.rtr:
            return
        milliseconds = int.from_bytes(data[:4], "little") & 0x0FFF_FFFF
        days = int.from_bytes(data[4:], "little")
        self._told = 1000 * (days * _DAY_MS + milliseconds)
        self._told_at = self.port.clock.now
