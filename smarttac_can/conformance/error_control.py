"""What the cases of guarding and heartbeat have in common."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure
from smarttac_can.conformance.description import DeviceDescription, needs_object
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.periods import periodic
from smarttac_can.conformance.sdo_client import write_number
from smarttac_can.device.nmt import NMTState
from smarttac_can.od.cia import GUARD_TIME, HEARTBEAT_PRODUCER, LIFE_TIME_FACTOR, NMTCommand

PERIOD_MS = 60
_FACTOR = 3
TOGGLE = 0x80
STATES = {
    NMTCommand.START: NMTState.OPERATIONAL,
    NMTCommand.STOP: NMTState.STOPPED,
    NMTCommand.ENTER_PRE_OPERATIONAL: NMTState.PRE_OPERATIONAL,
}
"""To which state a command leads."""

needs_producer = needs_object(HEARTBEAT_PRODUCER, writable=True)
needs_guarding = needs_object(GUARD_TIME, writable=True)
needs_life_time = needs_object(LIFE_TIME_FACTOR, writable=True)


def heartbeat_can_end(sheet: DeviceDescription) -> str | None:
    """Require that the EDS lets node guarding take the heartbeat's place."""
    if sheet.od.number(HEARTBEAT_PRODUCER) and not sheet.writable(HEARTBEAT_PRODUCER):
        return "the EDS has a heartbeat that cannot be switched off"
    return None


def end_heartbeat(examiner: Examiner) -> None:
    """Switch the heartbeat off, which lets guarding take its place."""
    if examiner.sheet.od.number(HEARTBEAT_PRODUCER):
        set_period(examiner, 0)
        examiner.settle()


def ask_state(examiner: Examiner) -> int:
    """Ask for the NMT state by a remote frame; return the answer, state and toggle bit."""
    examiner.drain()
    examiner.send(examiner.heartbeat_id, rtr=True)
    data = examiner.expect(examiner.heartbeat_id, "answer to guarding").data
    if len(data) != 1:
        raise Failure(f"answer to guarding of {len(data)} bytes")
    return data[0]


def no_answer(examiner: Examiner, why: str) -> None:
    """Raise `Failure` if a remote frame is answered; a heartbeat has no toggle bit set."""
    examiner.drain()
    examiner.send(examiner.heartbeat_id, rtr=True)
    for arrival in examiner.collect(examiner.heartbeat_id):
        if arrival.frame.data and arrival.frame.data[0] & TOGGLE:
            raise Failure(f"answer to guarding {why}")


def set_period(examiner: Examiner, period_ms: int = PERIOD_MS) -> None:
    """Write the producer time of the device's heartbeat in ms."""
    write_number(examiner, HEARTBEAT_PRODUCER, 0, period_ms)


def beats(examiner: Examiner, period_ms: int = PERIOD_MS) -> list[int]:
    """Hear the heartbeats of 8 periods, and return the NMT states in them.

    Raises
    ------
    Failure
        If fewer than 3 come, or they do not keep the time.
    """
    arrivals = periodic(examiner, examiner.heartbeat_id, "heartbeat", "producer time", period_ms)
    for arrival in arrivals:
        if len(arrival.frame.data) != 1:
            raise Failure(f"heartbeat of {len(arrival.frame.data)} bytes")
    return [arrival.frame.data[0] for arrival in arrivals]


def start_life_guarding(examiner: Examiner) -> None:
    """Write guard time and life time factor, which make the device expect to be asked."""
    write_number(examiner, GUARD_TIME, 0, PERIOD_MS)
    write_number(examiner, LIFE_TIME_FACTOR, 0, _FACTOR)


LIFE_TIME_S = 1e-3 * PERIOD_MS * _FACTOR
