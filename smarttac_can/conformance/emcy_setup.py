"""Causing an error in the device and taking it back: a watched node falls silent and returns."""

from __future__ import annotations

from smarttac_can.conformance.case import Failure
from smarttac_can.conformance.description import needs_object
from smarttac_can.conformance.examiner import Examiner
from smarttac_can.conformance.sdo_client import write_number
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    EMCY_COB_ID,
    FRAME_BYTES,
    HEARTBEAT_CONSUMER,
    HEARTBEAT_ID,
    LAST_NODE_ID,
    EmergencyCode,
)

WATCH_MS = 60
_OPERATIONAL = b"\x05"

needs_emcy = needs_object(EMCY_COB_ID)
needs_consumer = needs_object(HEARTBEAT_CONSUMER, 1, writable=True)


def other_node(examiner: Examiner) -> int:
    """Return a node-ID that is not the device's."""
    return LAST_NODE_ID - 1 if examiner.node_id == LAST_NODE_ID else LAST_NODE_ID


def emcy_id(examiner: Examiner) -> int:
    """Return the CAN-ID of the device's EMCY by the data sheet."""
    return examiner.sheet.od.number(EMCY_COB_ID) & CAN_ID_MASK


def watch(examiner: Examiner) -> None:
    """Have the device watch another node, and let that node be heard once."""
    write_number(examiner, HEARTBEAT_CONSUMER, 1, other_node(examiner) << 16 | WATCH_MS)
    examiner.drain()
    heartbeat(examiner)


def heartbeat(examiner: Examiner) -> None:
    """Send a heartbeat of the other node."""
    examiner.send(HEARTBEAT_ID + other_node(examiner), _OPERATIONAL)


def expect_emcy(examiner: Examiner, code: EmergencyCode, timeout: float | None = None) -> bytes:
    """Wait for the next EMCY and return its 8 bytes.

    Raises
    ------
    Failure
        If none comes within the time-out in s, or it has another code.
    """
    data = examiner.expect(emcy_id(examiner), f"EMCY {code:04X}h", timeout).data
    if len(data) != FRAME_BYTES:
        raise Failure(f"EMCY of {len(data)} bytes")
    if int.from_bytes(data[:2], "little") != code:
        raise Failure(f"EMCY {data.hex(' ')} instead of {code:04X}h")
    return data


def lose_node(examiner: Examiner) -> bytes:
    """Have the device miss a node that it watches; return the 8 bytes of the EMCY 8130h."""
    watch(examiner)
    return expect_emcy(examiner, EmergencyCode.ERROR_CONTROL, WATCH_MS * 1e-3 + examiner.timeout)
