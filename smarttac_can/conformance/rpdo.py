"""RPDO: when its values are taken, its length and its deadline."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure, case
from smarttac_can.conformance.emcy_setup import expect_emcy
from smarttac_can.conformance.pdo_setup import (
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
from smarttac_can.conformance.probe import Probe
from smarttac_can.conformance.sheet import needs_object, needs_rpdo
from smarttac_can.od.cia import (
    EMCY_COB_ID,
    EVENT_MANUFACTURER,
    SYNC_COB_ID,
    EmergencyCode,
    NMTCommand,
)

_has_sync = needs_object(SYNC_COB_ID)
_DEADLINE_MS = 60


@case("PDO-20", "7.5.2.35: its values are taken at once.", needs_rpdo)
def event_driven(probe: Probe) -> None:
    """Event-driven RPDO."""
    pdo = rpdo(probe)
    configure_rpdo(probe, pdo, EVENT_MANUFACTURER)
    operational(probe)
    data, wanted = changed(probe, pdo)
    probe.send(can_id(probe, pdo), data)
    probe.settle()
    expect_values(probe, wanted, "after the RPDO")


@case(
    "PDO-21",
    "7.5.2.35: its values are taken at the next SYNC.",
    needs_rpdo,
    _has_sync,
)
def synchronous(probe: Probe) -> None:
    """Synchronous RPDO."""
    pdo = rpdo(probe)
    configure_rpdo(probe, pdo, 1)
    operational(probe)
    data, wanted = changed(probe, pdo)
    probe.send(can_id(probe, pdo), data)
    probe.settle()
    if reads(probe, wanted):
        raise Failure("the values of a synchronous RPDO are taken before SYNC")
    probe.sync()
    probe.settle()
    expect_values(probe, wanted, "after SYNC")


@case(
    "PDO-22",
    "7.3.2.2: not taken in PRE-OPERATIONAL and STOPPED.",
    needs_rpdo,
)
def rpdo_by_state(probe: Probe) -> None:
    """RPDO by NMT state."""
    pdo = rpdo(probe)
    probe.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
    configure_rpdo(probe, pdo, EVENT_MANUFACTURER)
    data, wanted = changed(probe, pdo)
    for command, state in (
        (NMTCommand.ENTER_PRE_OPERATIONAL, "PRE-OPERATIONAL"),
        (NMTCommand.STOP, "STOPPED"),
    ):
        probe.enter(command)
        probe.send(can_id(probe, pdo), data)
        probe.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
        if reads(probe, wanted):
            raise Failure(f"RPDO taken in {state}")


@case("PDO-23", "7.5.2.35: with bit 31 it is not taken.", needs_rpdo)
def disabled_rpdo(probe: Probe) -> None:
    """Disabled RPDO."""
    pdo = rpdo(probe)
    configure_rpdo(probe, pdo, EVENT_MANUFACTURER)
    disable(probe, pdo)
    operational(probe)
    data, wanted = changed(probe, pdo)
    probe.send(can_id(probe, pdo), data)
    probe.settle()
    if reads(probe, wanted):
        raise Failure("RPDO taken that is disabled")


@case(
    "PDO-24",
    "7.2.2.5.1, 7.2.7.1: not taken; EMCY 8210h if the device has emergencies.",
    needs_rpdo,
)
def too_short(probe: Probe) -> None:
    """RPDO that is too short."""
    pdo = rpdo(probe)
    configure_rpdo(probe, pdo, EVENT_MANUFACTURER)
    operational(probe)
    data, wanted = changed(probe, pdo)
    probe.drain()
    probe.send(can_id(probe, pdo), data[:-1])
    if probe.sheet.has(EMCY_COB_ID):
        expect_emcy(probe, EmergencyCode.PDO_LENGTH)
    if reads(probe, wanted):
        raise Failure("RPDO taken that is too short")


@case(
    "PDO-25",
    "7.5.2.35: after the time without an RPDO comes EMCY 8250h; the next RPDO takes it back.",
    needs_rpdo,
    needs_object(EMCY_COB_ID),
)
def deadline(probe: Probe) -> None:
    """RPDO deadline."""
    pdo = rpdo(probe)
    configure(probe, pdo, EVENT_MANUFACTURER, event=_DEADLINE_MS)
    operational(probe)
    data, _ = changed(probe, pdo)
    probe.send(can_id(probe, pdo), data)
    expect_emcy(probe, EmergencyCode.RPDO_TIME_OUT, _DEADLINE_MS * 1e-3 + probe.timeout)
    probe.send(can_id(probe, pdo), data)
    expect_emcy(probe, EmergencyCode.RESET)
