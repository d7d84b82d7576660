"""What the PDOs of a node carry, as the node itself says over SDO."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_INVALID,
    FRAME_BYTES,
    PDO_COB_ID,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
    DataType,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry

PUBLIC: Final = range(1, 5)
"""Numbers of the PDOs between a stimulator and its masters; the others are those of the loop."""
_FORMATS: Final = {
    DataType.BOOLEAN: "B",
    DataType.INTEGER8: "b",
    DataType.INTEGER16: "h",
    DataType.INTEGER32: "i",
    DataType.UNSIGNED8: "B",
    DataType.UNSIGNED16: "H",
    DataType.UNSIGNED32: "I",
}


class PublishedPdo:
    """A valid PDO of a node: its CAN-ID, what it maps, and the data that came last.

    Parameters
    ----------
    number
        Number of the PDO from 1.
    can_id
        CAN-ID it is sent with.
    entries
        The mapped entries in order, integers of 8, 16 or 32 bits.

    Attributes
    ----------
    layout
        Of its data.
    received
        Time in s at which data came last; None before.
    """

    def __init__(self, number: int, can_id: int, entries: list[Entry]) -> None:
        self.number = number
        self.can_id = can_id
        self.names = [entry.name for entry in entries]
        self.layout = struct.Struct("<" + "".join(_FORMATS[entry.data_type] for entry in entries))
        self._size, self._unpack = self.layout.size, self.layout.unpack
        self.values: tuple[int, ...] = ()
        self.received: float | None = None

    def take(self, data: bytes | bytearray, now: float) -> bool:
        """Take received data; of a length that is not the mapping's, return False."""
        if len(data) != self._size:
            return False
        self.values = self._unpack(data)
        self.received = now
        return True


def published_pdos(od: ObjectDictionary, read: Callable[[Entry], int]) -> list[PublishedPdo]:
    """Ask a node what its public TPDOs carry.

    Parameters
    ----------
    od
        The EDS of the node.
    read
        Reads an entry from the node over SDO.

    Returns
    -------
    list of PublishedPdo
        The valid ones that map only integers the EDS knows, by number.
    """
    return _pdos(od, read, TPDO_COMMUNICATION, TPDO_MAPPING)


def commanded_pdos(od: ObjectDictionary, read: Callable[[Entry], int]) -> list[PublishedPdo]:
    """Ask a node what the RPDOs of its master carry, as `published_pdos` does of its TPDOs."""
    return _pdos(od, read, RPDO_COMMUNICATION, RPDO_MAPPING)


def _pdos(
    od: ObjectDictionary, read: Callable[[Entry], int], communication: int, mapping: int
) -> list[PublishedPdo]:
    pdos = []
    for number in PUBLIC:
        cob_id = read(od.entry(communication + number - 1, PDO_COB_ID))
        if cob_id & COB_INVALID:
            continue
        record = mapping + number - 1
        count = read(od.entry(record, 0))
        if count > FRAME_BYTES:
            # More than a frame has bytes, or a multiplexed PDO.
            continue
        mapped = [read(od.entry(record, position)) for position in range(1, count + 1)]
        entries = [od.get(value >> 16, value >> 8 & 0xFF) for value in mapped]
        known = [entry for entry in entries if entry is not None and entry.data_type in _FORMATS]
        # What a device says may be anything: a PDO that fits no frame is none.
        if known and len(known) == count and sum(entry.size for entry in known) <= FRAME_BYTES:
            pdos.append(PublishedPdo(number, cob_id & CAN_ID_MASK, known))
    return pdos
