"""Node and life guarding (GUARD)."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure, case
from smarttac_can.conformance.emcy_setup import emcy_id, expect_emcy, needs_emcy
from smarttac_can.conformance.error_control import (
    LIFE_TIME_S,
    STATES,
    TOGGLE,
    ask_state,
    end_heartbeat,
    heartbeat_can_end,
    needs_guarding,
    needs_life_time,
    start_life_guarding,
)
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.od.cia import EmergencyCode, NMTCommand


@case(
    "GUARD-01",
    "7.2.8.3.2.1: one byte, the toggle bit 0 in the first answer after boot-up.",
    needs_guarding,
    heartbeat_can_end,
)
def guard_answer(examiner: Examiner) -> None:
    """Answer to a remote frame."""
    end_heartbeat(examiner)
    if ask_state(examiner) & TOGGLE:
        raise Failure("toggle bit 1 in the first answer")


@case(
    "GUARD-02",
    "7.2.8.3.2.1: it alternates from answer to answer.",
    needs_guarding,
    heartbeat_can_end,
)
def guard_toggle(examiner: Examiner) -> None:
    """Toggle bit."""
    end_heartbeat(examiner)
    toggles = [ask_state(examiner) & TOGGLE for _ in range(4)]
    if toggles != [0, TOGGLE, 0, TOGGLE]:
        raise Failure(f"toggle bits {[bool(t) for t in toggles]}")


@case(
    "GUARD-03",
    "7.2.8.3.2.1: 4 stopped, 5 operational, 127 pre-operational.",
    needs_guarding,
    heartbeat_can_end,
)
def guard_state(examiner: Examiner) -> None:
    """State in the answer."""
    end_heartbeat(examiner)
    for command, state in STATES.items():
        examiner.enter(command)
        got = ask_state(examiner) & ~TOGGLE
        if got != state:
            raise Failure(f"state {got} after NMT command {command:02X}h, not {state}")


@case(
    "GUARD-04",
    "7.2.8.2.2.1: no remote frame for guard time x life time factor gives EMCY 8130h.",
    needs_guarding,
    needs_life_time,
    heartbeat_can_end,
    needs_emcy,
)
def life_guarding(examiner: Examiner) -> None:
    """Life guarding."""
    end_heartbeat(examiner)
    start_life_guarding(examiner)
    ask_state(examiner)
    expect_emcy(examiner, EmergencyCode.ERROR_CONTROL, LIFE_TIME_S + examiner.timeout)


@case(
    "GUARD-05",
    "7.2.8.2.2.1: it begins with the first remote frame, not before.",
    needs_guarding,
    needs_life_time,
    heartbeat_can_end,
    needs_emcy,
)
def life_guarding_start(examiner: Examiner) -> None:
    """Start of life guarding."""
    end_heartbeat(examiner)
    start_life_guarding(examiner)
    examiner.silence(
        emcy_id(examiner), "EMCY before guarding began", LIFE_TIME_S + examiner.timeout
    )


@case(
    "GUARD-06",
    "7.2.8.3.2.1: reset communication sets it to 0.",
    needs_guarding,
    heartbeat_can_end,
)
def guard_reset(examiner: Examiner) -> None:
    """Toggle bit after a reset."""
    end_heartbeat(examiner)
    ask_state(examiner)
    examiner.reset(NMTCommand.RESET_COMMUNICATION)
    end_heartbeat(examiner)
    if ask_state(examiner) & TOGGLE:
        raise Failure("toggle bit 1 in the first answer after reset communication")
