"""Timing on the bus: duration of a cycle and bus load, from the PDO parameters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.dictionary import ObjectDictionary

_LONGEST: Final = 8


class CyclicFrame(NamedTuple):
    """A frame that is sent at most once per period."""

    can_id: int
    """CAN-ID; the lower one wins the arbitration."""
    size: int
    """Number of data bytes."""
    period: float
    """Shortest time between two frames in s."""


def frame_bits(data_bytes: int) -> int:
    """Return the longest duration of a classical frame with an 11-bit CAN-ID, in bit times.

    Stuff bits and the interframe space are included.

    Parameters
    ----------
    data_bytes
        Number of data bytes, 0..8.

    Raises
    ------
    ValueError
        If there are fewer or more.

    Notes
    -----
    47 fixed bits including the 3 of the interframe space, of which the 34 before the CRC delimiter
    are subject to stuffing together with the data: one stuff bit after the first five equal bits
    and then one every four (Davis, Burns, Bril, Lukkien, Real-Time Systems 35 (2007) 239,
    doi:10.1007/s11241-007-9012-7). 8 bytes give 135.
    """
    if not 0 <= data_bytes <= _LONGEST:
        raise ValueError(f"data_bytes {data_bytes} is outside 0..8")
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


def frame_seconds(data_bytes: int, bit_rate: int) -> float:
    """Return the longest time in s that a frame occupies the bus at a bit rate in bit/s.

    Raises
    ------
    ValueError
        The bit rate is not above 0, or the frame has more than 8 bytes.
    """
    if bit_rate <= 0:
        raise ValueError(f"bit_rate {bit_rate} is not above 0")
    return frame_bits(data_bytes) / bit_rate


def cyclic_frames(ods: Iterable[ObjectDictionary], sync_period: float) -> list[CyclicFrame]:
    """Return SYNC and all valid TPDOs of a bus, each with its shortest period, by priority.

    Parameters
    ----------
    ods
        Object dictionaries, one for each node.
    sync_period
        Time between two SYNCs in s, above 0. It is also the assumed period of type 0 and of
        event-driven TPDOs that have neither inhibit time nor event timer.

    Raises
    ------
    ValueError
        If `sync_period` is not above 0.
    """
    if sync_period <= 0:
        raise ValueError(f"sync_period {sync_period} is not above 0")
    ods = list(ods)
    sync_id, counter = cia.SYNC_ID, 0
    for od in ods:
        if od.number(cia.SYNC_COB_ID) & cia.COB_SYNC_PRODUCER:
            sync_id = od.number(cia.SYNC_COB_ID) & cia.CAN_ID_MASK
        counter = max(counter, od.number(cia.SYNC_COUNTER))
    frames = [CyclicFrame(sync_id, 1 if counter else 0, sync_period)]
    for od in ods:
        for offset in range(cia.PDO_COUNT):
            communication = cia.TPDO_COMMUNICATION + offset
            cob_id = od.number(communication, cia.PDO_COB_ID, cia.COB_INVALID)
            size = _mapped_bytes(od, cia.TPDO_MAPPING + offset)
            if not cob_id & cia.COB_INVALID and size:
                period = _shortest_period(od, communication, sync_period)
                frames.append(CyclicFrame(cob_id & cia.CAN_ID_MASK, size, period))
    return sorted(frames)


def cycle_seconds(frames: Iterable[CyclicFrame], bit_rate: int) -> float:
    """Return the time in s to send one of each frame, back to back."""
    return sum(frame_seconds(frame.size, bit_rate) for frame in frames)


def bus_load(frames: Iterable[CyclicFrame], bit_rate: int) -> float:
    """Return the fraction of time for which the bus is busy at most; above 1 it is overloaded."""
    return sum(frame_seconds(frame.size, bit_rate) / frame.period for frame in frames)


def _mapped_bytes(od: ObjectDictionary, mapping: int) -> int:
    count = od.number(mapping)
    return sum(od.number(mapping, subindex) & 0xFF for subindex in range(1, count + 1)) // 8


def _shortest_period(od: ObjectDictionary, communication: int, sync_period: float) -> float:
    transmission = od.number(communication, cia.PDO_TRANSMISSION)
    if cia.ACYCLIC < transmission <= cia.CYCLIC_LAST:
        return transmission * sync_period
    if transmission >= cia.EVENT_MANUFACTURER:
        inhibit = od.number(communication, cia.PDO_INHIBIT) / 10_000
        event = od.number(communication, cia.PDO_EVENT) / 1000
        return inhibit or event or sync_period
    return sync_period
