"""Frames that a master sends, and what the answers to those of SDO say: no bus, no time."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.od.cia import (
    EXPEDITED_BYTES,
    FRAME_BYTES,
    HEARTBEAT_ID,
    NMT_ID,
    SDO_RX_ID,
    SDO_TX_ID,
    SYNC_ID,
    Abort,
)
from smarttac_can.od.data_types import pack, unpack
from smarttac_can.od.entry import Entry

_UPLOAD: Final = 0x40
_DOWNLOAD: Final = 0x23
_DOWNLOADED: Final = 0x60
ABORT: Final = 0x80
"""Command of an abort, of either side."""
INITIATES: Final = (1, 2)
"""Command specifiers of requests that begin a transfer, and name the object."""
_EXPEDITED: Final = 0b11
"""Bits of a download that carries its data, and says how many bytes."""
_ANSWERS: Final = {0: 1, 1: 3, 2: 2, 3: 0}
"""Command specifier of the server's answer, by that of the client's request."""


def nmt(command: int, node_id: int = 0) -> Frame:
    """Make an NMT command; node 0 stands for all."""
    return Frame(NMT_ID, bytes((command, node_id)))


def sync(counter: int = 0) -> Frame:
    """Make a SYNC with a counter of 1..240, or 0 for none."""
    return Frame(SYNC_ID, bytes((counter,)) if counter else b"")


def heartbeat(node_id: int) -> Frame:
    """Make the heartbeat of a node that is OPERATIONAL."""
    return Frame(HEARTBEAT_ID + node_id, bytes((NMTState.OPERATIONAL,)))


def upload(node_id: int, entry: Entry) -> Frame:
    """Make the SDO request that reads an entry."""
    return _request(node_id, _UPLOAD, entry, b"")


def download(node_id: int, entry: Entry, raw: Any) -> Frame:
    """Make the SDO request that writes an entry of 1 to 4 bytes: its raw value."""
    data = pack(entry.data_type, raw)
    return _request(node_id, _DOWNLOAD | (EXPEDITED_BYTES - len(data)) << 2, entry, data)


def abort(node_id: int, code: int) -> Frame:
    """Make the SDO abort by a client, which ends whatever transfer the server has open."""
    return Frame(SDO_RX_ID + node_id, bytes((ABORT, 0, 0, 0)) + code.to_bytes(4, "little"))


def answers(frame: Frame, request: Frame) -> bool:
    """Tell whether a frame answers an SDO request; answers to segments do not name the object."""
    if frame.can_id - SDO_TX_ID != request.can_id - SDO_RX_ID or len(frame.data) != FRAME_BYTES:
        return False
    asked, answered = request.data[0] >> 5, frame.data[0] >> 5
    if asked not in _ANSWERS or answered not in (_ANSWERS[asked], ABORT >> 5):
        return False
    return asked not in INITIATES or frame.data[1:4] == request.data[1:4]


class Written(NamedTuple):
    """What an SDO request asks to write."""

    address: tuple[int, int]
    """Index and sub-index."""
    data: bytes


def written(frame: Frame, node_id: int) -> Written | None:
    """Return what a frame asks to write to a node; None if it is no download of 1 to 4 bytes."""
    data = frame.data
    if frame.can_id != SDO_RX_ID + node_id or len(data) != FRAME_BYTES:
        return None
    command = data[0]
    if command >> 5 != _DOWNLOAD >> 5 or command & _EXPEDITED != _EXPEDITED:
        return None
    size = EXPEDITED_BYTES - (command >> 2 & 3)
    return Written((data[1] | data[2] << 8, data[3]), data[4 : 4 + size])


def downloaded(node_id: int, entry: Entry) -> Frame:
    """Make the answer of a node that has taken what was written to an entry."""
    address = entry.index.to_bytes(2, "little") + bytes((entry.subindex,))
    return Frame(SDO_TX_ID + node_id, bytes((_DOWNLOADED, *address, 0, 0, 0, 0)))


def takes(frame: Frame, node_id: int, entry: Entry) -> bool:
    """Tell whether a node says that it has taken what was written to an entry."""
    return frame == downloaded(node_id, entry)


def value(answer: Frame, entry: Entry) -> Any:
    """Return the raw value in the answer to an upload, None in that to a download.

    Raises
    ------
    Abort
        If the node refuses, or the value has not the length of the entry's type.
    """
    command, data = answer.data[0], answer.data[4:]
    if command == ABORT:
        raise Abort(int.from_bytes(data, "little"))
    if command == _DOWNLOADED:
        return None
    return unpack(entry.data_type, data[: EXPEDITED_BYTES - (command >> 2 & 3)])


def _request(node_id: int, command: int, entry: Entry, data: bytes) -> Frame:
    address = entry.index.to_bytes(2, "little") + bytes((entry.subindex,))
    return Frame(
        SDO_RX_ID + node_id, bytes((command,)) + address + data.ljust(EXPEDITED_BYTES, b"\0")
    )
