"""TPDO: transmission types, timers, remote frames and NMT states."""

from __future__ import annotations

from itertools import pairwise

from smarttac_can.bench.conformance.case import Failure, NotApplicable, case
from smarttac_can.bench.conformance.pdo_setup import (
    can_id,
    configure,
    content,
    disable,
    enable,
    operational,
    tpdo,
)
from smarttac_can.bench.conformance.probe import ENTER_PRE_OPERATIONAL, STOP, Probe
from smarttac_can.bench.conformance.sdo_client import number, write_number
from smarttac_can.bench.conformance.sheet import Pdo, needs_object, needs_tpdo
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_INVALID,
    EVENT_MANUFACTURER,
    PDO_COB_ID,
    PDO_INHIBIT,
    PDO_SYNC_START,
    PDO_TRANSMISSION,
    RTR_EVENT,
    RTR_SYNC,
    SYNC_COB_ID,
    SYNC_COUNTER,
)

PERIOD_MS = 60
"""Event timer and inhibit time that the cases set."""
SPREAD = 0.4
"""Share by which a period may be off: a bus in use and a computer's clock are in it."""

_has_sync = needs_object(SYNC_COB_ID)


def _first_sync(probe: Probe, pdo: Pdo, most: int) -> int:
    """SYNCs until the PDO comes."""
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
    "Content",
    "7.2.2: a TPDO carries the mapped entries in their order, little-endian.",
    needs_tpdo,
    _has_sync,
)
def tpdo_content(probe: Probe) -> None:
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


@case("PDO-02", "Type 1", "7.5.2.37: sent at every SYNC.", needs_tpdo, _has_sync)
def every_sync(probe: Probe) -> None:
    _cyclic(probe, 1)


@case("PDO-03", "Type 3", "7.5.2.37: type n is sent at every n-th SYNC.", needs_tpdo, _has_sync)
def every_third_sync(probe: Probe) -> None:
    _cyclic(probe, 3)


@case(
    "PDO-04",
    "Type 0",
    "7.5.2.37: sent at the SYNC after an event, not at SYNCs without one.",
    needs_tpdo,
    _has_sync,
)
def acyclic(probe: Probe) -> None:
    pdo = tpdo(probe)
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
    "Type 252",
    "7.5.2.37: sampled at SYNC, sent on a remote frame only.",
    needs_tpdo,
    _has_sync,
)
def remote_sampled(probe: Probe) -> None:
    pdo = tpdo(probe)
    configure(probe, pdo, RTR_SYNC, rtr=True)
    operational(probe)
    probe.sync()
    probe.silence(can_id(probe, pdo), "TPDO of type 252 at SYNC")
    _remote(probe, pdo)
    probe.expect(can_id(probe, pdo), "TPDO on a remote frame")


@case("PDO-06", "Type 253", "7.5.2.37: sent on a remote frame at once.", needs_tpdo)
def remote(probe: Probe) -> None:
    pdo = tpdo(probe)
    configure(probe, pdo, RTR_EVENT, rtr=True)
    operational(probe)
    _remote(probe, pdo)
    probe.expect(can_id(probe, pdo), "TPDO on a remote frame")


@case(
    "PDO-07",
    "Remote frame to an event-driven TPDO",
    "7.5.2.37: with bit 30 of the COB-ID clear a remote frame is answered.",
    needs_tpdo,
)
def remote_event_driven(probe: Probe) -> None:
    pdo = tpdo(probe)
    configure(probe, pdo, EVENT_MANUFACTURER, rtr=True)
    operational(probe)
    _remote(probe, pdo)
    probe.expect(can_id(probe, pdo), "TPDO on a remote frame")


@case(
    "PDO-08",
    "Remote frame that is not allowed",
    "7.5.2.37: with bit 30 of the COB-ID set a remote frame is not answered.",
    needs_tpdo,
    _has_sync,
)
def remote_not_allowed(probe: Probe) -> None:
    pdo = tpdo(probe)
    configure(probe, pdo, 1, rtr=False)
    operational(probe)
    _remote(probe, pdo)
    probe.silence(can_id(probe, pdo), "answer to a remote frame")


def _gaps(probe: Probe, pdo: Pdo) -> list[float]:
    """Times in ms between the TPDOs that come by themselves."""
    times = [a.time for a in probe.collect(can_id(probe, pdo), 8e-3 * PERIOD_MS)]
    if len(times) < 3:
        raise Failure(f"{len(times)} TPDOs in {8 * PERIOD_MS} ms, event timer {PERIOD_MS} ms")
    return [1000 * (later - earlier) for earlier, later in pairwise(times)]


@case("PDO-09", "Event timer", "7.5.2.37: sent when the time has passed.", needs_tpdo)
def event_timer(probe: Probe) -> None:
    pdo = tpdo(probe)
    configure(probe, pdo, EVENT_MANUFACTURER, event=PERIOD_MS)
    operational(probe)
    gaps = _gaps(probe, pdo)
    mean = sum(gaps) / len(gaps)
    if abs(mean - PERIOD_MS) > SPREAD * PERIOD_MS:
        raise Failure(f"TPDO every {mean:.0f} ms, event timer {PERIOD_MS} ms")


@case("PDO-10", "Event timer off", "7.5.2.37: with time 0 nothing is sent by time.", needs_tpdo)
def event_timer_off(probe: Probe) -> None:
    pdo = tpdo(probe)
    configure(probe, pdo, 1, event=0)
    operational(probe)
    probe.silence(can_id(probe, pdo), "TPDO without SYNC and timer")


@case("PDO-11", "Inhibit time", "7.5.2.37: the least time between two TPDOs.", needs_tpdo)
def inhibit_time(probe: Probe) -> None:
    pdo = tpdo(probe)
    configure(probe, pdo, EVENT_MANUFACTURER, inhibit=10 * PERIOD_MS, event=PERIOD_MS // 4)
    operational(probe)
    gaps = _gaps(probe, pdo)
    mean = sum(gaps) / len(gaps)
    if mean < (1 - SPREAD / 2) * PERIOD_MS:
        raise Failure(f"TPDO every {mean:.0f} ms, inhibit time {PERIOD_MS} ms")


def _fixed_while_valid(probe: Probe, subindex: int, value: int, name: str) -> None:
    pdo = tpdo(probe)
    if not probe.sheet.writable(pdo.communication, subindex):
        raise NotApplicable(f"{pdo.communication:04X}h has no {name} to write")
    enable(probe, pdo, disable(probe, pdo))
    probe.refuse(
        lambda: write_number(probe, pdo.communication, subindex, value),
        f"{name} of a valid TPDO",
    )


@case(
    "PDO-12",
    "Inhibit time of a valid TPDO",
    "7.5.2.37: it cannot be changed while the PDO exists.",
    needs_tpdo,
)
def inhibit_time_fixed(probe: Probe) -> None:
    _fixed_while_valid(probe, PDO_INHIBIT, 100, "inhibit time")


@case(
    "PDO-13",
    "SYNC start value",
    "7.5.2.37: the SYNC whose counter is the start value is the first one counted.",
    needs_tpdo,
    needs_object(SYNC_COUNTER, writable=True),
)
def start_value(probe: Probe) -> None:
    pdo = tpdo(probe)
    write_number(probe, SYNC_COUNTER, 0, 10)
    configure(probe, pdo, 1, start=3)
    operational(probe)
    for counter in (1, 2):
        probe.sync(counter)
        probe.silence(can_id(probe, pdo), f"TPDO at counter {counter}, start value 3")
    probe.sync(3)
    probe.expect(can_id(probe, pdo), "TPDO at its start value")


@case(
    "PDO-14",
    "SYNC start value of a valid TPDO",
    "7.5.2.37: it cannot be changed while the PDO exists.",
    needs_tpdo,
)
def start_value_fixed(probe: Probe) -> None:
    _fixed_while_valid(probe, PDO_SYNC_START, 5, "SYNC start value")


@case(
    "PDO-15",
    "Reserved transmission types",
    "7.5.2.37: types 241 to 251 are refused.",
    needs_tpdo,
)
def reserved_types(probe: Probe) -> None:
    pdo = tpdo(probe)
    disable(probe, pdo)
    for value in (241, 251):
        probe.refuse(
            lambda value=value: write_number(probe, pdo.communication, PDO_TRANSMISSION, value),
            f"transmission type {value}",
        )


@case("PDO-16", "Disabled TPDO", "7.5.2.37: with bit 31 it is silent.", needs_tpdo, _has_sync)
def disabled(probe: Probe) -> None:
    pdo = tpdo(probe)
    configure(probe, pdo, 1)
    disable(probe, pdo)
    operational(probe)
    probe.sync()
    probe.silence(can_id(probe, pdo), "TPDO that is disabled")


@case(
    "PDO-17",
    "CAN-ID of a valid TPDO",
    "7.5.2.37: bits 0 to 29 cannot be changed while the PDO exists.",
    needs_tpdo,
)
def can_id_fixed(probe: Probe) -> None:
    pdo = tpdo(probe)
    cob_id = disable(probe, pdo)
    enable(probe, pdo, cob_id)
    probe.refuse(
        lambda: write_number(probe, pdo.communication, PDO_COB_ID, _moved(cob_id)),
        "another CAN-ID of a valid TPDO",
    )
    if number(probe, pdo.communication, PDO_COB_ID) & CAN_ID_MASK != cob_id & CAN_ID_MASK:
        raise Failure("the refused CAN-ID was taken")


def _moved(cob_id: int) -> int:
    return cob_id & ~CAN_ID_MASK | (cob_id & CAN_ID_MASK) ^ 1


@case(
    "PDO-18",
    "New CAN-ID",
    "7.5.2.37: the TPDO comes under the CAN-ID given while it was disabled.",
    needs_tpdo,
    _has_sync,
)
def new_can_id(probe: Probe) -> None:
    pdo = tpdo(probe)
    configure(probe, pdo, 1)
    moved = _moved(disable(probe, pdo))
    write_number(probe, pdo.communication, PDO_COB_ID, moved | COB_INVALID)
    enable(probe, pdo, moved)
    operational(probe)
    probe.sync()
    probe.expect(moved & CAN_ID_MASK, "TPDO under its new CAN-ID")


@case(
    "PDO-19",
    "TPDO by NMT state",
    "7.3.2.2: sent in OPERATIONAL, not in PRE-OPERATIONAL and STOPPED.",
    needs_tpdo,
    _has_sync,
)
def tpdo_by_state(probe: Probe) -> None:
    pdo = tpdo(probe)
    probe.enter(ENTER_PRE_OPERATIONAL)
    configure(probe, pdo, 1)
    probe.sync()
    probe.silence(can_id(probe, pdo), "TPDO in PRE-OPERATIONAL")
    operational(probe)
    probe.sync()
    probe.expect(can_id(probe, pdo), "TPDO in OPERATIONAL")
    probe.enter(STOP)
    probe.sync()
    probe.silence(can_id(probe, pdo), "TPDO in STOPPED")
