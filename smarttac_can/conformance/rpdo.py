"""RPDO: when its values are taken, its length and its deadline."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure, case, needs_object, needs_rpdo, needs_sync
from smarttac_can.conformance.emcy import expect_emcy
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.pdo import (
    can_id,
    changed,
    configure,
    configure_rpdo,
    disable,
    expect_values,
    operational,
    reads,
    rpdo,
)
from smarttac_can.od.cia import (
    EMCY_COB_ID,
    EVENT_MANUFACTURER,
    EmergencyCode,
    NMTCommand,
)

_DEADLINE_MS = 60


@case("PDO-20", "7.5.2.35: its values are taken at once.", needs_rpdo)
def event_driven(examiner: Examiner) -> None:
    """Event-driven RPDO."""
    pdo = rpdo(examiner)
    configure_rpdo(examiner, pdo, EVENT_MANUFACTURER)
    operational(examiner)
    data, wanted = changed(examiner, pdo)
    examiner.send(can_id(examiner, pdo), data)
    examiner.settle()
    expect_values(examiner, wanted, "after the RPDO")


@case(
    "PDO-21",
    "7.5.2.35: its values are taken at the next SYNC.",
    needs_rpdo,
    needs_sync,
)
def synchronous(examiner: Examiner) -> None:
    """Synchronous RPDO."""
    pdo = rpdo(examiner)
    configure_rpdo(examiner, pdo, 1)
    operational(examiner)
    data, wanted = changed(examiner, pdo)
    examiner.send(can_id(examiner, pdo), data)
    examiner.settle()
    if reads(examiner, wanted):
        raise Failure("the values of a synchronous RPDO are taken before SYNC")
    examiner.sync()
    examiner.settle()
    expect_values(examiner, wanted, "after SYNC")


@case(
    "PDO-22",
    "7.3.2.2: not taken in PRE-OPERATIONAL and STOPPED.",
    needs_rpdo,
)
def rpdo_by_state(examiner: Examiner) -> None:
    """RPDO by NMT state."""
    pdo = rpdo(examiner)
    examiner.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
    configure_rpdo(examiner, pdo, EVENT_MANUFACTURER)
    data, wanted = changed(examiner, pdo)
    for command, state in (
        (NMTCommand.ENTER_PRE_OPERATIONAL, "PRE-OPERATIONAL"),
        (NMTCommand.STOP, "STOPPED"),
    ):
        examiner.enter(command)
        examiner.send(can_id(examiner, pdo), data)
        examiner.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
        if reads(examiner, wanted):
            raise Failure(f"RPDO taken in {state}")


@case("PDO-23", "7.5.2.35: with bit 31 it is not taken.", needs_rpdo)
def disabled_rpdo(examiner: Examiner) -> None:
    """Disabled RPDO."""
    pdo = rpdo(examiner)
    configure_rpdo(examiner, pdo, EVENT_MANUFACTURER)
    disable(examiner, pdo)
    operational(examiner)
    data, wanted = changed(examiner, pdo)
    examiner.send(can_id(examiner, pdo), data)
    examiner.settle()
    if reads(examiner, wanted):
        raise Failure("RPDO taken that is disabled")


@case(
    "PDO-24",
    "7.2.2.5.1, 7.2.7.1: not taken; EMCY 8210h if the device has emergencies.",
    needs_rpdo,
)
def too_short(examiner: Examiner) -> None:
    """RPDO that is too short."""
    pdo = rpdo(examiner)
    configure_rpdo(examiner, pdo, EVENT_MANUFACTURER)
    operational(examiner)
    data, wanted = changed(examiner, pdo)
    examiner.drain()
    examiner.send(can_id(examiner, pdo), data[:-1])
    if examiner.sheet.has(EMCY_COB_ID):
        expect_emcy(examiner, EmergencyCode.PDO_LENGTH)
    if reads(examiner, wanted):
        raise Failure("RPDO taken that is too short")


@case(
    "PDO-25",
    "7.5.2.35: after the time without an RPDO comes EMCY 8250h; the next RPDO takes it back.",
    needs_rpdo,
    needs_object(EMCY_COB_ID),
)
def deadline(examiner: Examiner) -> None:
    """RPDO deadline."""
    pdo = rpdo(examiner)
    configure(examiner, pdo, EVENT_MANUFACTURER, event=_DEADLINE_MS)
    operational(examiner)
    data, _ = changed(examiner, pdo)
    examiner.send(can_id(examiner, pdo), data)
    expect_emcy(examiner, EmergencyCode.RPDO_TIME_OUT, _DEADLINE_MS * 1e-3 + examiner.timeout)
    examiner.send(can_id(examiner, pdo), data)
    expect_emcy(examiner, EmergencyCode.RESET)
