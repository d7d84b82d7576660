"""Heartbeat (HB)."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure, case
from smarttac_can.conformance.description import needs_object
from smarttac_can.conformance.emcy_setup import (
    emcy_id,
    heartbeat,
    lose_node,
    needs_consumer,
    needs_emcy,
    other_node,
)
from smarttac_can.conformance.error_control import (
    PERIOD_MS,
    STATES,
    beats,
    needs_producer,
    set_period,
)
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.sdo_client import number, write_number
from smarttac_can.od.cia import HEARTBEAT_CONSUMER, HEARTBEAT_PRODUCER, AbortCode


@case("HB-01", "7.2.8.3.3: one byte 0 under 700h + node-ID after a reset.")
def boot_up(examiner: Examiner) -> None:
    """Boot-up."""
    examiner.reset()


@case(
    "HB-02",
    "7.5.2.20: after a reset it is that of the EDS; 0 means silence.",
    needs_object(HEARTBEAT_PRODUCER),
)
def default_period(examiner: Examiner) -> None:
    """Default producer time."""
    stated = examiner.sheet.od.number(HEARTBEAT_PRODUCER)
    period = number(examiner, HEARTBEAT_PRODUCER)
    if period != stated:
        raise Failure(f"producer time {period} ms, the EDS says {stated} ms")
    if period:
        beats(examiner, period)
    else:
        examiner.silence(examiner.heartbeat_id, "heartbeat without a producer time")


@case("HB-03", "7.5.2.20: a heartbeat every producer time.", needs_producer)
def period(examiner: Examiner) -> None:
    """Period."""
    set_period(examiner)
    beats(examiner)


@case(
    "HB-04",
    "7.2.8.3.2.2: 4 stopped, 5 operational, 127 pre-operational.",
    needs_producer,
)
def heartbeat_state(examiner: Examiner) -> None:
    """State."""
    set_period(examiner)
    for command, state in STATES.items():
        examiner.enter(command)
        got = beats(examiner)[-1]
        if got != state:
            raise Failure(f"state {got} after NMT command {command:02X}h, not {state}")


@case(
    "HB-05",
    "7.5.2.20: a new time is in force at once; 0 ends the heartbeat.",
    needs_producer,
)
def new_period(examiner: Examiner) -> None:
    """New producer time."""
    set_period(examiner)
    beats(examiner)
    set_period(examiner, 2 * PERIOD_MS)
    examiner.settle()
    beats(examiner, 2 * PERIOD_MS)
    set_period(examiner, 0)
    examiner.settle()
    examiner.silence(examiner.heartbeat_id, "heartbeat after producer time 0")


@case(
    "HB-06",
    "7.2.8.2.2.2: a watched node is missed after its first heartbeat, by EMCY 8130h.",
    needs_consumer,
    needs_emcy,
)
def consumer(examiner: Examiner) -> None:
    """Consumer."""
    write_number(examiner, HEARTBEAT_CONSUMER, 1, other_node(examiner) << 16 | PERIOD_MS)
    examiner.silence(emcy_id(examiner), "EMCY before the first heartbeat")
    lose_node(examiner)
    heartbeat(examiner)


@case(
    "HB-07",
    "7.5.2.19: a node that is watched already is refused by 06040043h.",
    needs_consumer,
    needs_object(HEARTBEAT_CONSUMER, 2, writable=True),
)
def consumer_twice(examiner: Examiner) -> None:
    """Consumer of one node twice."""
    value = other_node(examiner) << 16 | 5000
    write_number(examiner, HEARTBEAT_CONSUMER, 1, value)
    examiner.refuse(
        lambda: write_number(examiner, HEARTBEAT_CONSUMER, 2, value),
        "a second watch over one node",
        AbortCode.PARAMETER,
    )
