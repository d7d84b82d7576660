"""PDO: configuration of PDOs for a case; TPDOs, RPDOs, and their mapping."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from smarttac_can.canopen.conformance import refusals
from smarttac_can.canopen.conformance.case import (
    Failure,
    Group,
    NotApplicable,
    Pdo,
    case,
    needs_mapping,
    needs_object,
    needs_rpdo,
    needs_sync,
    needs_tpdo,
)
from smarttac_can.canopen.conformance.emcy import expect_emcy, needs_emcy
from smarttac_can.canopen.conformance.examiner import (
    LEAST,
    PERIODS,
    SPREAD,
    Examiner,
    mean_gap_ms,
    number,
    try_number,
    upload,
    write_number,
)
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, DataType, EmergencyCode, NMTCommand
from smarttac_can.canopen.od.data_types import SIZES, pack
from smarttac_can.canopen.od.entry import Entry

# Configuration of PDOs for a case, by the procedure of CiA 301, 7.5.2.36.


_OWN_EVENTS = 3
_NAMES = {
    cia.PDO_TRANSMISSION: "transmission type",
    cia.PDO_INHIBIT: "inhibit time",
    cia.PDO_EVENT: "event timer",
    cia.PDO_SYNC_START: "SYNC start value",
}


def tpdo(examiner: Examiner, *, rtr: bool | None = None) -> Pdo:
    """Return the first TPDO that can be configured, for ``rtr`` one that allows remote frames.

    Raises
    ------
    NotApplicable
        Bit 30 of the COB-IDs in the EDS allows no remote frame.
    """
    pdos = examiner.sheet.usable(examiner.sheet.tpdos)
    if rtr:
        pdos = [pdo for pdo in pdos if examiner.sheet.allows_rtr(pdo)]
        if not pdos:
            raise NotApplicable("the EDS has bit 30 (no RTR) of the COB-ID of every TPDO set")
    return pdos[0]


def rpdo(examiner: Examiner) -> Pdo:
    """Return the first RPDO that can be configured and whose values can be read back.

    Raises
    ------
    NotApplicable
        There is none.
    """
    for pdo in examiner.sheet.usable(examiner.sheet.rpdos):
        if any(entry.readable for entry in entries(examiner, pdo)):
            return pdo
    raise NotApplicable("no RPDO carries a value that can be read back")


def can_id(examiner: Examiner, pdo: Pdo) -> int:
    """Return the CAN-ID of a PDO in the EDS."""
    return examiner.sheet.od.number(pdo.communication, cia.PDO_COB_ID) & cia.CAN_ID_MASK


def entries(examiner: Examiner, pdo: Pdo) -> list[Entry]:
    """Return the entries of the default mapping, without dummies."""
    found = (examiner.sheet.od.get(m >> 16, m >> 8 & 0xFF) for m in examiner.sheet.mapped(pdo))
    return [entry for entry in found if entry is not None]


def disable(examiner: Examiner, pdo: Pdo) -> int:
    """Set the invalid bit of a PDO; return its present COB-ID without that bit."""
    cob_id = number(examiner, pdo.communication, cia.PDO_COB_ID)
    write_number(examiner, pdo.communication, cia.PDO_COB_ID, cob_id | cia.COB_INVALID)
    return cob_id & ~cia.COB_INVALID | can_id(examiner, pdo)


def enable(examiner: Examiner, pdo: Pdo, cob_id: int) -> None:
    """Write a COB-ID of a PDO with the invalid bit cleared."""
    write_number(examiner, pdo.communication, cia.PDO_COB_ID, cob_id & ~cia.COB_INVALID)


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

    What the device starts by its default values is stopped first, and other parameters of the PDO
    with a default value are set to 0: they could delay the PDO or trigger it.

    Raises
    ------
    NotApplicable
        The EDS has no such parameter or limits it, or the device refuses the value.
    """
    if examiner.sheet.starts_itself:
        examiner.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
    stop_sync(examiner)
    cob_id = disable(examiner, pdo)
    wanted = {
        cia.PDO_TRANSMISSION: transmission,
        cia.PDO_INHIBIT: inhibit,
        cia.PDO_EVENT: event,
        cia.PDO_SYNC_START: start,
    }
    for subindex, value in wanted.items():
        if value is None:
            _clear(examiner, pdo, subindex)
            continue
        if not examiner.sheet.writable(pdo.communication, subindex):
            raise NotApplicable(f"{pdo.communication:04X}h has no {_NAMES[subindex]} to write")
        try:
            write_number(examiner, pdo.communication, subindex, value)
        except Abort as abort:
            reason = f"the device refuses {_NAMES[subindex]} {value}: {abort}"
            raise NotApplicable(reason) from None
    if rtr is not None:
        cob_id = cob_id & ~cia.COB_NO_RTR if rtr else cob_id | cia.COB_NO_RTR
    try:
        enable(examiner, pdo, cob_id)
    except Abort as abort:
        if rtr is not None:
            raise NotApplicable(f"the device keeps bit 30 (no RTR): {abort}") from None
        raise


def _clear(examiner: Examiner, pdo: Pdo, subindex: int) -> None:
    """Set a parameter of a PDO to 0 that has another default value, if the EDS allows it."""
    sheet = examiner.sheet
    if (
        sheet.od.number(pdo.communication, subindex)
        and sheet.writable(pdo.communication, subindex)
        and sheet.limits(pdo.communication, subindex, 0) is None
    ):
        write_number(examiner, pdo.communication, subindex, 0)


def stop_sync(examiner: Examiner) -> None:
    """Stop the SYNC that a device produces by its default values, as the case sends its own.

    Raises
    ------
    NotApplicable
        The EDS has no way to stop it.
    """
    sheet = examiner.sheet
    if not sheet.produces_sync:
        return
    silent = number(examiner, cia.SYNC_COB_ID) & ~cia.COB_SYNC_PRODUCER
    for index, value in ((cia.SYNC_PERIOD, 0), (cia.SYNC_COB_ID, silent)):
        if sheet.writable(index) and sheet.limits(index, 0, value) is None:
            write_number(examiner, index, 0, value)
            return
    raise NotApplicable("the device produces SYNC, and the EDS has no way to stop it")


def configure_rpdo(examiner: Examiner, pdo: Pdo, transmission: int) -> None:
    """Configure an RPDO without a deadline, as its expiry could change the received values."""
    watched = examiner.sheet.writable(pdo.communication, cia.PDO_EVENT)
    configure(examiner, pdo, transmission, event=0 if watched else None)


def started(examiner: Examiner, transmission: int, **parameters: Any) -> Pdo:
    """Configure the first TPDO with parameters of `configure`, and start the device."""
    pdo = tpdo(examiner, rtr=parameters.get("rtr"))
    configure(examiner, pdo, transmission, **parameters)
    operational(examiner)
    return pdo


def refuse_own_events(examiner: Examiner) -> None:
    """Raise `NotApplicable` if the application triggers a TPDO all the time."""
    timed = examiner.sheet.writable(tpdo(examiner).communication, cia.PDO_EVENT)
    pdo = started(examiner, cia.EVENT_MANUFACTURER, event=0 if timed else None)
    if len(examiner.collect(can_id(examiner, pdo))) > _OWN_EVENTS:
        raise NotApplicable("the application has events all the time")
    examiner.enter(NMTCommand.ENTER_PRE_OPERATIONAL)


def operational(examiner: Examiner) -> None:
    """Start the device, and drop the first event-driven TPDOs."""
    examiner.enter(NMTCommand.START)


def content(examiner: Examiner, mapped: Iterable[int]) -> bytes:
    """Read by SDO the present content of a PDO with these mapping entries."""
    return b"".join(upload(examiner, m >> 16, m >> 8 & 0xFF)[: (m & 0xFF) // 8] for m in mapped)


def changed(examiner: Examiner, pdo: Pdo) -> tuple[bytes, list[tuple[Entry, bytes]]]:
    """Return a content of an RPDO with values other than the present ones.

    Returns
    -------
    tuple
        Content, and the bytes of each number that can be changed and read back.

    Raises
    ------
    NotApplicable
        There is no such number.
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
            if isinstance(present, int | float) and entry.high > entry.low:
                value = present + 1 if present + 1 <= entry.high else present - 1
                part = pack(entry.data_type, value)
                wanted.append((entry, part))
        data += part
    if not wanted:
        raise NotApplicable("the RPDO carries no number that can be changed and read back")
    return data, wanted


def reads(examiner: Examiner, wanted: list[tuple[Entry, bytes]]) -> bool:
    """Return whether all entries have the wanted values."""
    return all(upload(examiner, e.index, e.subindex) == part for e, part in wanted)


def expect_values(examiner: Examiner, wanted: list[tuple[Entry, bytes]], when: str) -> None:
    """Raise `Failure` unless all entries have the wanted values."""
    for entry, part in wanted:
        got = upload(examiner, entry.index, entry.subindex)
        if got != part:
            raise Failure(f"{entry.name} is {got.hex(' ')} {when}, not {part.hex(' ')}")


# TPDO: transmission types, timers, remote frames, fixed parameters, COB-ID and NMT states.


PERIOD_MS = 60
"""Event timer and inhibit time in ms that the cases set."""


def _first_sync(examiner: Examiner, pdo: Pdo, most: int) -> int:
    """Send SYNC until the TPDO is received; return the number of SYNCs.

    Raises
    ------
    Failure
        The TPDO is not received after ``most`` SYNCs.
    """
    for count in range(1, most + 1):
        examiner.sync()
        if examiner.wait(can_id(examiner, pdo), examiner.watch) is not None:
            return count
    raise Failure(f"no TPDO after {most} SYNCs")


def _cyclic(examiner: Examiner, transmission: int) -> None:
    pdo = started(examiner, transmission)
    _first_sync(examiner, pdo, transmission)
    for _ in range(2):
        count = _first_sync(examiner, pdo, transmission)
        if count != transmission:
            raise Failure(f"type {transmission} sent after {count} SYNCs")


_tpdo = Group("PDO", (needs_tpdo,))


@case(
    _tpdo, 1, "7.2.2: a TPDO carries the mapped entries in their order, little-endian.", needs_sync
)
def tpdo_content(examiner: Examiner) -> None:
    """Content."""
    pdo = started(examiner, 1)
    mapped = examiner.sheet.mapped(pdo)
    for _ in range(3):
        before = content(examiner, mapped)
        examiner.drain()
        examiner.sync()
        data = examiner.expect(can_id(examiner, pdo), "TPDO at SYNC").data
        if len(data) != len(before):
            raise Failure(f"TPDO of {len(data)} bytes, its mapping has {len(before)}")
        after = content(examiner, mapped)
        moving = [a != b for a, b in zip(before, after, strict=True)]
        if all(m or d == b for m, d, b in zip(moving, data, before, strict=True)):
            return
    raise Failure(f"TPDO carries {data.hex(' ')}, the entries are {before.hex(' ')}")


@case(_tpdo, 2, "7.5.2.37: sent at every SYNC.", needs_sync)
def every_sync(examiner: Examiner) -> None:
    """Type 1."""
    _cyclic(examiner, 1)


@case(_tpdo, 3, "7.5.2.37: type n is sent at every n-th SYNC.", needs_sync)
def every_third_sync(examiner: Examiner) -> None:
    """Type 3."""
    _cyclic(examiner, 3)


@case(_tpdo, 4, "7.5.2.37: sent at the SYNC after an event, not at SYNCs without one.", needs_sync)
def acyclic(examiner: Examiner) -> None:
    """Type 0."""
    refuse_own_events(examiner)
    pdo = started(examiner, 0)
    examiner.sync()
    examiner.settle()
    for _ in range(2):
        examiner.sync()
        examiner.silence(can_id(examiner, pdo), "TPDO of type 0 without an event")


def _remote(examiner: Examiner, pdo: Pdo) -> None:
    examiner.drain()
    examiner.send(can_id(examiner, pdo), rtr=True)


@case(_tpdo, 5, "7.5.2.37: sampled at SYNC, sent on a remote frame only.", needs_sync)
def remote_sampled(examiner: Examiner) -> None:
    """Type 252."""
    pdo = started(examiner, cia.RTR_SYNC, rtr=True)
    examiner.sync()
    examiner.silence(can_id(examiner, pdo), "TPDO of type 252 at SYNC")
    _remote(examiner, pdo)
    examiner.expect(can_id(examiner, pdo), "TPDO on a remote frame")


@case(_tpdo, 6, "7.5.2.37: sent on a remote frame at once.")
def remote(examiner: Examiner) -> None:
    """Type 253."""
    pdo = started(examiner, cia.RTR_EVENT, rtr=True)
    _remote(examiner, pdo)
    examiner.expect(can_id(examiner, pdo), "TPDO on a remote frame")


@case(_tpdo, 7, "7.5.2.37: with bit 30 of the COB-ID clear a remote frame is answered.")
def remote_event_driven(examiner: Examiner) -> None:
    """Remote frame to an event-driven TPDO."""
    pdo = started(examiner, cia.EVENT_MANUFACTURER, rtr=True)
    _remote(examiner, pdo)
    examiner.expect(can_id(examiner, pdo), "TPDO on a remote frame")


@case(
    _tpdo, 8, "7.5.2.37: with bit 30 of the COB-ID set a remote frame is not answered.", needs_sync
)
def remote_not_allowed(examiner: Examiner) -> None:
    """Remote frame that is not allowed."""
    pdo = started(examiner, 1, rtr=False)
    _remote(examiner, pdo)
    examiner.silence(can_id(examiner, pdo), "answer to a remote frame")


def _gap_ms(examiner: Examiner, pdo: Pdo) -> float:
    """Return the mean time in ms between TPDOs without a SYNC or a request.

    Raises
    ------
    Failure
        Fewer than 3 are received in 8 periods.
    """
    came = examiner.collect(can_id(examiner, pdo), 1e-3 * PERIODS * PERIOD_MS)
    if len(came) < LEAST:
        raise Failure(f"{len(came)} TPDOs in {PERIODS * PERIOD_MS} ms, event timer {PERIOD_MS} ms")
    return mean_gap_ms(came)


@case(_tpdo, 9, "7.5.2.37: sent when the time has passed.")
def event_timer(examiner: Examiner) -> None:
    """Event timer."""
    refuse_own_events(examiner)
    pdo = started(examiner, cia.EVENT_MANUFACTURER, event=PERIOD_MS)
    mean = _gap_ms(examiner, pdo)
    if abs(mean - PERIOD_MS) > SPREAD * PERIOD_MS:
        raise Failure(f"TPDO every {mean:.0f} ms, event timer {PERIOD_MS} ms")


@case(_tpdo, 10, "7.5.2.37: with time 0 nothing is sent by time.")
def event_timer_off(examiner: Examiner) -> None:
    """Event timer off."""
    pdo = started(examiner, 1, event=0)
    examiner.silence(can_id(examiner, pdo), "TPDO without SYNC and timer")


@case(_tpdo, 11, "7.5.2.37: the least time between two TPDOs.")
def inhibit_time(examiner: Examiner) -> None:
    """Inhibit time."""
    pdo = started(examiner, cia.EVENT_MANUFACTURER, inhibit=10 * PERIOD_MS, event=PERIOD_MS // 4)
    mean = _gap_ms(examiner, pdo)
    if mean < (1 - SPREAD / 2) * PERIOD_MS:
        raise Failure(f"TPDO every {mean:.0f} ms, inhibit time {PERIOD_MS} ms")


# Parameters that are fixed while the PDO is valid, COB-ID, and NMT states.


def _fixed_while_valid(examiner: Examiner, subindex: int, value: int, name: str) -> None:
    pdo = tpdo(examiner)
    if not examiner.sheet.writable(pdo.communication, subindex):
        raise NotApplicable(f"{pdo.communication:04X}h has no {name} to write")
    enable(examiner, pdo, disable(examiner, pdo))
    with examiner.refused(f"{name} of a valid TPDO"):
        write_number(examiner, pdo.communication, subindex, value)


@case(_tpdo, 12, "7.5.2.37: it cannot be changed while the PDO exists.")
def inhibit_time_fixed(examiner: Examiner) -> None:
    """Inhibit time of a valid TPDO."""
    _fixed_while_valid(examiner, cia.PDO_INHIBIT, 100, "inhibit time")


@case(
    _tpdo,
    13,
    "7.5.2.37: the SYNC whose counter is the start value is the first one counted.",
    needs_object(cia.SYNC_COUNTER, writable=True),
)
def start_value(examiner: Examiner) -> None:
    """SYNC start value."""
    period = number(examiner, cia.SYNC_PERIOD) if examiner.sheet.writable(cia.SYNC_PERIOD) else 0
    if period:
        write_number(examiner, cia.SYNC_PERIOD, 0, 0)
    write_number(examiner, cia.SYNC_COUNTER, 0, 10)
    if period:
        write_number(examiner, cia.SYNC_PERIOD, 0, period)
    pdo = started(examiner, 1, start=3)
    for counter in (1, 2):
        examiner.sync(counter)
        examiner.silence(can_id(examiner, pdo), f"TPDO at counter {counter}, start value 3")
    examiner.sync(3)
    examiner.expect(can_id(examiner, pdo), "TPDO at its start value")


@case(_tpdo, 14, "7.5.2.37: it cannot be changed while the PDO exists.")
def start_value_fixed(examiner: Examiner) -> None:
    """SYNC start value of a valid TPDO."""
    _fixed_while_valid(examiner, cia.PDO_SYNC_START, 5, "SYNC start value")


@case(_tpdo, 15, "7.5.2.37: types 241 to 251 are refused.")
def reserved_types(examiner: Examiner) -> None:
    """Reserved transmission types."""
    pdo = tpdo(examiner)
    disable(examiner, pdo)
    for value in (241, 251):
        with examiner.refused(f"transmission type {value}"):
            try_number(examiner, pdo.communication, cia.PDO_TRANSMISSION, value)


@case(_tpdo, 16, "7.5.2.37: with bit 31 it is silent.", needs_sync)
def disabled(examiner: Examiner) -> None:
    """Disabled TPDO."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, 1)
    disable(examiner, pdo)
    operational(examiner)
    examiner.sync()
    examiner.silence(can_id(examiner, pdo), "TPDO that is disabled")


@case(_tpdo, 17, "7.5.2.37: bits 0 to 29 cannot be changed while the PDO exists.")
def can_id_fixed(examiner: Examiner) -> None:
    """CAN-ID of a valid TPDO."""
    pdo = tpdo(examiner)
    cob_id = disable(examiner, pdo)
    enable(examiner, pdo, cob_id)
    with examiner.refused("another CAN-ID of a valid TPDO"):
        write_number(examiner, pdo.communication, cia.PDO_COB_ID, _moved(examiner, cob_id))
    if (
        number(examiner, pdo.communication, cia.PDO_COB_ID) & cia.CAN_ID_MASK
        != cob_id & cia.CAN_ID_MASK
    ):
        raise Failure("the refused CAN-ID was taken")


def _moved(examiner: Examiner, cob_id: int) -> int:
    """Return a COB-ID with a CAN-ID close to the present one that no PDO of the device has."""
    taken = examiner.sheet.pdo_ids | {cob_id & cia.CAN_ID_MASK}
    near = next(n for n in range(1, 0x80) if (cob_id ^ n) & cia.CAN_ID_MASK not in taken)
    return cob_id ^ near


@case(
    _tpdo, 18, "7.5.2.37: the TPDO comes under the CAN-ID given while it was disabled.", needs_sync
)
def new_can_id(examiner: Examiner) -> None:
    """New CAN-ID."""
    pdo = tpdo(examiner)
    configure(examiner, pdo, 1)
    moved = _moved(examiner, disable(examiner, pdo))
    write_number(examiner, pdo.communication, cia.PDO_COB_ID, moved | cia.COB_INVALID)
    enable(examiner, pdo, moved)
    operational(examiner)
    examiner.sync()
    examiner.expect(moved & cia.CAN_ID_MASK, "TPDO under its new CAN-ID")


@case(_tpdo, 19, "7.3.2.2: sent in OPERATIONAL, not in PRE-OPERATIONAL and STOPPED.", needs_sync)
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


# RPDO: time at which its values take effect, its length and its deadline.


_DEADLINE_MS = 60


_rpdo = Group("PDO", (needs_rpdo,))


@case(_rpdo, 20, "7.5.2.35: its values are taken at once.")
def event_driven(examiner: Examiner) -> None:
    """Event-driven RPDO."""
    pdo = rpdo(examiner)
    configure_rpdo(examiner, pdo, cia.EVENT_MANUFACTURER)
    operational(examiner)
    data, wanted = changed(examiner, pdo)
    examiner.send(can_id(examiner, pdo), data)
    examiner.settle()
    expect_values(examiner, wanted, "after the RPDO")


@case(_rpdo, 21, "7.5.2.35: its values are taken at the next SYNC.", needs_sync)
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


@case(_rpdo, 22, "7.3.2.2: not taken in PRE-OPERATIONAL and STOPPED.")
def rpdo_by_state(examiner: Examiner) -> None:
    """RPDO by NMT state."""
    pdo = rpdo(examiner)
    examiner.enter(NMTCommand.ENTER_PRE_OPERATIONAL)
    configure_rpdo(examiner, pdo, cia.EVENT_MANUFACTURER)
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


@case(_rpdo, 23, "7.5.2.35: with bit 31 it is not taken.")
def disabled_rpdo(examiner: Examiner) -> None:
    """Disabled RPDO."""
    pdo = rpdo(examiner)
    configure_rpdo(examiner, pdo, cia.EVENT_MANUFACTURER)
    disable(examiner, pdo)
    operational(examiner)
    data, wanted = changed(examiner, pdo)
    examiner.send(can_id(examiner, pdo), data)
    examiner.settle()
    if reads(examiner, wanted):
        raise Failure("RPDO taken that is disabled")


@case(_rpdo, 24, "7.2.2.5.1, 7.2.7.1: not taken; EMCY 8210h if the device has emergencies.")
def too_short(examiner: Examiner) -> None:
    """RPDO that is too short."""
    pdo = rpdo(examiner)
    configure_rpdo(examiner, pdo, cia.EVENT_MANUFACTURER)
    operational(examiner)
    data, wanted = changed(examiner, pdo)
    examiner.drain()
    examiner.send(can_id(examiner, pdo), data[:-1])
    if examiner.sheet.sends_emcy:
        expect_emcy(examiner, EmergencyCode.PDO_LENGTH)
    if reads(examiner, wanted):
        raise Failure("RPDO taken that is too short")


@case(
    _rpdo,
    25,
    "7.5.2.35 and table 26: after the time without an RPDO comes EMCY 8250h.",
    needs_emcy,
)
def deadline(examiner: Examiner) -> None:
    """RPDO deadline."""
    pdo = rpdo(examiner)
    configure(examiner, pdo, cia.EVENT_MANUFACTURER, event=_DEADLINE_MS)
    operational(examiner)
    data, _ = changed(examiner, pdo)
    examiner.send(can_id(examiner, pdo), data)
    expect_emcy(examiner, EmergencyCode.RPDO_TIME_OUT, _DEADLINE_MS * 1e-3 + examiner.timeout)


# Mapping: the defaults, and the procedure to change it.


_BITS = 64
_PROCEDURE = "7.5.2.38: disable, number 0, entries, number, enable"


def _pdo(examiner: Examiner) -> Pdo:
    return examiner.sheet.mappable(examiner.sheet.tpdos)[0]


def _parameter(entry: Entry) -> int:
    return entry.index << 16 | entry.subindex << 8 | 8 * entry.size


def _mappable(examiner: Examiner) -> list[Entry]:
    """Return the entries of whole bytes that a TPDO can carry, the longest first."""
    found = (e for e in examiner.sheet.od if e.tpdo_mappable and e.size and e.readable)
    whole = (e for e in found if e.data_type != DataType.BOOLEAN and e.size <= cia.FRAME_BYTES)
    return sorted(whole, key=lambda entry: -entry.size)


def _open(examiner: Examiner, pdo: Pdo) -> int:
    cob_id = disable(examiner, pdo)
    write_number(examiner, pdo.mapping, 0, 0)
    return cob_id


def _map(examiner: Examiner, pdo: Pdo, parameters: list[int]) -> None:
    for subindex, parameter in enumerate(parameters, 1):
        write_number(examiner, pdo.mapping, subindex, parameter)
    write_number(examiner, pdo.mapping, 0, len(parameters))


def _all_pdos(examiner: Examiner) -> Iterator[tuple[Pdo, Callable[[Entry], bool], str]]:
    for pdo in examiner.sheet.tpdos:
        yield pdo, lambda entry: entry.tpdo_mappable, "TPDO"
    for pdo in examiner.sheet.rpdos:
        yield pdo, lambda entry: entry.rpdo_mappable, "RPDO"


def _has_pdos(sheet: object) -> str | None:
    pdos = [*getattr(sheet, "tpdos", ()), *getattr(sheet, "rpdos", ())]
    return None if pdos else "the EDS has no PDO"


@case(
    Group("PDO", (_has_pdos,)),
    26,
    "7.5.2.36, .38: each entry exists, may be mapped in that direction, and all fit 64 bits.",
)
def default_mapping(examiner: Examiner) -> None:
    """Default mapping."""
    od = examiner.sheet.od
    for pdo, allowed, kind in _all_pdos(examiner):
        count = number(examiner, pdo.mapping)
        bits = 0
        for subindex in range(1, count + 1):
            value = number(examiner, pdo.mapping, subindex)
            bits += value & 0xFF
            entry = od.get(value >> 16, value >> 8 & 0xFF)
            where = f"{pdo.mapping:04X}h:{subindex:02X} = {value:08X}h"
            if entry is None:
                if value >> 16 not in od.dummies or kind == "TPDO":
                    raise Failure(f"{where} maps what does not exist")
            elif not allowed(entry):
                raise Failure(f"{where} maps what no {kind} may carry")
            elif entry.size and value & 0xFF != 8 * entry.size and entry.size > 1:
                raise Failure(f"{where} has the wrong length")
        if bits > _BITS:
            raise Failure(f"{pdo.mapping:04X}h maps {bits} bits")
        if count != od.number(pdo.mapping):
            raise Failure(f"{pdo.mapping:04X}h maps {count} entries, not as the EDS says")


_mapping = Group("PDO", (needs_mapping,))


@case(_mapping, 27, f"{_PROCEDURE}; the PDO then carries the new entries.", needs_sync)
def remap(examiner: Examiner) -> None:
    """Mapping changed by the procedure."""
    pdo = _pdo(examiner)
    cob_id = _open(examiner, pdo)
    parameters = [_parameter(_mappable(examiner)[-1])] * 2
    if not examiner.sheet.has(pdo.mapping, 2):
        parameters.pop()
    _map(examiner, pdo, parameters)
    enable(examiner, pdo, cob_id)
    if number(examiner, pdo.mapping) != len(parameters):
        raise Failure("the number of entries does not read as written")
    configure(examiner, pdo, 1)
    operational(examiner)
    examiner.sync()
    data = examiner.expect(can_id(examiner, pdo), "TPDO at SYNC").data
    if len(data) != len(content(examiner, parameters)):
        raise Failure(f"TPDO of {len(data)} bytes after mapping {len(parameters)} entries anew")


@case(
    _mapping,
    28,
    f"{_PROCEDURE}; a valid PDO, or one whose number is not 0, refuses also what is there.",
)
def remap_out_of_order(examiner: Examiner) -> None:
    """Mapping changed without the procedure."""
    pdo = _pdo(examiner)
    enable(examiner, pdo, disable(examiner, pdo))
    other = next(
        (
            p
            for e in _mappable(examiner)
            if (p := _parameter(e)) != number(examiner, pdo.mapping, 1)
        ),
        None,
    )
    if other is None:
        raise NotApplicable("the EDS has one mappable entry only")

    def write(parameter: int) -> None:
        write_number(examiner, pdo.mapping, 1, parameter)

    present = number(examiner, pdo.mapping, 1)
    with examiner.refused("number 0 of a valid PDO"):
        write_number(examiner, pdo.mapping, 0, 0)
    with examiner.refused("new entry of a valid PDO"):
        write(other)
    disable(examiner, pdo)
    for parameter, what in ((other, "new entry"), (present, "entry written back")):
        with examiner.refused(f"{what} while the number is not 0", refusals.MAPPING_ORDER):
            write(parameter)


@case(_mapping, 29, "7.5.2.38: a number beyond the sub-indices.")
def too_many(examiner: Examiner) -> None:
    """Too many entries."""
    pdo = _pdo(examiner)
    _open(examiner, pdo)
    most = max(examiner.sheet.od.objects[pdo.mapping].entries)
    with examiner.refused(f"{most + 1} entries in a mapping of {most}", refusals.TOO_MANY_ENTRIES):
        try_number(examiner, pdo.mapping, 0, most + 1)


@case(_mapping, 30, "7.5.2.38: more than 64 bits by 06040042h.")
def too_many_bits(examiner: Examiner) -> None:
    """Too many bits."""
    pdo = _pdo(examiner)
    longest = _mappable(examiner)[0]
    count = _BITS // (8 * longest.size) + 1
    if not examiner.sheet.has(pdo.mapping, count):
        raise NotApplicable("the mapping has too few sub-indices for more than 64 bits")
    _open(examiner, pdo)
    with examiner.refused(f"{count} entries of {longest.size} bytes", refusals.TOO_MANY_BITS):
        _map(examiner, pdo, [_parameter(longest)] * count)


@case(_mapping, 31, "7.5.2.38: missing ones by 06020000h or 06040041h, PDOMapping=0 by 06040041h.")
def not_mappable(examiner: Examiner) -> None:
    """Entries that cannot be mapped."""
    pdo = _pdo(examiner)
    _open(examiner, pdo)
    absent = next(i for i in range(0xFFFF, 0, -1) if i not in examiner.sheet.od.objects)
    with examiner.refused(f"mapping of {absent:04X}h", refusals.NOT_MAPPABLE):
        _map(examiner, pdo, [absent << 16 | 8])
    plain = next((e for e in examiner.sheet.od if not e.pdo and e.size and e.readable), None)
    if plain is not None:
        write_number(examiner, pdo.mapping, 0, 0)
        with examiner.refused(f"mapping of {plain.name}", refusals.NOT_MAPPABLE):
            _map(examiner, pdo, [_parameter(plain)])


@case(_mapping, 32, "CiA 306, 4.6: wo and rww only in RPDOs, ro, const and rwr only in TPDOs.")
def direction(examiner: Examiner) -> None:
    """Direction by access."""
    asked = 0
    for pdos, name, kinds in (
        (examiner.sheet.tpdos, "TPDO", ("wo", "rww")),
        (examiner.sheet.rpdos, "RPDO", ("ro", "rwr")),
    ):
        usable = examiner.sheet.mappable(pdos)
        if not usable:
            continue
        _open(examiner, usable[0])
        for kind in kinds:
            entry = next((e for e in examiner.sheet.od if e.pdo and e.access == kind), None)
            if entry is not None:
                asked += 1
                parameter = _parameter(entry)
                write_number(examiner, usable[0].mapping, 0, 0)
                with examiner.refused(
                    f"{kind} entry {entry.name} in a {name}", refusals.NOT_MAPPABLE
                ):
                    _map(examiner, usable[0], [parameter])
    if not asked:
        raise NotApplicable("the EDS has no mappable entry of one direction only")


@case(
    _mapping,
    33,
    "7.4.7.3 and CiA 306, 4.6.2: an RPDO takes those of [DummyUsage], a TPDO takes none.",
)
def dummies(examiner: Examiner) -> None:
    """Dummies."""
    usable = examiner.sheet.mappable(examiner.sheet.rpdos)
    dummies_of_bytes = examiner.sheet.od.dummies - {DataType.BOOLEAN}
    if not usable or not dummies_of_bytes:
        raise NotApplicable("the EDS has no RPDO with a writable mapping, or no dummies")
    dummy = min(dummies_of_bytes)
    parameter = dummy << 16 | 8 * SIZES[dummy]
    cob_id = _open(examiner, usable[0])
    _map(examiner, usable[0], [parameter])
    enable(examiner, usable[0], cob_id)
    if upload(examiner, usable[0].mapping, 1) != parameter.to_bytes(4, "little"):
        raise Failure("the dummy does not read as written")
    pdo = _pdo(examiner)
    _open(examiner, pdo)
    with examiner.refused("dummy in a TPDO", refusals.NOT_MAPPABLE):
        _map(examiner, pdo, [parameter])
