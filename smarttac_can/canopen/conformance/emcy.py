"""EMCY: message, history, COB-ID and inhibit time, caused by the loss of a supervised node."""

from __future__ import annotations

from smarttac_can.canopen.conformance import refusals
from smarttac_can.canopen.conformance.case import (
    DeviceDescription,
    Failure,
    Group,
    case,
    needs_object,
)
from smarttac_can.canopen.conformance.examiner import (
    Examiner,
    download,
    number,
    upload,
    write_number,
)
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import EmergencyCode, ErrorRegister

# The error that a case causes and clears: a supervised node falls silent and returns.

WATCH_MS = 60
_OPERATIONAL = b"\x05"

needs_consumer = needs_object(cia.HEARTBEAT_CONSUMER, 1, writable=True)


def needs_emcy(sheet: DeviceDescription) -> str | None:
    """Require an EMCY that is valid by the default value of its COB-ID."""
    if not sheet.has(cia.EMCY_COB_ID):
        return f"the EDS has no {cia.EMCY_COB_ID:04X}h:00"
    return None if sheet.sends_emcy else "the EDS has bit 31 of 1014h set: there is no EMCY"


def other_node(examiner: Examiner) -> int:
    """Return a node-ID that is not the device's, and that it does not supervise by default."""
    consumers = examiner.sheet.od.objects.get(cia.HEARTBEAT_CONSUMER)
    values = [] if consumers is None else consumers.entries
    taken = {int(examiner.sheet.od.number(cia.HEARTBEAT_CONSUMER, n)) >> 16 & 0x7F for n in values}
    return max(set(range(1, cia.LAST_NODE_ID + 1)) - taken - {examiner.node_id})


def emcy_id(examiner: Examiner) -> int:
    """Return the CAN-ID of the device's EMCY in the EDS."""
    return examiner.sheet.od.number(cia.EMCY_COB_ID) & cia.CAN_ID_MASK


def watch(examiner: Examiner) -> None:
    """Configure the device to supervise another node, and send one heartbeat of that node."""
    write_number(examiner, cia.HEARTBEAT_CONSUMER, 1, other_node(examiner) << 16 | WATCH_MS)
    examiner.drain()
    heartbeat(examiner)


def heartbeat(examiner: Examiner) -> None:
    """Send a heartbeat of the other node."""
    examiner.send(cia.HEARTBEAT_ID + other_node(examiner), _OPERATIONAL)


def expect_emcy(examiner: Examiner, code: EmergencyCode, timeout: float | None = None) -> bytes:
    """Wait for the next EMCY and return its 8 bytes.

    Raises
    ------
    Failure
        No EMCY comes within the time-out in s, or it has another code.
    """
    data = examiner.expect(emcy_id(examiner), f"EMCY {code:04X}h", timeout).data
    if len(data) != cia.FRAME_BYTES:
        raise Failure(f"EMCY of {len(data)} bytes")
    if int.from_bytes(data[:2], "little") != code:
        raise Failure(f"EMCY {data.hex(' ')} instead of {code:04X}h")
    return data


def lose_node(examiner: Examiner) -> bytes:
    """Cause the loss of a supervised node; return the 8 bytes of the EMCY 8130h."""
    watch(examiner)
    return expect_emcy(examiner, EmergencyCode.ERROR_CONTROL, WATCH_MS * 1e-3 + examiner.timeout)


_INHIBIT_MS = 100
_SLACK_MS = 20
_has_history = needs_object(cia.ERROR_FIELD)


_emcy = Group("EMCY", (needs_emcy, needs_consumer))


@case(_emcy, 1, "7.2.7.3: 8 bytes once per error: code, error register as object 1001h, 5 bytes.")
def message(examiner: Examiner) -> None:
    """Message of an error."""
    data = lose_node(examiner)
    examiner.silence(emcy_id(examiner), "second EMCY of one error")
    register = upload(examiner, cia.ERROR_REGISTER)[0]
    if data[2] != register:
        raise Failure(f"EMCY with error register {data[2]:02X}h, object 1001h is {register:02X}h")
    if not register & ErrorRegister.GENERIC or not register & ErrorRegister.COMMUNICATION:
        raise Failure(f"error register {register:02X}h has no generic and communication error")


@case(_emcy, 2, "7.2.7.2: when the last error is gone comes code 0000h with error register 0.")
def error_reset(examiner: Examiner) -> None:
    """End of an error."""
    lose_node(examiner)
    heartbeat(examiner)
    data = expect_emcy(examiner, EmergencyCode.RESET)
    if data[2] or upload(examiner, cia.ERROR_REGISTER)[0]:
        raise Failure("the error register is not 0 when the last error is gone")


@case(
    _emcy,
    3,
    "7.5.2.2: the newest error stands in sub-index 1, sub-index 0 counts them.",
    _has_history,
)
def history(examiner: Examiner) -> None:
    """History."""
    if examiner.sheet.writable(cia.ERROR_FIELD):
        write_number(examiner, cia.ERROR_FIELD, 0, 0)
    before = number(examiner, cia.ERROR_FIELD)
    lose_node(examiner)
    count = number(examiner, cia.ERROR_FIELD)
    if count != before + 1:
        raise Failure(f"{before} errors in the history, then {count} after one more")
    newest = number(examiner, cia.ERROR_FIELD, 1) & 0xFFFF
    if newest != EmergencyCode.ERROR_CONTROL:
        raise Failure(f"{newest:04X}h is the newest error, 8130h was sent")


@case(
    Group("EMCY"),
    4,
    "7.5.2.2: only 0 may be written to sub-index 0; an empty place has no data.",
    _has_history,
)
def clear_history(examiner: Examiner) -> None:
    """Clearing the history."""

    def write(value: int) -> None:
        download(examiner, cia.ERROR_FIELD, 0, bytes((value,)))

    with examiner.refused("1 written to the history", refusals.OUT_OF_RANGE):
        write(1)
    write(0)
    if number(examiner, cia.ERROR_FIELD):
        raise Failure("the history is not empty after it was cleared")
    with examiner.refused("an empty place of the history", refusals.NO_DATA):
        upload(examiner, cia.ERROR_FIELD, 1)


@case(
    _emcy,
    5,
    "7.5.2.17: with bit 31 EMCY is silent; the CAN-ID of a valid one cannot be changed.",
    needs_object(cia.EMCY_COB_ID, writable=True),
)
def cob_id(examiner: Examiner) -> None:
    """COB-ID."""
    value = number(examiner, cia.EMCY_COB_ID)
    if value != examiner.sheet.od.number(cia.EMCY_COB_ID):
        raise Failure(f"COB-ID EMCY is {value:08X}h, not as the EDS says")
    with examiner.refused("CAN-ID of a valid EMCY"):
        write_number(examiner, cia.EMCY_COB_ID, 0, value ^ 0x100)
    write_number(examiner, cia.EMCY_COB_ID, 0, value | cia.COB_INVALID)
    watch(examiner)
    examiner.silence(emcy_id(examiner), "EMCY that is disabled", WATCH_MS * 1e-3 + examiner.watch)


@case(
    _emcy,
    6,
    "7.5.2.18: the least time between two messages.",
    needs_object(cia.EMCY_INHIBIT, writable=True),
)
def inhibit_time(examiner: Examiner) -> None:
    """Inhibit time."""
    write_number(examiner, cia.EMCY_INHIBIT, 0, 10 * _INHIBIT_MS)
    watch(examiner)
    first = examiner.wait(emcy_id(examiner), WATCH_MS * 1e-3 + examiner.timeout)
    heartbeat(examiner)
    second = examiner.wait(emcy_id(examiner), _INHIBIT_MS * 1e-3 + examiner.timeout)
    if first is None or second is None:
        raise Failure("not two EMCYs for an error that comes and goes")
    gap = 1000 * (second.time - first.time)
    if gap < _INHIBIT_MS - _SLACK_MS:
        raise Failure(f"{gap:.0f} ms between two EMCYs, inhibit time {_INHIBIT_MS} ms")
