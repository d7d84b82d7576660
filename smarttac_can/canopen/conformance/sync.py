"""SYNC: consumer, producer, counter and window."""

from __future__ import annotations

from itertools import pairwise

from smarttac_can.canopen.conformance import refusals
from smarttac_can.canopen.conformance.case import (
    Failure,
    Group,
    NotApplicable,
    case,
    needs_object,
    needs_sync,
    needs_tpdo,
)
from smarttac_can.canopen.conformance.emcy import expect_emcy, needs_emcy
from smarttac_can.canopen.conformance.examiner import (
    Arrival,
    Examiner,
    number,
    periodic,
    try_number,
    write_number,
)
from smarttac_can.canopen.conformance.pdo import can_id, operational, started, stop_sync
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, EmergencyCode, NMTCommand

_PERIOD_MS = 50
_OTHER_IDS = (0x0A5, 0x0A6)
"""CAN-IDs for SYNC, of which at most one is that of the device's EMCY."""
_has_writable = needs_object(cia.SYNC_COB_ID, writable=True)
_has_period = needs_object(cia.SYNC_PERIOD, writable=True)
_has_counter = needs_object(cia.SYNC_COUNTER, writable=True)


_sync = Group("SYNC")


@case(
    _sync,
    1,
    "7.5.2.5: the COB-ID is that of the EDS; SYNC with it makes a TPDO of type 1 go.",
    needs_sync,
    needs_tpdo,
)
def consumer(examiner: Examiner) -> None:
    """COB-ID and consumer."""
    value, stated = number(examiner, cia.SYNC_COB_ID), examiner.sheet.od.number(cia.SYNC_COB_ID)
    if value != stated:
        raise Failure(f"COB-ID SYNC is {value:08X}h, the EDS says {stated:08X}h")
    pdo = started(examiner, 1)
    examiner.sync()
    examiner.expect(can_id(examiner, pdo), "TPDO at SYNC")


@case(
    _sync,
    2,
    "7.5.2.5: SYNC is heard under a CAN-ID written while none is produced, not the old one.",
    _has_writable,
    needs_tpdo,
)
def new_can_id(examiner: Examiner) -> None:
    """New CAN-ID."""
    old, new = examiner.sync_id, _other_id(examiner)
    stop_sync(examiner)
    if examiner.sheet.od.number(cia.SYNC_COB_ID) & cia.COB_SYNC_PRODUCER:
        write_number(examiner, cia.SYNC_COB_ID, 0, old)
    write_number(examiner, cia.SYNC_COB_ID, 0, new)
    pdo = started(examiner, 1)
    payload = b"\x01" if examiner.sheet.od.number(cia.SYNC_COUNTER) else b""
    examiner.send(new, payload)
    examiner.expect(can_id(examiner, pdo), f"TPDO at SYNC under {new:03X}h")
    examiner.send(old, payload)
    examiner.silence(can_id(examiner, pdo), "TPDO at SYNC under the old CAN-ID")


@case(_sync, 3, "Table 39: CAN-IDs of NMT, SDO and error control are refused.", _has_writable)
def restricted_ids(examiner: Examiner) -> None:
    """Restricted CAN-IDs."""
    for value in (0x000, 0x001, 0x101, 0x581, 0x601, 0x701):
        with examiner.refused(f"CAN-ID {value:03X}h for SYNC", refusals.OUT_OF_RANGE):
            try_number(examiner, cia.SYNC_COB_ID, 0, value)


def _other_id(examiner: Examiner) -> int:
    emcy = examiner.sheet.od.number(cia.EMCY_COB_ID) & cia.CAN_ID_MASK
    return next(can_id for can_id in _OTHER_IDS if can_id != emcy)


def free_counter(examiner: Examiner) -> None:
    """Set the period to 0, as the overflow value is fixed otherwise."""
    if examiner.sheet.writable(cia.SYNC_PERIOD):
        write_number(examiner, cia.SYNC_PERIOD, 0, 0)


def _produce(examiner: Examiner) -> None:
    write_number(examiner, cia.SYNC_PERIOD, 0, 1000 * _PERIOD_MS)
    try:
        write_number(examiner, cia.SYNC_COB_ID, 0, examiner.sync_id | cia.COB_SYNC_PRODUCER)
    except Abort as abort:
        raise NotApplicable(f"the device produces no SYNC: {abort}") from None


def _produced(examiner: Examiner, period_ms: int = _PERIOD_MS) -> list[Arrival]:
    return periodic(examiner, examiner.sync_id, "SYNC", "period", period_ms)


_of_producer = Group("SYNC", (_has_writable, _has_period))


@case(
    _of_producer,
    4,
    "7.5.2.5, .6, table 38: with bit 30 it sends SYNC every period, but not in STOPPED.",
)
def producer(examiner: Examiner) -> None:
    """Producer."""
    _produce(examiner)
    _produced(examiner)
    operational(examiner)
    _produced(examiner)
    examiner.enter(NMTCommand.STOP)
    examiner.silence(examiner.sync_id, "SYNC in STOPPED")


@case(_of_producer, 5, "7.5.2.5: bits 0 to 29 cannot be changed while bit 30 is set.")
def can_id_fixed(examiner: Examiner) -> None:
    """CAN-ID of a producer."""
    _produce(examiner)
    with examiner.refused("CAN-ID of a SYNC producer"):
        write_number(examiner, cia.SYNC_COB_ID, 0, _other_id(examiner) | cia.COB_SYNC_PRODUCER)
    if number(examiner, cia.SYNC_COB_ID) & cia.CAN_ID_MASK != examiner.sync_id:
        raise Failure("the refused CAN-ID was taken")


@case(_of_producer, 6, "7.5.2.6: a period is in force within one cycle; 0 stops SYNC.")
def new_period(examiner: Examiner) -> None:
    """New period."""
    _produce(examiner)
    _produced(examiner)
    write_number(examiner, cia.SYNC_PERIOD, 0, 2000 * _PERIOD_MS)
    examiner.settle()
    _produced(examiner, 2 * _PERIOD_MS)
    write_number(examiner, cia.SYNC_PERIOD, 0, 0)
    examiner.settle()
    examiner.silence(examiner.sync_id, "SYNC with period 0")


@case(
    _of_producer, 7, "7.5.2.21: SYNC carries a counter from 1 to the overflow value.", _has_counter
)
def counter(examiner: Examiner) -> None:
    """Counter of a producer."""
    overflow = 3
    free_counter(examiner)
    write_number(examiner, cia.SYNC_COUNTER, 0, overflow)
    _produce(examiner)
    counters = [arrival.frame.data for arrival in _produced(examiner)]
    for before, after in pairwise(counters):
        if len(before) != 1 or len(after) != 1 or after[0] != before[0] % overflow + 1:
            raise Failure(f"counters {[c.hex() for c in counters]}, overflow {overflow}")


@case(
    _sync,
    8,
    "7.5.2.21: 1 and 241 to 255 are refused, and all while the period is not 0 (08000022h).",
    _has_counter,
)
def overflow_value(examiner: Examiner) -> None:
    """Overflow value."""
    free_counter(examiner)
    for value in (1, 241, 255):
        with examiner.refused(f"overflow value {value}", refusals.OUT_OF_RANGE):
            try_number(examiner, cia.SYNC_COUNTER, 0, value)
    if not examiner.sheet.writable(cia.SYNC_PERIOD):
        return
    write_number(examiner, cia.SYNC_PERIOD, 0, 1000 * _PERIOD_MS)
    with examiner.refused("overflow value while the period is not 0", refusals.PERIOD_SET):
        write_number(examiner, cia.SYNC_COUNTER, 0, 10)


@case(
    _sync,
    9,
    "7.5.2.7: it can be set, and TPDOs within it go as before.",
    needs_object(cia.SYNC_WINDOW, writable=True),
    needs_tpdo,
    needs_sync,
)
def window(examiner: Examiner) -> None:
    """Synchronous window."""
    length = 1000 * _PERIOD_MS
    write_number(examiner, cia.SYNC_WINDOW, 0, length)
    if number(examiner, cia.SYNC_WINDOW) != length:
        raise Failure("the window does not read as written")
    pdo = started(examiner, 1)
    for _ in range(2):
        examiner.sync()
        examiner.expect(can_id(examiner, pdo), "TPDO within the window")


@case(
    _sync,
    10,
    "7.2.7.1: a SYNC of unexpected length is reported as EMCY 8240h and starts nothing.",
    _has_counter,
    needs_emcy,
)
def wrong_length(examiner: Examiner) -> None:
    """Wrong length."""
    stop_sync(examiner)
    operational(examiner)
    examiner.drain()
    examiner.send(examiner.sync_id, b"" if examiner.sheet.od.number(cia.SYNC_COUNTER) else b"\x01")
    expect_emcy(examiner, EmergencyCode.SYNC_LENGTH)
