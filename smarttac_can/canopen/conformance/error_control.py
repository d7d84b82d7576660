"""Error control: node and life guarding, heartbeat, and their mutual exclusion."""

from __future__ import annotations

from smarttac_can.canopen.conformance import refusals
from smarttac_can.canopen.conformance.case import (
    DeviceDescription,
    Failure,
    Group,
    case,
    needs_object,
)
from smarttac_can.canopen.conformance.emcy import (
    emcy_id,
    expect_emcy,
    heartbeat,
    lose_node,
    needs_consumer,
    needs_emcy,
    other_node,
)
from smarttac_can.canopen.conformance.examiner import Examiner, number, periodic, write_number
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import EmergencyCode, NMTCommand

PERIOD_MS = 60
_FACTOR = 3
TOGGLE = 0x80
STATES = {
    NMTCommand.START: NMTState.OPERATIONAL,
    NMTCommand.STOP: NMTState.STOPPED,
    NMTCommand.ENTER_PRE_OPERATIONAL: NMTState.PRE_OPERATIONAL,
}
"""NMT state after each command."""

needs_producer = needs_object(cia.HEARTBEAT_PRODUCER, writable=True)
needs_guarding = needs_object(cia.GUARD_TIME, writable=True)
needs_life_time = needs_object(cia.LIFE_TIME_FACTOR, writable=True)


def heartbeat_can_end(sheet: DeviceDescription) -> str | None:
    """Require that the heartbeat can be disabled, so that guarding is possible."""
    if sheet.od.number(cia.HEARTBEAT_PRODUCER) and not sheet.writable(cia.HEARTBEAT_PRODUCER):
        return "the EDS has a heartbeat that cannot be switched off"
    return None


def end_heartbeat(examiner: Examiner) -> None:
    """Disable the heartbeat, so that guarding is possible, and a default life guarding."""
    od = examiner.sheet.od
    if od.number(cia.GUARD_TIME) and od.number(cia.LIFE_TIME_FACTOR):
        write_number(examiner, cia.GUARD_TIME, 0, 0)
    if od.number(cia.HEARTBEAT_PRODUCER):
        set_period(examiner, 0)
        examiner.settle()


def ask_state(examiner: Examiner) -> int:
    """Request the NMT state by a remote frame; return the answer, state and toggle bit."""
    examiner.drain()
    examiner.send(examiner.heartbeat_id, rtr=True)
    data = examiner.expect(examiner.heartbeat_id, "answer to guarding").data
    if len(data) != 1:
        raise Failure(f"answer to guarding of {len(data)} bytes")
    return data[0]


def no_answer(examiner: Examiner, why: str) -> None:
    """Raise `Failure` if a remote frame is answered; a heartbeat never sets the toggle bit."""
    examiner.drain()
    examiner.send(examiner.heartbeat_id, rtr=True)
    for arrival in examiner.collect(examiner.heartbeat_id):
        if arrival.frame.data and arrival.frame.data[0] & TOGGLE:
            raise Failure(f"answer to guarding {why}")


def set_period(examiner: Examiner, period_ms: int = PERIOD_MS) -> None:
    """Write the producer time of the device's heartbeat in ms."""
    write_number(examiner, cia.HEARTBEAT_PRODUCER, 0, period_ms)


def beats(examiner: Examiner, period_ms: int = PERIOD_MS) -> list[int]:
    """Receive the heartbeats of 8 periods, and return the NMT states in them.

    Raises
    ------
    Failure
        Fewer than 3 heartbeats come, or their period is wrong.
    """
    arrivals = periodic(examiner, examiner.heartbeat_id, "heartbeat", "producer time", period_ms)
    for arrival in arrivals:
        if len(arrival.frame.data) != 1:
            raise Failure(f"heartbeat of {len(arrival.frame.data)} bytes")
    return [arrival.frame.data[0] for arrival in arrivals]


def start_life_guarding(examiner: Examiner) -> None:
    """Write guard time and life time factor, so that the device expects remote frames."""
    write_number(examiner, cia.GUARD_TIME, 0, PERIOD_MS)
    write_number(examiner, cia.LIFE_TIME_FACTOR, 0, _FACTOR)


LIFE_TIME_S = 1e-3 * PERIOD_MS * _FACTOR

# Node and life guarding (GUARD).


_guard = Group("GUARD", (needs_guarding, heartbeat_can_end))


@case(_guard, 1, "7.2.8.3.2.1: one byte, the toggle bit 0 in the first answer after boot-up.")
def guard_answer(examiner: Examiner) -> None:
    """Answer to a remote frame."""
    end_heartbeat(examiner)
    if ask_state(examiner) & TOGGLE:
        raise Failure("toggle bit 1 in the first answer")


@case(_guard, 2, "7.2.8.3.2.1: it alternates from answer to answer.")
def guard_toggle(examiner: Examiner) -> None:
    """Toggle bit."""
    end_heartbeat(examiner)
    toggles = [ask_state(examiner) & TOGGLE for _ in range(4)]
    if toggles != [0, TOGGLE, 0, TOGGLE]:
        raise Failure(f"toggle bits {[bool(t) for t in toggles]}")


@case(_guard, 3, "7.2.8.3.2.1: 4 stopped, 5 operational, 127 pre-operational.")
def guard_state(examiner: Examiner) -> None:
    """State in the answer."""
    end_heartbeat(examiner)
    for command, state in STATES.items():
        examiner.enter(command)
        got = ask_state(examiner) & ~TOGGLE
        if got != state:
            raise Failure(f"state {got} after NMT command {command:02X}h, not {state}")


@case(
    _guard,
    4,
    "7.2.8.2.2.1: no remote frame for guard time x life time factor gives EMCY 8130h.",
    needs_life_time,
    needs_emcy,
)
def life_guarding(examiner: Examiner) -> None:
    """Life guarding."""
    end_heartbeat(examiner)
    start_life_guarding(examiner)
    ask_state(examiner)
    expect_emcy(examiner, EmergencyCode.ERROR_CONTROL, LIFE_TIME_S + examiner.timeout)


@case(
    _guard,
    5,
    "7.2.8.2.2.1: it begins with the first remote frame, not before.",
    needs_life_time,
    needs_emcy,
)
def life_guarding_start(examiner: Examiner) -> None:
    """Start of life guarding."""
    end_heartbeat(examiner)
    start_life_guarding(examiner)
    examiner.silence(emcy_id(examiner), "EMCY before guarding began", LIFE_TIME_S + examiner.watch)


@case(_guard, 6, "7.2.8.3.2.1: reset communication sets it to 0.")
def guard_reset(examiner: Examiner) -> None:
    """Toggle bit after a reset."""
    end_heartbeat(examiner)
    ask_state(examiner)
    examiner.reset(NMTCommand.RESET_COMMUNICATION)
    end_heartbeat(examiner)
    if ask_state(examiner) & TOGGLE:
        raise Failure("toggle bit 1 in the first answer after reset communication")


# Heartbeat (HB).


_hb = Group("HB")


@case(_hb, 1, "7.2.8.3.3: one byte 0 under 700h + node-ID after a reset.")
def boot_up(examiner: Examiner) -> None:
    """Boot-up."""
    examiner.reset()


@case(
    _hb,
    2,
    "7.5.2.20: after a reset it is that of the EDS; 0 means silence.",
    needs_object(cia.HEARTBEAT_PRODUCER),
)
def default_period(examiner: Examiner) -> None:
    """Default producer time."""
    stated = examiner.sheet.od.number(cia.HEARTBEAT_PRODUCER)
    period = number(examiner, cia.HEARTBEAT_PRODUCER)
    if period != stated:
        raise Failure(f"producer time {period} ms, the EDS says {stated} ms")
    if period:
        beats(examiner, period)
    else:
        examiner.silence(examiner.heartbeat_id, "heartbeat without a producer time")


@case(_hb, 3, "7.5.2.20: a heartbeat every producer time.", needs_producer)
def period(examiner: Examiner) -> None:
    """Period."""
    set_period(examiner)
    beats(examiner)


@case(_hb, 4, "7.2.8.3.2.2: 4 stopped, 5 operational, 127 pre-operational.", needs_producer)
def heartbeat_state(examiner: Examiner) -> None:
    """State."""
    set_period(examiner)
    for command, state in STATES.items():
        examiner.enter(command)
        got = beats(examiner)[-1]
        if got != state:
            raise Failure(f"state {got} after NMT command {command:02X}h, not {state}")


@case(_hb, 5, "7.5.2.20: a new time is in force at once; 0 ends the heartbeat.", needs_producer)
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
    _hb,
    6,
    "7.2.8.2.2.2: a supervised node is missed after its first heartbeat, by EMCY 8130h.",
    needs_consumer,
    needs_emcy,
)
def consumer(examiner: Examiner) -> None:
    """Consumer."""
    write_number(examiner, cia.HEARTBEAT_CONSUMER, 1, other_node(examiner) << 16 | PERIOD_MS)
    examiner.silence(emcy_id(examiner), "EMCY before the first heartbeat")
    lose_node(examiner)
    heartbeat(examiner)


@case(
    _hb,
    7,
    "7.5.2.19: a node that is supervised already is refused by 06040043h.",
    needs_consumer,
    needs_object(cia.HEARTBEAT_CONSUMER, 2, writable=True),
)
def consumer_twice(examiner: Examiner) -> None:
    """Consumer of one node twice."""
    value = other_node(examiner) << 16 | 5000
    write_number(examiner, cia.HEARTBEAT_CONSUMER, 1, value)
    with examiner.refused("a second watch over one node", refusals.TAKEN_NODE):
        write_number(examiner, cia.HEARTBEAT_CONSUMER, 2, value)


# Guarding and heartbeat together (BOTH): they exclude each other.


_both = Group("BOTH", (needs_producer,))


@case(
    _both,
    1,
    "7.2.8.2.2: with a producer time other than 0 the heartbeat protocol is used.",
    needs_guarding,
)
def heartbeat_excludes(examiner: Examiner) -> None:
    """Heartbeat excludes guarding."""
    set_period(examiner)
    for _ in range(2):
        no_answer(examiner, "while there is a heartbeat")


@case(_both, 2, "7.2.8.2.2: with producer time 0 a remote frame is answered again.", needs_guarding)
def guarding_again(examiner: Examiner) -> None:
    """Guarding after the heartbeat."""
    set_period(examiner)
    beats(examiner)
    set_period(examiner, 0)
    examiner.settle()
    if ask_state(examiner) & ~TOGGLE not in (NMTState.OPERATIONAL, NMTState.PRE_OPERATIONAL):
        raise Failure("no state in the answer to guarding")


@case(
    _both,
    3,
    "7.2.8.2.2: a producer time that is written during guarding starts the heartbeat.",
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
    _both,
    4,
    "7.2.8.2.2: with a heartbeat no life guarding error is reported.",
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
    examiner.silence(emcy_id(examiner), "EMCY of life guarding", LIFE_TIME_S + examiner.watch)


@case(_both, 5, "7.2.8.3.3: whatever runs, one boot-up follows a reset.")
def boot_up_with_heartbeat(examiner: Examiner) -> None:
    """Boot-up with error control on."""
    set_period(examiner)
    beats(examiner)
    examiner.await_boot_up(NMTCommand.RESET_COMMUNICATION)
    others = [arrival.frame.data for arrival in examiner.collect(examiner.heartbeat_id)]
    if cia.BOOT_UP in others:
        raise Failure(f"{1 + others.count(cia.BOOT_UP)} boot-ups after reset communication")


@case(
    _both, 6, "7.3.2.2.2: guard time, life time factor and producer time are at their reset values."
)
def parameters_reset(examiner: Examiner) -> None:
    """Parameters after reset communication."""
    present = [i for i in (cia.GUARD_TIME, cia.LIFE_TIME_FACTOR) if examiner.sheet.writable(i)]
    before = {i: number(examiner, i) for i in (*present, cia.HEARTBEAT_PRODUCER)}
    for index in before:
        write_number(examiner, index, 0, 77)
    examiner.reset(NMTCommand.RESET_COMMUNICATION)
    for index, value in before.items():
        got = number(examiner, index)
        if got != value:
            raise Failure(f"{index:04X}h is {got} after reset communication, was {value}")


@case(_both, 7, "Table 38: heartbeat, or the answer to guarding, goes on in STOPPED.")
def in_stopped(examiner: Examiner) -> None:
    """Error control in STOPPED."""
    set_period(examiner)
    examiner.enter(NMTCommand.STOP)
    if set(beats(examiner)) != {NMTState.STOPPED}:
        raise Failure("the heartbeat in STOPPED does not say 4")
