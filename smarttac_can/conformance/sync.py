"""SYNC: consumer, producer, counter and window."""

from __future__ import annotations

from functools import partial
from itertools import pairwise

from smarttac_can.conformance.case import Failure, NotApplicable, case
from smarttac_can.conformance.emcy_setup import expect_emcy, needs_emcy
from smarttac_can.conformance.pdo_setup import can_id, configure, operational, tpdo
from smarttac_can.conformance.probe import Arrival, Probe
from smarttac_can.conformance.sdo_client import number, write_number
from smarttac_can.conformance.sheet import needs_object, needs_tpdo
from smarttac_can.conformance.tpdo import LEAST, PERIODS, SPREAD
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_SYNC_PRODUCER,
    SYNC_COB_ID,
    SYNC_COUNTER,
    SYNC_PERIOD,
    SYNC_WINDOW,
    Abort,
    AbortCode,
    EmergencyCode,
    NMTCommand,
)

_PERIOD_MS = 50
_OTHER_ID = 0x0A5
_has_cob_id = needs_object(SYNC_COB_ID)
_has_writable = needs_object(SYNC_COB_ID, writable=True)
_has_period = needs_object(SYNC_PERIOD, writable=True)
_has_counter = needs_object(SYNC_COUNTER, writable=True)


@case(
    "SYNC-01",
    "7.5.2.5: the COB-ID is that of the EDS; SYNC with it makes a TPDO of type 1 go.",
    _has_cob_id,
    needs_tpdo,
)
def consumer(probe: Probe) -> None:
    """COB-ID and consumer."""
    value, stated = number(probe, SYNC_COB_ID), probe.sheet.od.number(SYNC_COB_ID)
    if value != stated:
        raise Failure(f"COB-ID SYNC is {value:08X}h, the EDS says {stated:08X}h")
    pdo = tpdo(probe)
    configure(probe, pdo, 1)
    operational(probe)
    probe.sync()
    probe.expect(can_id(probe, pdo), "TPDO at SYNC")


@case(
    "SYNC-02",
    "7.5.2.5: SYNC is heard under a CAN-ID written while none is produced, not the old one.",
    _has_writable,
    needs_tpdo,
)
def new_can_id(probe: Probe) -> None:
    """New CAN-ID."""
    old = probe.sync_id
    write_number(probe, SYNC_COB_ID, 0, _OTHER_ID)
    pdo = tpdo(probe)
    configure(probe, pdo, 1)
    operational(probe)
    payload = b"\x01" if probe.sheet.od.number(SYNC_COUNTER) else b""
    probe.send(_OTHER_ID, payload)
    probe.expect(can_id(probe, pdo), f"TPDO at SYNC under {_OTHER_ID:03X}h")
    probe.send(old, payload)
    probe.silence(can_id(probe, pdo), "TPDO at SYNC under the old CAN-ID")


@case(
    "SYNC-03",
    "Table 39: CAN-IDs of NMT, SDO and error control are refused.",
    _has_writable,
)
def restricted_ids(probe: Probe) -> None:
    """Restricted CAN-IDs."""
    for value in (0x000, 0x001, 0x101, 0x581, 0x601, 0x701):
        probe.refuse(
            partial(write_number, probe, SYNC_COB_ID, 0, value),
            f"CAN-ID {value:03X}h for SYNC",
            AbortCode.VALUE,
            AbortCode.TOO_HIGH,
            AbortCode.TOO_LOW,
        )


def free_counter(probe: Probe) -> None:
    """Set the period to 0, without which the overflow value is fixed."""
    if probe.sheet.writable(SYNC_PERIOD):
        write_number(probe, SYNC_PERIOD, 0, 0)


def _produce(probe: Probe, period_ms: int = _PERIOD_MS) -> None:
    write_number(probe, SYNC_PERIOD, 0, 1000 * period_ms)
    try:
        write_number(probe, SYNC_COB_ID, 0, probe.sync_id | COB_SYNC_PRODUCER)
    except Abort as abort:
        raise NotApplicable(f"the device produces no SYNC: {abort}") from None


def _produced(probe: Probe, period_ms: int = _PERIOD_MS) -> list[Arrival]:
    """Hear the SYNCs of 8 periods, and return them.

    Raises
    ------
    Failure
        If fewer than 3 come, or they do not keep the time.
    """
    probe.drain()
    arrivals = probe.collect(probe.sync_id, 1e-3 * PERIODS * period_ms)
    if len(arrivals) < LEAST:
        raise Failure(f"{len(arrivals)} SYNCs in {PERIODS} periods of {period_ms} ms")
    gaps = [1000 * (b.time - a.time) for a, b in pairwise(arrivals)]
    mean = sum(gaps) / len(gaps)
    if abs(mean - period_ms) > SPREAD * period_ms:
        raise Failure(f"SYNC every {mean:.0f} ms, period {period_ms} ms")
    return arrivals


@case(
    "SYNC-04",
    "7.5.2.5, .6, table 38: with bit 30 it sends SYNC every period, but not in STOPPED.",
    _has_writable,
    _has_period,
)
def producer(probe: Probe) -> None:
    """Producer."""
    _produce(probe)
    _produced(probe)
    operational(probe)
    _produced(probe)
    probe.enter(NMTCommand.STOP)
    probe.silence(probe.sync_id, "SYNC in STOPPED")


@case(
    "SYNC-05",
    "7.5.2.5: bits 0 to 29 cannot be changed while bit 30 is set.",
    _has_writable,
    _has_period,
)
def can_id_fixed(probe: Probe) -> None:
    """CAN-ID of a producer."""
    _produce(probe)
    probe.refuse(
        lambda: write_number(probe, SYNC_COB_ID, 0, _OTHER_ID | COB_SYNC_PRODUCER),
        "CAN-ID of a SYNC producer",
    )
    if number(probe, SYNC_COB_ID) & CAN_ID_MASK != probe.sync_id:
        raise Failure("the refused CAN-ID was taken")


@case(
    "SYNC-06",
    "7.5.2.6: a period is in force within one cycle; 0 stops SYNC.",
    _has_writable,
    _has_period,
)
def new_period(probe: Probe) -> None:
    """New period."""
    _produce(probe)
    _produced(probe)
    write_number(probe, SYNC_PERIOD, 0, 2000 * _PERIOD_MS)
    probe.settle()
    _produced(probe, 2 * _PERIOD_MS)
    write_number(probe, SYNC_PERIOD, 0, 0)
    probe.settle()
    probe.silence(probe.sync_id, "SYNC with period 0")


@case(
    "SYNC-07",
    "7.5.2.21: SYNC carries a counter from 1 to the overflow value.",
    _has_writable,
    _has_period,
    _has_counter,
)
def counter(probe: Probe) -> None:
    """Counter of a producer."""
    overflow = 3
    free_counter(probe)
    write_number(probe, SYNC_COUNTER, 0, overflow)
    _produce(probe)
    counters = [arrival.frame.data for arrival in _produced(probe)]
    for before, after in pairwise(counters):
        if len(before) != 1 or len(after) != 1 or after[0] != before[0] % overflow + 1:
            raise Failure(f"counters {[c.hex() for c in counters]}, overflow {overflow}")


@case(
    "SYNC-08",
    "7.5.2.21: 1 and 241 to 255 are refused, and all while the period is not 0 (08000022h).",
    _has_counter,
)
def overflow_value(probe: Probe) -> None:
    """Overflow value."""
    free_counter(probe)
    for value in (1, 241, 255):
        probe.refuse(
            partial(write_number, probe, SYNC_COUNTER, 0, value),
            f"overflow value {value}",
            AbortCode.VALUE,
            AbortCode.TOO_HIGH,
            AbortCode.TOO_LOW,
        )
    if not probe.sheet.writable(SYNC_PERIOD):
        return
    write_number(probe, SYNC_PERIOD, 0, 1000 * _PERIOD_MS)
    probe.refuse(
        lambda: write_number(probe, SYNC_COUNTER, 0, 10),
        "overflow value while the period is not 0",
        AbortCode.STATE,
    )


@case(
    "SYNC-09",
    "7.5.2.7: it can be set, and TPDOs within it go as before.",
    needs_object(SYNC_WINDOW, writable=True),
    needs_tpdo,
    _has_cob_id,
)
def window(probe: Probe) -> None:
    """Synchronous window."""
    length = 1000 * _PERIOD_MS
    write_number(probe, SYNC_WINDOW, 0, length)
    if number(probe, SYNC_WINDOW) != length:
        raise Failure("the window does not read as written")
    pdo = tpdo(probe)
    configure(probe, pdo, 1)
    operational(probe)
    for _ in range(2):
        probe.sync()
        probe.expect(can_id(probe, pdo), "TPDO within the window")


@case(
    "SYNC-10",
    "7.2.7.1: a SYNC of unexpected length is reported as EMCY 8240h and starts nothing.",
    _has_counter,
    needs_emcy,
)
def wrong_length(probe: Probe) -> None:
    """Wrong length."""
    operational(probe)
    probe.drain()
    probe.send(probe.sync_id, b"" if probe.sheet.od.number(SYNC_COUNTER) else b"\x01")
    expect_emcy(probe, EmergencyCode.SYNC_LENGTH)
