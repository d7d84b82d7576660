"""What RPDO and TPDO share: the communication parameter record and the mapping record."""

from __future__ import annotations

from typing import Any, ClassVar

from smarttac_can.device.mapping import Direction, Mapping, check_mapping, compile_mapping
from smarttac_can.device.nmt import OPERATIONAL_ONLY
from smarttac_can.device.port import Port
from smarttac_can.device.service import Service, check_cob_id
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_INVALID,
    CYCLIC_LAST,
    PDO_COB_ID,
    PDO_COUNT,
    PDO_EVENT,
    PDO_INHIBIT,
    PDO_SYNC_START,
    PDO_TRANSMISSION,
    Abort,
    AbortCode,
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
