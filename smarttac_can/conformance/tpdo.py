"""TPDO: transmission types, timers, remote frames, fixed parameters, COB-ID and NMT states."""

from __future__ import annotations

from functools import partial

from smarttac_can.conformance.case import (
    Failure,
    NotApplicable,
    Pdo,
    case,
    needs_object,
    needs_sync,
    needs_tpdo,
)
from smarttac_can.conformance.examiner import (
    LEAST,
    PERIODS,
    SPREAD,
    Examiner,
    mean_gap_ms,
    number,
    write_number,
)
from smarttac_can.conformance.pdo import (
    can_id,
    configure,
    content,
    disable,
    enable,
    operational,
    refuse_own_events,
    started,
    tpdo,
)
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
    SYNC_COUNTER,
    SYNC_PERIOD,
    NMTCommand,
)

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


# Parameters that are fixed while it is valid, its COB-ID, and NMT states.


def _fixed_while_valid(examiner: Examiner, subindex: int, value: int, name: str) -> None:
    pdo = tpdo(examiner)
    if not examiner.sheet.writable(pdo.communication, subindex):
        raise NotApplicable(f"{pdo.communication:04X}h has no {name} to write")
    enable(examiner, pdo, disable(examiner, pdo))
    examiner.refuse(
        lambda: write_number(examiner, pdo.communication, subindex, value),
        f"{name} of a valid TPDO",
    )


@case(
    "PDO-12",
    "7.5.2.37: it cannot be changed while the PDO exists.",
    needs_tpdo,
)
def inhibit_time_fixed(examiner: Examiner) -> None:
    """Inhibit time of a valid TPDO."""
    _fixed_while_valid(examiner, PDO_INHIBIT, 100, "inhibit time")


@case(
    "PDO-13",
    "7.5.2.37: the SYNC whose counter is the start value is the first one counted.",
    needs_tpdo,
    needs_object(SYNC_COUNTER, writable=True),
)
def start_value(examiner: Examiner) -> None:
    """SYNC start value."""
    period = number(examiner, SYNC_PERIOD) if examiner.sheet.writable(SYNC_PERIOD) else 0
    if period:
        write_number(examiner, SYNC_PERIOD, 0, 0)
    write_number(examiner, SYNC_COUNTER, 0, 10)
    if period:
        write_number(examiner, SYNC_PERIOD, 0, period)
    pdo = started(examiner, 1, start=3)
    for counter in (1, 2):
        examiner.sync(counter)
        examiner.silence(can_id(examiner, pdo), f"TPDO at counter {counter}, start value 3")
    examiner.sync(3)
    examiner.expect(can_id(examiner, pdo), "TPDO at its start value")


@case(
    "PDO-14",
    "7.5.2.37: it cannot be changed while the PDO exists.",
    needs_tpdo,
)
def start_value_fixed(examiner: Examiner) -> None:
    """SYNC start value of a valid TPDO."""
    _fixed_while_valid(examiner, PDO_SYNC_START, 5, "SYNC start value")


@case(
    "PDO-15",
    "7.5.2.37: types 241 to 251 are refused.",
    needs_tpdo,
)
def reserved_types(examiner: Examiner) -> None:
    """Reserved transmission types."""
    pdo = tpdo(examiner)
    disable(examiner, pdo)
    for value in (241, 251):
        examiner.refuse(
            partial(write_number, examiner, pdo.communication, PDO_TRANSMISSION, value),
            f"transmission type {value}",
        )


@case("PDO-16", "7.5.2.37: with bit 31 it is silent.", needs_tpdo, needs_sync)
def disabled(examiner: Examiner) -> None:
    """Disabled TPDO."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, 1)
    disable(examiner, pdo)
    operational(examiner)
    examiner.sync()
    examiner.silence(can_id(examiner, pdo), "TPDO that is disabled")


@case(
    "PDO-17",
    "7.5.2.37: bits 0 to 29 cannot be changed while the PDO exists.",
    needs_tpdo,
)
def can_id_fixed(examiner: Examiner) -> None:
    """CAN-ID of a valid TPDO."""
    pdo = tpdo(examiner)
    cob_id = disable(examiner, pdo)
    enable(examiner, pdo, cob_id)
    examiner.refuse(
        lambda: write_number(examiner, pdo.communication, PDO_COB_ID, _moved(cob_id)),
        "another CAN-ID of a valid TPDO",
    )
    if number(examiner, pdo.communication, PDO_COB_ID) & CAN_ID_MASK != cob_id & CAN_ID_MASK:
        raise Failure("the refused CAN-ID was taken")


def _moved(cob_id: int) -> int:
    return cob_id & ~CAN_ID_MASK | (cob_id & CAN_ID_MASK) ^ 1


@case(
    "PDO-18",
    "7.5.2.37: the TPDO comes under the CAN-ID given while it was disabled.",
    needs_tpdo,
    needs_sync,
)
def new_can_id(examiner: Examiner) -> None:
    """New CAN-ID."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, 1)
    moved = _moved(disable(examiner, pdo))
    write_number(examiner, pdo.communication, PDO_COB_ID, moved | COB_INVALID)
    enable(examiner, pdo, moved)
    operational(examiner)
    examiner.sync()
    examiner.expect(moved & CAN_ID_MASK, "TPDO under its new CAN-ID")


@case(
    "PDO-19",
    "7.3.2.2: sent in OPERATIONAL, not in PRE-OPERATIONAL and STOPPED.",
    needs_tpdo,
    needs_sync,
)
def tpdo_by_state(examiner: Examiner) -> None:
    """TPDO by NMT state."""
    pdo = tpdo(examiner)
    examiner.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
    configure(examiner, pdo, 1)
    examiner.sync()
    examiner.silence(can_id(examiner, pdo), "TPDO in PRE-OPERATIONAL")
    operational(examiner)
    examiner.sync()
    examiner.expect(can_id(examiner, pdo), "TPDO in OPERATIONAL")
    examiner.enter(NMTCommand.STOP)
    examiner.sync()
    examiner.silence(can_id(examiner, pdo), "TPDO in STOPPED")
