"""TPDO: transmission types, timers, remote frames and NMT states."""

from __future__ import annotations

from itertools import pairwise

from smarttac_can.conformance.case import Failure, case
from smarttac_can.conformance.description import Pdo, needs_object, needs_tpdo
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.pdo_setup import (
    can_id,
    configure,
    content,
    operational,
    refuse_own_events,
    tpdo,
)
from smarttac_can.od.cia import EVENT_MANUFACTURER, RTR_EVENT, RTR_SYNC, SYNC_COB_ID

PERIOD_MS = 60
"""Event timer and inhibit time that the cases set."""
SPREAD = 0.4
"""Share by which a period may be off: a bus in use and a computer's clock are in it."""

PERIODS = 8
"""How long a case listens to what comes every period."""
LEAST = 3
"""Arrivals in that time from which their period can be told."""

_has_sync = needs_object(SYNC_COB_ID)


def _first_sync(examiner: Examiner, pdo: Pdo, most: int) -> int:
    """Send SYNC until the TPDO comes, and return how many it took.

    Raises
    ------
    Failure
        If it has not come after the most allowed.
    """
    for count in range(1, most + 1):
        examiner.sync()
        if examiner.wait(can_id(examiner, pdo), examiner.timeout / 2) is not None:
            return count
    raise Failure(f"no TPDO after {most} SYNCs")


def _cyclic(examiner: Examiner, transmission: int) -> None:
    pdo = tpdo(examiner)
    configure(examiner, pdo, transmission)
    operational(examiner)
    _first_sync(examiner, pdo, transmission)
    for _ in range(2):
        count = _first_sync(examiner, pdo, transmission)
        if count != transmission:
            raise Failure(f"type {transmission} sent after {count} SYNCs")


@case(
    "PDO-01",
    "7.2.2: a TPDO carries the mapped entries in their order, little-endian.",
    needs_tpdo,
    _has_sync,
)
def tpdo_content(examiner: Examiner) -> None:
    """Content."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, 1)
    operational(examiner)
    mapped = examiner.sheet.mapped(pdo)
    for _ in range(3):
        before = content(examiner, mapped)
        examiner.drain()
        examiner.sync()
        data = examiner.expect(can_id(examiner, pdo), "TPDO at SYNC").data
        if len(data) != len(before):
            raise Failure(f"TPDO of {len(data)} bytes, its mapping has {len(before)}")
        after = content(examiner, mapped)
        moving = [a != b for a, b in zip(before, after, strict=True)]
        if all(m or d == b for m, d, b in zip(moving, data, before, strict=True)):
            return
    raise Failure(f"TPDO carries {data.hex(' ')}, the entries are {before.hex(' ')}")


@case("PDO-02", "7.5.2.37: sent at every SYNC.", needs_tpdo, _has_sync)
def every_sync(examiner: Examiner) -> None:
    """Type 1."""
    _cyclic(examiner, 1)


@case("PDO-03", "7.5.2.37: type n is sent at every n-th SYNC.", needs_tpdo, _has_sync)
def every_third_sync(examiner: Examiner) -> None:
    """Type 3."""
    _cyclic(examiner, 3)


@case(
    "PDO-04",
    "7.5.2.37: sent at the SYNC after an event, not at SYNCs without one.",
    needs_tpdo,
    _has_sync,
)
def acyclic(examiner: Examiner) -> None:
    """Type 0."""
    pdo = tpdo(examiner)
    refuse_own_events(examiner, pdo)
    configure(examiner, pdo, 0)
    operational(examiner)
    examiner.sync()
    examiner.settle()
    for _ in range(2):
        examiner.sync()
        examiner.silence(can_id(examiner, pdo), "TPDO of type 0 without an event")


def _remote(examiner: Examiner, pdo: Pdo) -> None:
    examiner.drain()
    examiner.send(can_id(examiner, pdo), rtr=True)


@case(
    "PDO-05",
    "7.5.2.37: sampled at SYNC, sent on a remote frame only.",
    needs_tpdo,
    _has_sync,
)
def remote_sampled(examiner: Examiner) -> None:
    """Type 252."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, RTR_SYNC, rtr=True)
    operational(examiner)
    examiner.sync()
    examiner.silence(can_id(examiner, pdo), "TPDO of type 252 at SYNC")
    _remote(examiner, pdo)
    examiner.expect(can_id(examiner, pdo), "TPDO on a remote frame")


@case("PDO-06", "7.5.2.37: sent on a remote frame at once.", needs_tpdo)
def remote(examiner: Examiner) -> None:
    """Type 253."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, RTR_EVENT, rtr=True)
    operational(examiner)
    _remote(examiner, pdo)
    examiner.expect(can_id(examiner, pdo), "TPDO on a remote frame")


@case(
    "PDO-07",
    "7.5.2.37: with bit 30 of the COB-ID clear a remote frame is answered.",
    needs_tpdo,
)
def remote_event_driven(examiner: Examiner) -> None:
    """Remote frame to an event-driven TPDO."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, EVENT_MANUFACTURER, rtr=True)
    operational(examiner)
    _remote(examiner, pdo)
    examiner.expect(can_id(examiner, pdo), "TPDO on a remote frame")


@case(
    "PDO-08",
    "7.5.2.37: with bit 30 of the COB-ID set a remote frame is not answered.",
    needs_tpdo,
    _has_sync,
)
def remote_not_allowed(examiner: Examiner) -> None:
    """Remote frame that is not allowed."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, 1, rtr=False)
    operational(examiner)
    _remote(examiner, pdo)
    examiner.silence(can_id(examiner, pdo), "answer to a remote frame")


def _gaps(examiner: Examiner, pdo: Pdo) -> list[float]:
    """Return the times in ms between the TPDOs that come without a SYNC or a request.

    Raises
    ------
    Failure
        If fewer than 3 come in 8 periods.
    """
    times = [a.time for a in examiner.collect(can_id(examiner, pdo), 1e-3 * PERIODS * PERIOD_MS)]
    if len(times) < LEAST:
        raise Failure(f"{len(times)} TPDOs in {PERIODS * PERIOD_MS} ms, event timer {PERIOD_MS} ms")
    return [1000 * (later - earlier) for earlier, later in pairwise(times)]


@case("PDO-09", "7.5.2.37: sent when the time has passed.", needs_tpdo)
def event_timer(examiner: Examiner) -> None:
    """Event timer."""
    pdo = tpdo(examiner)
    refuse_own_events(examiner, pdo)
    configure(examiner, pdo, EVENT_MANUFACTURER, event=PERIOD_MS)
    operational(examiner)
    gaps = _gaps(examiner, pdo)
    mean = sum(gaps) / len(gaps)
    if abs(mean - PERIOD_MS) > SPREAD * PERIOD_MS:
        raise Failure(f"TPDO every {mean:.0f} ms, event timer {PERIOD_MS} ms")


@case("PDO-10", "7.5.2.37: with time 0 nothing is sent by time.", needs_tpdo)
def event_timer_off(examiner: Examiner) -> None:
    """Event timer off."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, 1, event=0)
    operational(examiner)
    examiner.silence(can_id(examiner, pdo), "TPDO without SYNC and timer")


@case("PDO-11", "7.5.2.37: the least time between two TPDOs.", needs_tpdo)
def inhibit_time(examiner: Examiner) -> None:
    """Inhibit time."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, EVENT_MANUFACTURER, inhibit=10 * PERIOD_MS, event=PERIOD_MS // 4)
    operational(examiner)
    gaps = _gaps(examiner, pdo)
    mean = sum(gaps) / len(gaps)
    if mean < (1 - SPREAD / 2) * PERIOD_MS:
        raise Failure(f"TPDO every {mean:.0f} ms, inhibit time {PERIOD_MS} ms")
