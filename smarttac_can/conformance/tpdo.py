"""TPDO: transmission types, timers, remote frames and NMT states."""

from __future__ import annotations

from itertools import pairwise

from smarttac_can.conformance.case import Failure, case
from smarttac_can.conformance.pdo_setup import (
    can_id,
    configure,
    content,
    operational,
    refuse_own_events,
    tpdo,
)
from smarttac_can.conformance.probe import Probe
from smarttac_can.conformance.sheet import Pdo, needs_object, needs_tpdo
from smarttac_can.od.cia import (
    EVENT_MANUFACTURER,
    RTR_EVENT,
    RTR_SYNC,
    SYNC_COB_ID,
)

PERIOD_MS = 60
"""Event timer and inhibit time that the cases set."""
SPREAD = 0.4
"""Share by which a period may be off: a bus in use and a computer's clock are in it."""

PERIODS = 8
"""How long a case listens to what comes every period."""
LEAST = 3
"""Arrivals in that time from which their period can be told."""

_has_sync = needs_object(SYNC_COB_ID)


def _first_sync(probe: Probe, pdo: Pdo, most: int) -> int:
    """Send SYNC until the TPDO comes, and return how many it took.

    Raises
    ------
    Failure
        If it has not come after the most allowed.
    """
    for count in range(1, most + 1):
        probe.sync()
        if probe.wait(can_id(probe, pdo), probe.timeout / 2) is not None:
            return count
    raise Failure(f"no TPDO after {most} SYNCs")


def _cyclic(probe: Probe, transmission: int) -> None:
    pdo = tpdo(probe)
    configure(probe, pdo, transmission)
    operational(probe)
    _first_sync(probe, pdo, transmission)
    for _ in range(2):
        count = _first_sync(probe, pdo, transmission)
        if count != transmission:
            raise Failure(f"type {transmission} sent after {count} SYNCs")


@case(
    "PDO-01",
    "7.2.2: a TPDO carries the mapped entries in their order, little-endian.",
    needs_tpdo,
    _has_sync,
)
def tpdo_content(probe: Probe) -> None:
    """Content."""
    pdo = tpdo(probe)
    configure(probe, pdo, 1)
    operational(probe)
    mapped = probe.sheet.mapped(pdo)
    for _ in range(3):
        before = content(probe, mapped)
        probe.drain()
        probe.sync()
        data = probe.expect(can_id(probe, pdo), "TPDO at SYNC").data
        if len(data) != len(before):
            raise Failure(f"TPDO of {len(data)} bytes, its mapping has {len(before)}")
        after = content(probe, mapped)
        moving = [a != b for a, b in zip(before, after, strict=True)]
        if all(m or d == b for m, d, b in zip(moving, data, before, strict=True)):
            return
    raise Failure(f"TPDO carries {data.hex(' ')}, the entries are {before.hex(' ')}")


@case("PDO-02", "7.5.2.37: sent at every SYNC.", needs_tpdo, _has_sync)
def every_sync(probe: Probe) -> None:
    """Type 1."""
    _cyclic(probe, 1)


@case("PDO-03", "7.5.2.37: type n is sent at every n-th SYNC.", needs_tpdo, _has_sync)
def every_third_sync(probe: Probe) -> None:
    """Type 3."""
    _cyclic(probe, 3)


@case(
    "PDO-04",
    "7.5.2.37: sent at the SYNC after an event, not at SYNCs without one.",
    needs_tpdo,
    _has_sync,
)
def acyclic(probe: Probe) -> None:
    """Type 0."""
    pdo = tpdo(probe)
    refuse_own_events(probe, pdo)
    configure(probe, pdo, 0)
    operational(probe)
    probe.sync()
    probe.settle()
    for _ in range(2):
        probe.sync()
        probe.silence(can_id(probe, pdo), "TPDO of type 0 without an event")


def _remote(probe: Probe, pdo: Pdo) -> None:
    probe.drain()
    probe.send(can_id(probe, pdo), rtr=True)


@case(
    "PDO-05",
    "7.5.2.37: sampled at SYNC, sent on a remote frame only.",
    needs_tpdo,
    _has_sync,
)
def remote_sampled(probe: Probe) -> None:
    """Type 252."""
    pdo = tpdo(probe)
    configure(probe, pdo, RTR_SYNC, rtr=True)
    operational(probe)
    probe.sync()
    probe.silence(can_id(probe, pdo), "TPDO of type 252 at SYNC")
    _remote(probe, pdo)
    probe.expect(can_id(probe, pdo), "TPDO on a remote frame")


@case("PDO-06", "7.5.2.37: sent on a remote frame at once.", needs_tpdo)
def remote(probe: Probe) -> None:
    """Type 253."""
    pdo = tpdo(probe)
    configure(probe, pdo, RTR_EVENT, rtr=True)
    operational(probe)
    _remote(probe, pdo)
    probe.expect(can_id(probe, pdo), "TPDO on a remote frame")


@case(
    "PDO-07",
    "7.5.2.37: with bit 30 of the COB-ID clear a remote frame is answered.",
    needs_tpdo,
)
def remote_event_driven(probe: Probe) -> None:
    """Remote frame to an event-driven TPDO."""
    pdo = tpdo(probe)
    configure(probe, pdo, EVENT_MANUFACTURER, rtr=True)
    operational(probe)
    _remote(probe, pdo)
    probe.expect(can_id(probe, pdo), "TPDO on a remote frame")


@case(
    "PDO-08",
    "7.5.2.37: with bit 30 of the COB-ID set a remote frame is not answered.",
    needs_tpdo,
    _has_sync,
)
def remote_not_allowed(probe: Probe) -> None:
    """Remote frame that is not allowed."""
    pdo = tpdo(probe)
    configure(probe, pdo, 1, rtr=False)
    operational(probe)
    _remote(probe, pdo)
    probe.silence(can_id(probe, pdo), "answer to a remote frame")


def _gaps(probe: Probe, pdo: Pdo) -> list[float]:
    """Return the times in ms between the TPDOs that come without a SYNC or a request.

    Raises
    ------
    Failure
        If fewer than 3 come in 8 periods.
    """
    times = [a.time for a in probe.collect(can_id(probe, pdo), 1e-3 * PERIODS * PERIOD_MS)]
    if len(times) < LEAST:
        raise Failure(f"{len(times)} TPDOs in {PERIODS * PERIOD_MS} ms, event timer {PERIOD_MS} ms")
    return [1000 * (later - earlier) for earlier, later in pairwise(times)]


@case("PDO-09", "7.5.2.37: sent when the time has passed.", needs_tpdo)
def event_timer(probe: Probe) -> None:
    """Event timer."""
    pdo = tpdo(probe)
    refuse_own_events(probe, pdo)
    configure(probe, pdo, EVENT_MANUFACTURER, event=PERIOD_MS)
    operational(probe)
    gaps = _gaps(probe, pdo)
    mean = sum(gaps) / len(gaps)
    if abs(mean - PERIOD_MS) > SPREAD * PERIOD_MS:
        raise Failure(f"TPDO every {mean:.0f} ms, event timer {PERIOD_MS} ms")


@case("PDO-10", "7.5.2.37: with time 0 nothing is sent by time.", needs_tpdo)
def event_timer_off(probe: Probe) -> None:
    """Event timer off."""
    pdo = tpdo(probe)
    configure(probe, pdo, 1, event=0)
    operational(probe)
    probe.silence(can_id(probe, pdo), "TPDO without SYNC and timer")


@case("PDO-11", "7.5.2.37: the least time between two TPDOs.", needs_tpdo)
def inhibit_time(probe: Probe) -> None:
    """Inhibit time."""
    pdo = tpdo(probe)
    configure(probe, pdo, EVENT_MANUFACTURER, inhibit=10 * PERIOD_MS, event=PERIOD_MS // 4)
    operational(probe)
    gaps = _gaps(probe, pdo)
    mean = sum(gaps) / len(gaps)
    if mean < (1 - SPREAD / 2) * PERIOD_MS:
        raise Failure(f"TPDO every {mean:.0f} ms, inhibit time {PERIOD_MS} ms")
