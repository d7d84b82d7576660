"""The frames between stimulator and plate: their PDOs, their check, and how both link up."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from struct import Struct
from typing import Final

from smarttac_can.device.mapping import Direction, compile_mapping
from smarttac_can.nodes.loop_time import set_deadline
from smarttac_can.od.cia import (
    COB_SYNC_PRODUCER,
    HEARTBEAT_CONSUMER,
    PDO_COB_ID,
    RPDO_COMMUNICATION,
    RPDO_IDS,
    RPDO_MAPPING,
    SYNC_COB_ID,
    SYNC_PERIOD,
    TPDO_COMMUNICATION,
    TPDO_IDS,
    TPDO_MAPPING,
    DataType,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.signals import TICK_US

_POLYNOMIAL: Final = 0x1D
_START: Final = 0xFF
_FORMATS: Final = {
    DataType.UNSIGNED8: "B",
    DataType.UNSIGNED16: "H",
    DataType.UNSIGNED32: "I",
    DataType.INTEGER16: "h",
}


def _table() -> bytes:
    table = bytearray()
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc << 1 ^ (_POLYNOMIAL if crc & 0x80 else 0)) & 0xFF
        table.append(crc)
    return bytes(table)


_TABLE: Final = _table()
_PAIRS: Final = b"".join(
    _TABLE.translate(bytes([_TABLE[byte ^ second] for byte in range(256)])) for second in range(256)
)
"""The same for two bytes at a time, by the second and the first."""
_INVERSE: Final = bytes(_TABLE.index(byte) for byte in range(256))
"""What the table was asked for."""
_SOUND: Final = _TABLE[0xFF] ^ 0xFF
"""Sum of bytes whose last one is that of those before."""


def crc8(data: bytes) -> int:
    """Return the CRC-8 of SAE J1850: x^8 + x^4 + x^3 + x^2 + 1, from FFh on, inverted at the end.

    One wrong bit, and wrong bits within 8 in a row, are always found.
    """
    crc = _START
    size = len(data)
    for pair in _pairs_of(size)(data):
        crc = _PAIRS[crc ^ pair]
    if size % 2:
        crc = _TABLE[crc ^ data[-1]]
    return crc ^ 0xFF


@cache
def _pairs_of(size: int) -> Callable[[bytes], tuple[int, ...]]:
    return Struct(f"<{size // 2}H").unpack_from


class CheckedFrames:
    """Layout of the frames of one drive, or of one measurement, whose last byte is a check sum.

    Parameters
    ----------
    mapped
        Integers in the order of the bus. The last one, an UNSIGNED8, is the check sum of the
        others, and of what is not sent.

    Attributes
    ----------
    entries
        Those without the check sum.
    check
        Entry of the check sum.
    unpack
        Returns the values in the concatenated bytes, the check sum last.
    """

    __slots__ = ("_mapped", "_pack", "check", "entries", "unpack")

    def __init__(self, mapped: Sequence[Entry]) -> None:
        self._mapped = mapped
        *entries, self.check = mapped
        self.entries = tuple(entries)
        # Little-endian, as a PDO.
        code = "<" + "".join([_FORMATS[entry.data_type] for entry in entries])
        self._pack: Callable[..., bytes] = Struct(code).pack
        self.unpack: Callable[[bytes], tuple[int, ...]] = Struct(f"{code}B").unpack

    def write_check(self, unsent: bytes = b"") -> None:
        """Set the check sum to that of the present values of the entries.

        Parameters
        ----------
        unsent
            Bytes that both ends know, and that the check sum covers, too.
        """
        body = self._pack(*[entry.value for entry in self.entries])
        self.check.value = crc8(body + unsent)

    def keep(self, values: tuple[int, ...]) -> None:
        """Set the entries to the values of all frames, the check sum last."""
        for entry, value in zip(self._mapped, values, strict=True):
            entry.value = value


def is_sound(data: bytes) -> bool:
    """Return whether the last byte is the check sum of those before, with nothing unsent."""
    return crc8(data) == _SOUND


def last_unsent(data: bytes, before: bytes) -> int:
    """Return the byte not sent that makes the last byte the sum, behind others that are known.

    There is exactly one: a sum that is wrong gives another.
    """
    return _INVERSE[data[-1] ^ 0xFF] ^ crc8(data[:-1] + before) ^ 0xFF


MEASUREMENT_TPDOS: Final = (1, 2, 3)
"""PDOs in which the plate sends a measurement."""
MEASUREMENT_RPDOS: Final = (5, 6, 7)
"""PDOs in which the stimulator receives it."""
DRIVE_TPDO: Final = 5
"""PDO in which the stimulator sends a drive."""
DRIVE_RPDO: Final = 1
"""PDO in which the plate receives it."""
HARDWARE_RPDO: Final = 2
"""PDO in which the plate hears hardware that watches its power stage; not valid by default."""
PLATE_RPDOS: Final = (DRIVE_RPDO, HARDWARE_RPDO)
"""All that the plate has."""

LATCHED: Final = 0x80
"""Added to the node-ID of a drive's sender while it is in FAULT."""


def sent_measurement(plate: ObjectDictionary) -> CheckedFrames:
    """Return what the plate puts into a measurement."""
    return _mapped(plate, TPDO_MAPPING, MEASUREMENT_TPDOS, Direction.TRANSMIT)


def received_measurement(stimulator: ObjectDictionary) -> CheckedFrames:
    """Return where the stimulator finds a measurement."""
    return _mapped(stimulator, RPDO_MAPPING, MEASUREMENT_RPDOS, Direction.RECEIVE)


def sent_drive(stimulator: ObjectDictionary) -> CheckedFrames:
    """Return what the stimulator puts into a drive."""
    return _mapped(stimulator, TPDO_MAPPING, (DRIVE_TPDO,), Direction.TRANSMIT)


def received_drive(plate: ObjectDictionary) -> CheckedFrames:
    """Return where the plate finds a drive."""
    return _mapped(plate, RPDO_MAPPING, (DRIVE_RPDO,), Direction.RECEIVE)


def _mapped(
    od: ObjectDictionary, mapping: int, numbers: tuple[int, ...], direction: Direction
) -> CheckedFrames:
    return CheckedFrames(
        [
            entry
            for number in numbers
            for entry in compile_mapping(od, mapping + number - 1, direction).entries
        ]
    )


_FIRST_SERIAL: Final = 1
"""That of the packaged EDS files."""
_FIRST_NODE_ID: Final = 33
_PLATE_HEARTBEAT_MS: Final = 2000
"""Four heartbeats of a plate that has not been configured."""


def plate_serial(entry: Entry, node_id: int) -> int:
    """Return the serial number of a plate, or that which its calibration is for.

    Parameters
    ----------
    entry
        Holds it; a default that is not that of the packaged EDS is the answer.
    node_id
        Of the plate, 1..127: no two simulated ones on a bus have one number; that of 33 has 1.
    """
    default = int(entry.default)
    simulated = (node_id - _FIRST_NODE_ID) % 127 + _FIRST_SERIAL
    return simulated if default == _FIRST_SERIAL else default


def expect_plate(od: ObjectDictionary, plate: int, deadline_ms: int | None) -> None:
    """Set the defaults of a stimulator to those for a plate node.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``, of a node that was not started yet.
    plate
        Node-ID of the plate node, 1..127.
    deadline_ms
        Default of the event timers of the measurements; None for that of the EDS.
    """
    if deadline_ms is not None:
        set_deadline(od, MEASUREMENT_RPDOS, deadline_ms)
    serial = od["Calibration.Plate serial number"]
    serial.default = serial.value = plate_serial(serial, plate)


def links_to_plate(
    od: ObjectDictionary, plate: int, produce_sync: bool
) -> Iterator[tuple[Entry, int]]:
    """Yield what links a stimulator to a plate and has its default, with the value it should have.

    These are the COB-IDs of the PDOs of the loop, the period of SYNC and its producer bit, and the
    watch of the plate's heartbeat. A value that a master has written or stored stays, unless it is
    the default: a master that downloads the defaults of the EDS file means no other plate.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``.
    plate
        Node-ID of the plate node, 1..127.
    produce_sync
        Whether the stimulator produces SYNC.
    """
    links = [
        (od.entry(RPDO_COMMUNICATION + rpdo - 1, PDO_COB_ID), base + plate)
        for rpdo, base in zip(MEASUREMENT_RPDOS, TPDO_IDS, strict=False)
    ]
    drive = od.entry(TPDO_COMMUNICATION + DRIVE_TPDO - 1, PDO_COB_ID)
    links += [(drive, RPDO_IDS[0] + plate), (od.entry(SYNC_PERIOD), TICK_US)]
    if produce_sync:
        sync = od.entry(SYNC_COB_ID)
        links.append((sync, sync.default | COB_SYNC_PRODUCER))
    members = od.objects[HEARTBEAT_CONSUMER].entries
    watches = [entry for subindex, entry in members.items() if subindex]
    if plate not in [entry.value >> 16 & 0xFF for entry in watches]:
        links.append((watches[-1], plate << 16 | _PLATE_HEARTBEAT_MS))
    for entry, value in links:
        if entry.value == entry.default:
            yield entry, value
