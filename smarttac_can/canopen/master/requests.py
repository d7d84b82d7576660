"""Frames that a master sends, and the meaning of SDO answers, without a bus or time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.data_types import pack, unpack
from smarttac_can.canopen.od.entry import MAX_BYTES, Entry

_UPLOAD: Final = 0x40
_READS: Final = 2
"""Command specifier of a request that initiates an upload."""
_UPLOAD_SEGMENT: Final = 0x60
_IS_EXPEDITED: Final = 0x02
"""Bit in the answer to an initiated upload that marks its data as complete."""
_DOWNLOAD: Final = 0x23
_DOWNLOADED: Final = 0x60
ABORT: Final = 0x80
"""Command of an abort, from either side."""
INITIATES: Final = (1, 2)
"""Command specifiers of requests that initiate a transfer and name the object."""
_EXPEDITED: Final = 0b11
"""Bits of an expedited download with the number of its bytes."""
_SEGMENT: Final = 7
"""Bytes of data in a segment."""
_SEQUENCE: Final = 0x7F
_LAST: Final = 0x80
"""Sequence number, and mark of the last segment, in the first byte of a segment of a block."""
_SEGMENT_TAKEN: Final = 1
_BLOCK: Final = 6
"""Command specifier of the client in a block download."""
_BLOCK_ANSWER: Final = 5
_ENDS: Final = 1
_CONFIRMS: Final = 2
"""Sub-commands of the answers to a block download; 0 answers its initiation."""
_ANSWERS: Final = {0: 1, 1: 3, 2: 2, 3: 0}
"""Command specifier of the server's answer, by that of the client's request."""


def nmt(command: int, node_id: int = 0) -> Frame:
    """Return an NMT command; node 0 stands for all."""
    return Frame(cia.NMT_ID, bytes((command, node_id)))


def sync(counter: int = 0) -> Frame:
    """Return a SYNC with a counter of 1..240, or 0 for no counter."""
    return Frame(cia.SYNC_ID, bytes((counter,)) if counter else b"")


def heartbeat(node_id: int) -> Frame:
    """Return the heartbeat of a node that is OPERATIONAL."""
    return Frame(cia.HEARTBEAT_ID + node_id, bytes((NMTState.OPERATIONAL,)))


def upload(node_id: int, entry: Entry) -> Frame:
    """Return the SDO request that reads an entry."""
    return _request(node_id, _UPLOAD, entry, b"")


def download(node_id: int, entry: Entry, raw: Any) -> Frame:
    """Return the SDO request that writes a raw value to an entry of 1 to 4 bytes."""
    data = pack(entry.data_type, raw)
    return _request(node_id, _DOWNLOAD | (cia.EXPEDITED_BYTES - len(data)) << 2, entry, data)


def abort(node_id: int, code: int) -> Frame:
    """Return the SDO abort by a client, which ends the present transfer of the server."""
    return Frame(cia.SDO_RX_ID + node_id, bytes((ABORT, 0, 0, 0)) + code.to_bytes(4, "little"))


def answers(frame: Frame, request: Frame) -> bool:
    """Return whether a frame answers an SDO request; answers to segments do not name the object."""
    if (
        frame.can_id - cia.SDO_TX_ID != request.can_id - cia.SDO_RX_ID
        or len(frame.data) != cia.FRAME_BYTES
    ):
        return False
    asked, answered = request.data[0] >> 5, frame.data[0] >> 5
    if asked not in _ANSWERS or answered not in (_ANSWERS[asked], ABORT >> 5):
        return False
    return asked not in INITIATES or frame.data[1:4] == request.data[1:4]


class Written(NamedTuple):
    """Object and data of an SDO download, requested or completed."""

    address: tuple[int, int]
    """Index and sub-index."""
    data: bytes


def written(frame: Frame, node_id: int) -> Written | None:
    """Return the download that a frame requests; None if it is none of 1 to 4 bytes."""
    data = frame.data
    if frame.can_id != cia.SDO_RX_ID + node_id or len(data) != cia.FRAME_BYTES:
        return None
    command = data[0]
    if command >> 5 != _DOWNLOAD >> 5 or command & _EXPEDITED != _EXPEDITED:
        return None
    size = cia.EXPEDITED_BYTES - (command >> 2 & 3)
    return Written((data[1] | data[2] << 8, data[3]), data[4 : 4 + size])


def asked(frame: Frame, node_id: int) -> tuple[int, int] | None:
    """Return index and sub-index that a frame requests to read from a node, or None."""
    data = frame.data
    if (
        frame.can_id != cia.SDO_RX_ID + node_id
        or len(data) != cia.FRAME_BYTES
        or data[0] >> 5 != _READS
    ):
        return None
    return data[1] | data[2] << 8, data[3]


def downloaded(node_id: int, entry: Entry) -> Frame:
    """Return the answer of a node that confirms a download to an entry."""
    address = entry.index.to_bytes(2, "little") + bytes((entry.subindex,))
    return Frame(cia.SDO_TX_ID + node_id, bytes((_DOWNLOADED, *address, 0, 0, 0, 0)))


def downloading(node_id: int, entry: Entry, data: bytes) -> Iterator[Frame]:
    """Yield the frames of a segmented download of any length, requests and answers alternating."""
    to, back = cia.SDO_RX_ID + node_id, cia.SDO_TX_ID + node_id
    size = len(data).to_bytes(4, "little")
    yield _request(node_id, _DOWNLOAD & ~_EXPEDITED | 1, entry, size)
    yield downloaded(node_id, entry)
    starts = range(0, max(1, len(data)), _SEGMENT)
    for number, start in enumerate(starts):
        part = data[start : start + _SEGMENT]
        toggle = number % 2 << 4
        command = toggle | (_SEGMENT - len(part)) << 1 | (start == starts[-1])
        yield Frame(to, bytes((command,)) + part.ljust(_SEGMENT, b"\0"))
        yield Frame(back, bytes((_SEGMENT_TAKEN << 5 | toggle, *bytes(_SEGMENT))))


@dataclass
class _Transfer:
    """State of a transfer of more than one frame between client and node, in either direction."""

    address: bytes
    in_block: bool = False
    data: bytearray = field(default_factory=bytearray)
    segments: dict[int, bytes] = field(default_factory=dict)
    """Unconfirmed segments by sequence number; in a segmented transfer only one at a time."""
    receiving: bool = False
    """Whether the next frame of the client in a block transfer is a segment."""
    ends: bool = False
    """Whether the last confirmed segment is the last one."""
    unused: int = 0
    """Unused bytes in the last segment of a block."""

    def append(self, segment: bytes) -> None:
        """Append the data of a segment that is not one of a block."""
        self.data += segment[1 : cia.FRAME_BYTES - (segment[0] >> 1 & _SEGMENT)]
        self.ends = bool(segment[0] & 1)

    @property
    def over(self) -> bool:
        """Whether the last segment was appended, or more data than any entry has."""
        return self.ends or len(self.data) > MAX_BYTES


class Downloads:
    """Follows the SDO downloads of any length to a node, and returns the data that it accepts.

    Data that the node confirms are regarded as accepted. The bytes of a segment that was not
    received are missing.

    Parameters
    ----------
    node_id
        Node-ID of the server.
    """

    def __init__(self, node_id: int) -> None:
        self._node_id = node_id
        self._asked: dict[bytes, bytes] = {}
        self._begun: _Transfer | None = None
        self._transfer: _Transfer | None = None

    def hear(self, frame: Frame) -> Written | None:
        """Handle a frame; return the download that the node has accepted with it, or None."""
        data = frame.data
        if len(data) == cia.FRAME_BYTES and not frame.rtr:
            if frame.can_id == cia.SDO_RX_ID + self._node_id:
                self._request(frame)
            elif frame.can_id == cia.SDO_TX_ID + self._node_id:
                return self._answer(data)
        return None

    def _request(self, frame: Frame) -> None:
        data, transfer = frame.data, self._transfer
        command, address = data[0], data[1:4]
        if command == ABORT:
            self._begun = self._transfer = None
        elif transfer is not None and transfer.receiving:
            transfer.segments[command & _SEQUENCE] = data
        elif request := written(frame, self._node_id):
            self._asked[address] = request.data
        elif command >> 5 == _DOWNLOAD >> 5 or (command >> 5 == _BLOCK and not command & 1):
            self._asked.pop(address, None)
            self._begun = _Transfer(address, command >> 5 == _BLOCK)
        elif transfer is not None and command >> 5 == 0:
            transfer.segments[0] = data
        elif transfer is not None and command >> 5 == _BLOCK:
            transfer.unused = command >> 2 & _SEGMENT

    def _answer(self, data: bytes) -> Written | None:
        command, address = data[0], data[1:4]
        if command == ABORT:
            self._asked.pop(address, None)
            if self._transfer is not None and self._transfer.address == address:
                self._transfer = None
        elif command == _DOWNLOADED and address in self._asked:
            return _as_written(address, self._asked.pop(address))
        elif command == _DOWNLOADED or (command >> 5 == _BLOCK_ANSWER and not command & 0b11):
            self._begin(address, command != _DOWNLOADED)
        elif self._transfer is not None:
            return self._confirm(self._transfer, command, data[1])
        return None

    def _begin(self, address: bytes, in_block: bool) -> None:
        begun, self._begun = self._begun, None
        if begun is not None and (begun.address, begun.in_block) == (address, in_block):
            begun.receiving = in_block
            self._transfer = begun

    def _confirm(self, transfer: _Transfer, command: int, last: int) -> Written | None:
        if transfer.in_block and command >> 5 == _BLOCK_ANSWER:
            if command & 0b11 == _CONFIRMS:
                taken = [transfer.segments.get(n, b"\0") for n in range(1, last + 1)]
                transfer.data += b"".join(segment[1:] for segment in taken)
                transfer.receiving = not (taken and taken[-1][0] & _LAST)
            elif command & 0b11 == _ENDS:
                del transfer.data[len(transfer.data) - transfer.unused :]
                transfer.ends = True
        elif not transfer.in_block and command >> 5 == _SEGMENT_TAKEN and transfer.segments:
            transfer.append(transfer.segments[0])
        else:
            return None
        transfer.segments.clear()
        if transfer.over:
            self._transfer = None
        return _as_written(transfer.address, bytes(transfer.data)) if transfer.ends else None


def _as_written(address: bytes, data: bytes) -> Written:
    return Written((address[0] | address[1] << 8, address[2]), data)


def value(answer: Frame, entry: Entry) -> Any:
    """Return the raw value in the answer to an upload; None in the answer to a download.

    Raises
    ------
    Abort
        If the node refuses, or the value does not have the length of the entry's type.
    """
    command, data = answer.data[0], answer.data[4:]
    if command == ABORT:
        raise Abort(int.from_bytes(data, "little"))
    if command == _DOWNLOADED:
        return None
    return unpack(entry.data_type, data[: cia.EXPEDITED_BYTES - (command >> 2 & 3)])


class Upload:
    """Read of an entry of any length, expedited or in segments.

    Parameters
    ----------
    node_id
        Node-ID of the server.
    entry
        Entry to read.

    Attributes
    ----------
    request
        Request to send: the first one, and the next one after each answer that `take` returns False
        for.
    raw
        Raw value; None until it is complete.
    """

    def __init__(self, node_id: int, entry: Entry) -> None:
        self._node_id, self.entry = node_id, entry
        self.request = upload(node_id, entry)
        self.raw: Any = None
        self._transfer = _Transfer(self.request.data[1:4])
        self._segments = 0

    @property
    def in_segments(self) -> bool:
        """Whether a segment was requested."""
        return self._segments > 0

    def take(self, answer: Frame) -> bool:
        """Handle the answer to the request; return whether the value is complete.

        Raises
        ------
        Abort
            If the node refuses, the toggle bit is wrong, or the value does not suit the type of the
            entry.
        """
        command = answer.data[0]
        if command == ABORT or (not self._segments and command & _IS_EXPEDITED):
            self.raw = value(answer, self.entry)
            return True
        if self._segments:
            if command >> 4 & 1 != (self._segments - 1) % 2:
                raise Abort(AbortCode.TOGGLE)
            self._transfer.append(answer.data)
            if self._transfer.over:
                self.raw = unpack(self.entry.data_type, bytes(self._transfer.data))
                return True
        toggle = self._segments % 2 << 4
        self._segments += 1
        self.request = Frame(
            cia.SDO_RX_ID + self._node_id, bytes((_UPLOAD_SEGMENT | toggle, *bytes(_SEGMENT)))
        )
        return False


def _request(node_id: int, command: int, entry: Entry, data: bytes) -> Frame:
    address = entry.index.to_bytes(2, "little") + bytes((entry.subindex,))
    return Frame(
        cia.SDO_RX_ID + node_id,
        bytes((command,)) + address + data.ljust(cia.EXPEDITED_BYTES, b"\0"),
    )
