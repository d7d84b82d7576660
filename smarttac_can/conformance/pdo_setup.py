"""Putting PDOs into the state a case needs, by the procedure of CiA 301, 7.5.2.36."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from smarttac_can.conformance.case import Failure, NotApplicable
from smarttac_can.conformance.description import Pdo
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.sdo_client import number, upload, write_number
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_INVALID,
    COB_NO_RTR,
    EVENT_MANUFACTURER,
    PDO_COB_ID,
    PDO_EVENT,
    PDO_INHIBIT,
    PDO_SYNC_START,
    PDO_TRANSMISSION,
    Abort,
    NMTCommand,
)
from smarttac_can.od.data_types import pack
from smarttac_can.od.entry import Entry

_OWN_EVENTS = 3
_NAMES = {
    PDO_TRANSMISSION: "transmission type",
    PDO_INHIBIT: "inhibit time",
    PDO_EVENT: "event timer",
    PDO_SYNC_START: "SYNC start value",
}


def tpdo(examiner: Examiner) -> Pdo:
    """Return the first TPDO that can be configured."""
    return examiner.sheet.usable(examiner.sheet.tpdos)[0]


def rpdo(examiner: Examiner) -> Pdo:
    """Return the first RPDO that can be configured and whose values can be read back.

    Raises
    ------
    NotApplicable
        If there is none.
    """
    for pdo in examiner.sheet.usable(examiner.sheet.rpdos):
        if any(entry.readable for entry in entries(examiner, pdo)):
            return pdo
    raise NotApplicable("no RPDO carries a value that can be read back")


def can_id(examiner: Examiner, pdo: Pdo) -> int:
    """Return the CAN-ID that the data sheet gives a PDO."""
    return examiner.sheet.od.number(pdo.communication, PDO_COB_ID) & CAN_ID_MASK


def entries(examiner: Examiner, pdo: Pdo) -> list[Entry]:
    """Return the entries of the default mapping; dummies are left out."""
    found = (examiner.sheet.od.get(m >> 16, m >> 8 & 0xFF) for m in examiner.sheet.mapped(pdo))
    return [entry for entry in found if entry is not None]


def disable(examiner: Examiner, pdo: Pdo) -> int:
    """Set the invalid bit of a PDO; return its COB-ID on the device without that bit."""
    cob_id = number(examiner, pdo.communication, PDO_COB_ID)
    write_number(examiner, pdo.communication, PDO_COB_ID, cob_id | COB_INVALID)
    return cob_id & ~COB_INVALID | can_id(examiner, pdo)


def enable(examiner: Examiner, pdo: Pdo, cob_id: int) -> None:
    """Clear the invalid bit of a PDO, with this COB-ID."""
    write_number(examiner, pdo.communication, PDO_COB_ID, cob_id & ~COB_INVALID)


def configure(
    examiner: Examiner,
    pdo: Pdo,
    transmission: int,
    *,
    inhibit: int | None = None,
    event: int | None = None,
    start: int | None = None,
    rtr: bool | None = None,
) -> None:
    """Disable a PDO, write its parameters and enable it.

    Raises
    ------
    NotApplicable
        The EDS has no such parameter, or the device does not take the value.
    """
    cob_id = disable(examiner, pdo)
    wanted = {
        PDO_TRANSMISSION: transmission,
        PDO_INHIBIT: inhibit,
        PDO_EVENT: event,
        PDO_SYNC_START: start,
    }
    for subindex, value in wanted.items():
        if value is None:
            continue
        if not examiner.sheet.writable(pdo.communication, subindex):
            raise NotApplicable(f"{pdo.communication:04X}h has no {_NAMES[subindex]} to write")
        try:
            write_number(examiner, pdo.communication, subindex, value)
        except Abort as abort:
            reason = f"the device refuses {_NAMES[subindex]} {value}: {abort}"
            raise NotApplicable(reason) from None
    if rtr is not None:
        cob_id = cob_id & ~COB_NO_RTR if rtr else cob_id | COB_NO_RTR
    try:
        enable(examiner, pdo, cob_id)
    except Abort as abort:
        if rtr:
            raise NotApplicable(f"the device allows no RTR: {abort}") from None
        raise


def configure_rpdo(examiner: Examiner, pdo: Pdo, transmission: int) -> None:
    """Configure an RPDO without a deadline, whose end may undo what it brought."""
    watched = examiner.sheet.writable(pdo.communication, PDO_EVENT)
    configure(examiner, pdo, transmission, event=0 if watched else None)


def started(examiner: Examiner, transmission: int, **parameters: Any) -> Pdo:
    """Configure the first TPDO, with parameters of `configure`, and start the device."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, transmission, **parameters)
    operational(examiner)
    return pdo


def refuse_own_events(examiner: Examiner) -> None:
    """Raise `NotApplicable` if the application makes a TPDO go all the time by its own events."""
    timed = examiner.sheet.writable(tpdo(examiner).communication, PDO_EVENT)
    pdo = started(examiner, EVENT_MANUFACTURER, event=0 if timed else None)
    if len(examiner.collect(can_id(examiner, pdo))) > _OWN_EVENTS:
        raise NotApplicable("the application has events all the time")
    examiner.enter(NMTCommand.ENTER_PRE_OPERATIONAL)


def operational(examiner: Examiner) -> None:
    """Start the device and let the first event-driven TPDOs pass."""
    examiner.enter(NMTCommand.START)


def content(examiner: Examiner, mapped: Iterable[int]) -> bytes:
    """Read by SDO what a PDO with these mapping entries would carry now."""
    return b"".join(upload(examiner, m >> 16, m >> 8 & 0xFF)[: (m & 0xFF) // 8] for m in mapped)


def changed(examiner: Examiner, pdo: Pdo) -> tuple[bytes, list[tuple[Entry, bytes]]]:
    """Make the content of an RPDO with values other than the present ones.

    Returns
    -------
    tuple
        The content, and the bytes of each entry that can be read back.
    """
    data = b""
    wanted = []
    for mapping in examiner.sheet.mapped(pdo):
        size = (mapping & 0xFF) // 8
        entry = examiner.sheet.od.get(mapping >> 16, mapping >> 8 & 0xFF)
        if entry is None:
            data += bytes(size)
            continue
        part = entry.pack()
        if entry.readable:
            part = upload(examiner, entry.index, entry.subindex)
            present = entry.unpack(part)
            if isinstance(present, int | float):
                value = present + 1 if present + 1 <= entry.high else present - 1
                part = pack(entry.data_type, value)
            wanted.append((entry, part))
        data += part
    return data, wanted


def reads(examiner: Examiner, wanted: list[tuple[Entry, bytes]]) -> bool:
    """Tell whether all entries read as wanted."""
    return all(upload(examiner, e.index, e.subindex) == part for e, part in wanted)


def expect_values(examiner: Examiner, wanted: list[tuple[Entry, bytes]], when: str) -> None:
    """Raise `Failure` unless all entries read as wanted."""
    for entry, part in wanted:
        got = upload(examiner, entry.index, entry.subindex)
        if got != part:
            raise Failure(f"{entry.name} is {got.hex(' ')} {when}, not {part.hex(' ')}")
