"""The frames between stimulator and plate: their PDOs, their check sum, and their COB-IDs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from struct import Struct
from typing import Final

from smarttac_can.canopen.device.mapping import Direction, compile_mapping
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.data_types import STRUCT_CODES
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import Entry
from smarttac_can.instrument.nodes.loop_time import set_deadline
from smarttac_can.vocabulary.signals import (
    DRIVE_RPDO,
    DRIVE_TPDO,
    MEASUREMENT_RPDOS,
    MEASUREMENT_TPDOS,
    TICK_US,
)

_POLYNOMIAL: Final = 0x1D
_START: Final = 0xFF


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
"""Table for two bytes at a time, indexed by 256 times the second byte plus the first."""
_INVERSE: Final = bytes(_TABLE.index(byte) for byte in range(256))
"""Inverse of the table: the index for each value."""
_SOUND: Final = _TABLE[0xFF] ^ 0xFF
"""CRC of bytes whose last byte is the CRC of the bytes before."""


def crc8(data: bytes) -> int:
    """Return the CRC-8 of SAE J1850: x^8 + x^4 + x^3 + x^2 + 1, from FFh on, inverted at the end.

    All single-bit errors and all error bursts of up to 8 bits are detected.
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
    """Layout of the frames of one drive or one measurement, whose last byte is a check sum.

    Parameters
    ----------
    mapped
        Mapped entries in the order of the bus. The last one, an UNSIGNED8, is the check sum of the
        other values and of bytes that are not sent.

    Attributes
    ----------
    entries
        Entries without the check sum.
    check
        Entry of the check sum.
    unpack
        Function that returns the values in the concatenated bytes, the check sum last.
    """

    __slots__ = ("_mapped", "_pack", "check", "entries", "unpack")

    def __init__(self, mapped: Sequence[Entry]) -> None:
        self._mapped = mapped
        *entries, self.check = mapped
        self.entries = tuple(entries)
        # Little-endian, as in a PDO.
        code = "<" + "".join([STRUCT_CODES[entry.data_type] for entry in entries])
        self._pack: Callable[..., bytes] = Struct(code).pack
        self.unpack: Callable[[bytes], tuple[int, ...]] = Struct(f"{code}B").unpack

    def write_check(self, unsent: bytes = b"") -> None:
        """Set the check sum of the present values of the entries.

        Parameters
        ----------
        unsent
            Bytes that both nodes know. The check sum covers them, too.
        """
        body = self._pack(*[entry.value for entry in self.entries])
        self.check.value = crc8(body + unsent)

    def keep(self, values: tuple[int, ...]) -> None:
        """Set the entries to the values of all frames; the check sum is the last value."""
        for entry, value in zip(self._mapped, values, strict=True):
            entry.value = value


def is_sound(data: bytes) -> bool:
    """Return whether the last byte is the check sum of the bytes before, without unsent bytes."""
    return crc8(data) == _SOUND


def last_unsent(data: bytes, before: bytes) -> int:
    """Return the unsent byte with which the last byte is the check sum, after other unsent bytes.

    There is exactly one such byte; corrupt data give a wrong one.
    """
    return _INVERSE[data[-1] ^ 0xFF] ^ crc8(data[:-1] + before) ^ 0xFF


LATCHED: Final = 0x80
"""Value that is added to the node-ID of a drive's sender while the sender is in FAULT."""


def sent_measurement(plate: ObjectDictionary) -> CheckedFrames:
    """Return the layout of the measurement that the plate sends."""
    return _mapped(plate, cia.TPDO_MAPPING, MEASUREMENT_TPDOS, Direction.TRANSMIT)


def received_measurement(stimulator: ObjectDictionary) -> CheckedFrames:
    """Return the layout of the measurement that the stimulator receives."""
    return _mapped(stimulator, cia.RPDO_MAPPING, MEASUREMENT_RPDOS, Direction.RECEIVE)


def sent_drive(stimulator: ObjectDictionary) -> CheckedFrames:
    """Return the layout of the drive that the stimulator sends."""
    return _mapped(stimulator, cia.TPDO_MAPPING, (DRIVE_TPDO,), Direction.TRANSMIT)


def received_drive(plate: ObjectDictionary) -> CheckedFrames:
    """Return the layout of the drive that the plate receives."""
    return _mapped(plate, cia.RPDO_MAPPING, (DRIVE_RPDO,), Direction.RECEIVE)


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
"""Default serial number in the packaged EDS files."""
_FIRST_NODE_ID: Final = 33
_PLATE_HEARTBEAT_MS: Final = 2000
"""Four heartbeat periods of a plate that has not been configured."""


def plate_serial(entry: Entry, node_id: int) -> int:
    """Return the serial number of a plate, or of the plate that a calibration is for.

    Parameters
    ----------
    entry
        Entry of the serial number. A default other than that of the packaged EDS is returned as it
        is.
    node_id
        Node-ID of the plate, 1..127. It gives a simulated plate its number, so that no two on a bus
        have the same; node 33 has number 1.
    """
    default = int(entry.default)
    simulated = (node_id - _FIRST_NODE_ID) % 127 + _FIRST_SERIAL
    return simulated if default == _FIRST_SERIAL else default


def expect_plate(od: ObjectDictionary, plate: int, deadline_ms: int | None) -> None:
    """Set the defaults of a stimulator for a plate node.

    Parameters
    ----------
    od
        Object dictionary of ``stimulator.eds``, of a node that is not started yet.
    plate
        Node-ID of the plate node, 1..127.
    deadline_ms
        Default of the event timers of the measurements in ms; None for the default of the EDS.
    """
    if deadline_ms is not None:
        set_deadline(od, MEASUREMENT_RPDOS, deadline_ms)
    serial = od["Calibration.Plate serial number"]
    serial.default = serial.value = plate_serial(serial, plate)


def links_to_plate(
    od: ObjectDictionary, plate: int, produce_sync: bool
) -> Iterator[tuple[Entry, int]]:
    """Yield the entries that link a stimulator to a plate, each with the value it should have.

    These are the COB-IDs of the PDOs of the loop, the period of SYNC and its producer bit, and the
    consumer heartbeat time of the plate. Only entries that have their default are included: what a
    master has written or stored stays. A master that downloads the defaults of the EDS file does
    not ask for another plate.

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
        (od.entry(cia.RPDO_COMMUNICATION + rpdo - 1, cia.PDO_COB_ID), base + plate)
        for rpdo, base in zip(MEASUREMENT_RPDOS, cia.TPDO_IDS, strict=False)
    ]
    drive = od.entry(cia.TPDO_COMMUNICATION + DRIVE_TPDO - 1, cia.PDO_COB_ID)
    links += [(drive, cia.RPDO_IDS[0] + plate), (od.entry(cia.SYNC_PERIOD), TICK_US)]
    if produce_sync:
        sync = od.entry(cia.SYNC_COB_ID)
        links.append((sync, sync.default | cia.COB_SYNC_PRODUCER))
    members = od.objects[cia.HEARTBEAT_CONSUMER].entries
    watches = [entry for subindex, entry in members.items() if subindex]
    if plate not in [entry.value >> 16 & 0xFF for entry in watches]:
        links.append((watches[-1], plate << 16 | _PLATE_HEARTBEAT_MS))
    for entry, value in links:
        if entry.value == entry.default:
            yield entry, value
