"""Guarding and heartbeat together (BOTH): one excludes the other."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure, case
from smarttac_can.conformance.emcy_setup import emcy_id, needs_emcy
from smarttac_can.conformance.error_control import (
    LIFE_TIME_S,
    TOGGLE,
    ask_state,
    beats,
    end_heartbeat,
    needs_guarding,
    needs_life_time,
    needs_producer,
    no_answer,
    set_period,
    start_life_guarding,
)
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.sdo_client import number, write_number
from smarttac_can.device.nmt import NMTState
from smarttac_can.od.cia import (
    BOOT_UP,
    GUARD_TIME,
    HEARTBEAT_PRODUCER,
    LIFE_TIME_FACTOR,
    NMTCommand,
)


@case(
    "BOTH-01",
    "7.2.8.2.2: with a producer time other than 0 the heartbeat protocol is used.",
    needs_producer,
    needs_guarding,
)
def heartbeat_excludes(examiner: Examiner) -> None:
    """Heartbeat excludes guarding."""
    set_period(examiner)
    for _ in range(2):
        no_answer(examiner, "while there is a heartbeat")


@case(
    "BOTH-02",
    "7.2.8.2.2: with producer time 0 a remote frame is answered again.",
    needs_producer,
    needs_guarding,
)
def guarding_again(examiner: Examiner) -> None:
    """Guarding after the heartbeat."""
    set_period(examiner)
    beats(examiner)
    set_period(examiner, 0)
    examiner.settle()
    if ask_state(examiner) & ~TOGGLE not in (NMTState.OPERATIONAL, NMTState.PRE_OPERATIONAL):
        raise Failure("no state in the answer to guarding")


@case(
    "BOTH-03",
    "7.2.8.2.2: a producer time that is written during guarding starts the heartbeat.",
    needs_producer,
    needs_guarding,
)
def heartbeat_after_guarding(examiner: Examiner) -> None:
    """Heartbeat after guarding."""
    end_heartbeat(examiner)
    ask_state(examiner)
    ask_state(examiner)
    set_period(examiner)
    if any(state & TOGGLE for state in beats(examiner)):
        raise Failure("heartbeat with the toggle bit set")


@case(
    "BOTH-04",
    "7.2.8.2.2: with a heartbeat no life guarding error is reported.",
    needs_producer,
    needs_guarding,
    needs_life_time,
    needs_emcy,
)
def no_life_guarding(examiner: Examiner) -> None:
    """Life guarding under a heartbeat."""
    start_life_guarding(examiner)
    set_period(examiner)
    examiner.drain()
    examiner.send(examiner.heartbeat_id, rtr=True)
    examiner.silence(emcy_id(examiner), "EMCY of life guarding", LIFE_TIME_S + examiner.timeout)


@case(
    "BOTH-05",
    "7.2.8.3.3: whatever runs, a reset is told by one boot-up first.",
    needs_producer,
)
def boot_up_with_heartbeat(examiner: Examiner) -> None:
    """Boot-up with error control on."""
    set_period(examiner)
    beats(examiner)
    examiner.drain()
    examiner.nmt(NMTCommand.RESET_COMMUNICATION)
    arrivals = examiner.collect(examiner.heartbeat_id, 5 * examiner.timeout)
    boot_ups = [arrival.frame.data for arrival in arrivals].count(BOOT_UP)
    if boot_ups != 1:
        raise Failure(f"{boot_ups} boot-ups after reset communication")


@case(
    "BOTH-06",
    "7.3.2.2.2: guard time, life time factor and producer time are at their reset values.",
    needs_producer,
)
def parameters_reset(examiner: Examiner) -> None:
    """Parameters after reset communication."""
    present = [i for i in (GUARD_TIME, LIFE_TIME_FACTOR) if examiner.sheet.writable(i)]
    before = {i: number(examiner, i) for i in (*present, HEARTBEAT_PRODUCER)}
    for index in before:
        write_number(examiner, index, 0, 77)
    examiner.reset(NMTCommand.RESET_COMMUNICATION)
    for index, value in before.items():
        got = number(examiner, index)
        if got != value:
            raise Failure(f"{index:04X}h is {got} after reset communication, was {value}")


@case(
    "BOTH-07",
    "Table 38: heartbeat, or the answer to guarding, goes on in STOPPED.",
    needs_producer,
)
def in_stopped(examiner: Examiner) -> None:
    """Error control in STOPPED."""
    set_period(examiner)
    examiner.enter(NMTCommand.STOP)
    if set(beats(examiner)) != {NMTState.STOPPED}:
        raise Failure("the heartbeat in STOPPED does not say 4")
