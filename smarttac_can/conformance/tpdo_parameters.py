"""TPDO: parameters that are fixed while it is valid, its COB-ID, and NMT states."""

from __future__ import annotations

from functools import partial

from smarttac_can.conformance.case import Failure, NotApplicable, case
from smarttac_can.conformance.description import needs_object, needs_sync, needs_tpdo
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.pdo_setup import (
    can_id,
    configure,
    disable,
    enable,
    operational,
    started,
    tpdo,
)
from smarttac_can.conformance.sdo_client import number, write_number
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_INVALID,
    PDO_COB_ID,
    PDO_INHIBIT,
    PDO_SYNC_START,
    PDO_TRANSMISSION,
    SYNC_COUNTER,
    SYNC_PERIOD,
    NMTCommand,
)


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
