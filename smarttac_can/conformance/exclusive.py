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
from smarttac_can.conformance.probe import Probe
from smarttac_can.conformance.sdo_client import number, write_number
from smarttac_can.od.cia import GUARD_TIME, HEARTBEAT_PRODUCER, LIFE_TIME_FACTOR, NMTCommand


@case(
    "BOTH-01",
    "7.2.8.2.2: with a producer time other than 0 the heartbeat protocol is used.",
    needs_producer,
    needs_guarding,
)
def heartbeat_excludes(probe: Probe) -> None:
    """Heartbeat excludes guarding."""
    set_period(probe)
    for _ in range(2):
        no_answer(probe, "while there is a heartbeat")


@case(
    "BOTH-02",
    "7.2.8.2.2: with producer time 0 a remote frame is answered again.",
    needs_producer,
    needs_guarding,
)
def guarding_again(probe: Probe) -> None:
    """Guarding after the heartbeat."""
    set_period(probe)
    beats(probe)
    set_period(probe, 0)
    probe.settle()
    if ask_state(probe) & ~TOGGLE not in (0x05, 0x7F):
        raise Failure("no state in the answer to guarding")


@case(
    "BOTH-03",
    "7.2.8.2.2: a producer time that is written during guarding starts the heartbeat.",
    needs_producer,
    needs_guarding,
)
def heartbeat_after_guarding(probe: Probe) -> None:
    """Heartbeat after guarding."""
    end_heartbeat(probe)
    ask_state(probe)
    ask_state(probe)
    set_period(probe)
    if any(state & TOGGLE for state in beats(probe)):
        raise Failure("heartbeat with the toggle bit set")


@case(
    "BOTH-04",
    "7.2.8.2.2: with a heartbeat no life guarding error is reported.",
    needs_producer,
    needs_guarding,
    needs_life_time,
    needs_emcy,
)
def no_life_guarding(probe: Probe) -> None:
    """Life guarding under a heartbeat."""
    start_life_guarding(probe)
    set_period(probe)
    probe.drain()
    probe.send(probe.heartbeat_id, rtr=True)
    probe.silence(emcy_id(probe), "EMCY of life guarding", LIFE_TIME_S + probe.timeout)


@case(
    "BOTH-05",
    "7.2.8.3.3: whatever runs, a reset is told by one boot-up first.",
    needs_producer,
)
def boot_up_with_heartbeat(probe: Probe) -> None:
    """Boot-up with error control on."""
    set_period(probe)
    beats(probe)
    probe.drain()
    probe.nmt(NMTCommand.RESET_COMMUNICATION)
    arrivals = probe.collect(probe.heartbeat_id, 5 * probe.timeout)
    boot_ups = [arrival.frame.data for arrival in arrivals].count(b"\0")
    if boot_ups != 1:
        raise Failure(f"{boot_ups} boot-ups after reset communication")


@case(
    "BOTH-06",
    "7.3.2.2.2: guard time, life time factor and producer time are at their reset values.",
    needs_producer,
)
def parameters_reset(probe: Probe) -> None:
    """Parameters after reset communication."""
    present = [i for i in (GUARD_TIME, LIFE_TIME_FACTOR) if probe.sheet.writable(i)]
    before = {i: number(probe, i) for i in (*present, HEARTBEAT_PRODUCER)}
    for index in before:
        write_number(probe, index, 0, 77)
    probe.reset(NMTCommand.RESET_COMMUNICATION)
    for index, value in before.items():
        got = number(probe, index)
        if got != value:
            raise Failure(f"{index:04X}h is {got} after reset communication, was {value}")


@case(
    "BOTH-07",
    "Table 38: heartbeat, or the answer to guarding, goes on in STOPPED.",
    needs_producer,
)
def in_stopped(probe: Probe) -> None:
    """Error control in STOPPED."""
    set_period(probe)
    probe.enter(NMTCommand.STOP)
    if set(beats(probe)) != {0x04}:
        raise Failure("the heartbeat in STOPPED does not say 4")
