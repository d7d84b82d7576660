"""TPDO: transmission types, timers, remote frames and NMT states."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure, case
from smarttac_can.conformance.description import Pdo, needs_sync, needs_tpdo
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.pdo_setup import (
    can_id,
    content,
    refuse_own_events,
    started,
)
from smarttac_can.conformance.periods import LEAST, PERIODS, SPREAD, mean_gap_ms
from smarttac_can.od.cia import EVENT_MANUFACTURER, RTR_EVENT, RTR_SYNC

PERIOD_MS = 60
"""Event timer and inhibit time that the cases set."""


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
    pdo = started(examiner, transmission)
    _first_sync(examiner, pdo, transmission)
    for _ in range(2):
        count = _first_sync(examiner, pdo, transmission)
        if count != transmission:
            raise Failure(f"type {transmission} sent after {count} SYNCs")


@case(
    "PDO-01",
    "7.2.2: a TPDO carries the mapped entries in their order, little-endian.",
    needs_tpdo,
    needs_sync,
)
def tpdo_content(examiner: Examiner) -> None:
    """Content."""
    pdo = started(examiner, 1)
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


@case("PDO-02", "7.5.2.37: sent at every SYNC.", needs_tpdo, needs_sync)
def every_sync(examiner: Examiner) -> None:
    """Type 1."""
    _cyclic(examiner, 1)


@case("PDO-03", "7.5.2.37: type n is sent at every n-th SYNC.", needs_tpdo, needs_sync)
def every_third_sync(examiner: Examiner) -> None:
    """Type 3."""
    _cyclic(examiner, 3)


@case(
    "PDO-04",
    "7.5.2.37: sent at the SYNC after an event, not at SYNCs without one.",
    needs_tpdo,
    needs_sync,
)
def acyclic(examiner: Examiner) -> None:
    """Type 0."""
    refuse_own_events(examiner)
    pdo = started(examiner, 0)
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
    needs_sync,
)
def remote_sampled(examiner: Examiner) -> None:
    """Type 252."""
    pdo = started(examiner, RTR_SYNC, rtr=True)
    examiner.sync()
    examiner.silence(can_id(examiner, pdo), "TPDO of type 252 at SYNC")
    _remote(examiner, pdo)
    examiner.expect(can_id(examiner, pdo), "TPDO on a remote frame")


@case("PDO-06", "7.5.2.37: sent on a remote frame at once.", needs_tpdo)
def remote(examiner: Examiner) -> None:
    """Type 253."""
    pdo = started(examiner, RTR_EVENT, rtr=True)
    _remote(examiner, pdo)
    examiner.expect(can_id(examiner, pdo), "TPDO on a remote frame")


@case(
    "PDO-07",
    "7.5.2.37: with bit 30 of the COB-ID clear a remote frame is answered.",
    needs_tpdo,
)
def remote_event_driven(examiner: Examiner) -> None:
    """Remote frame to an event-driven TPDO."""
    pdo = started(examiner, EVENT_MANUFACTURER, rtr=True)
    _remote(examiner, pdo)
    examiner.expect(can_id(examiner, pdo), "TPDO on a remote frame")


@case(
    "PDO-08",
    "7.5.2.37: with bit 30 of the COB-ID set a remote frame is not answered.",
    needs_tpdo,
    needs_sync,
)
def remote_not_allowed(examiner: Examiner) -> None:
    """Remote frame that is not allowed."""
    pdo = started(examiner, 1, rtr=False)
    _remote(examiner, pdo)
    examiner.silence(can_id(examiner, pdo), "answer to a remote frame")


def _gap_ms(examiner: Examiner, pdo: Pdo) -> float:
    """Return the mean time in ms between the TPDOs that come without a SYNC or a request.

    Raises
    ------
    Failure
        If fewer than 3 come in 8 periods.
    """
    came = examiner.collect(can_id(examiner, pdo), 1e-3 * PERIODS * PERIOD_MS)
    if len(came) < LEAST:
        raise Failure(f"{len(came)} TPDOs in {PERIODS * PERIOD_MS} ms, event timer {PERIOD_MS} ms")
    return mean_gap_ms(came)


@case("PDO-09", "7.5.2.37: sent when the time has passed.", needs_tpdo)
def event_timer(examiner: Examiner) -> None:
    """Event timer."""
    refuse_own_events(examiner)
    pdo = started(examiner, EVENT_MANUFACTURER, event=PERIOD_MS)
    mean = _gap_ms(examiner, pdo)
    if abs(mean - PERIOD_MS) > SPREAD * PERIOD_MS:
        raise Failure(f"TPDO every {mean:.0f} ms, event timer {PERIOD_MS} ms")


@case("PDO-10", "7.5.2.37: with time 0 nothing is sent by time.", needs_tpdo)
def event_timer_off(examiner: Examiner) -> None:
    """Event timer off."""
    pdo = started(examiner, 1, event=0)
    examiner.silence(can_id(examiner, pdo), "TPDO without SYNC and timer")


@case("PDO-11", "7.5.2.37: the least time between two TPDOs.", needs_tpdo)
def inhibit_time(examiner: Examiner) -> None:
    """Inhibit time."""
    pdo = started(examiner, EVENT_MANUFACTURER, inhibit=10 * PERIOD_MS, event=PERIOD_MS // 4)
    mean = _gap_ms(examiner, pdo)
    if mean < (1 - SPREAD / 2) * PERIOD_MS:
        raise Failure(f"TPDO every {mean:.0f} ms, inhibit time {PERIOD_MS} ms")
