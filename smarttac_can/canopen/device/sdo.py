"""SDO server: expedited, segmented and block transfers (CiA 301, 7.2.4)."""

from __future__ import annotations

from binascii import crc_hqx
from typing import Any, ClassVar, Final

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import CONFIGURABLE
from smarttac_can.canopen.device.port import Port
from smarttac_can.canopen.device.service import Access, Service, check_cob_id
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import Abort, AbortCode, DataType
from smarttac_can.canopen.od.data_types import UNSIGNED
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.canopen.od.entry import MAX_BYTES, Entry

SEGMENT = 7


class Received:
    """Data of a download into an entry.

    Parameters
    ----------
    size
        Number of bytes announced by the client; None if it announced none.

    Attributes
    ----------
    data
        Bytes received in order.
    """

    def __init__(self, entry: Entry, size: int | None) -> None:
        self.entry = entry
        self.data = bytearray()
        self._size = size
        self._limit = size if size is not None else entry.size or MAX_BYTES

    def judge(self, *, last: bool) -> None:
        """Raise `Abort` if there are too many bytes, or too few after the last one."""
        if len(self.data) > self._limit:
            raise Abort(AbortCode.TOO_LONG)
        if last and self._size is not None and len(self.data) < self._size:
            raise Abort(AbortCode.TOO_SHORT)


class Download(Received):
    """Data of a segmented download into an entry; parameters as for `Received`."""

    def __init__(self, entry: Entry, size: int | None) -> None:
        super().__init__(entry, size)
        self._toggle = 0

    def segment(self, request: bytes) -> tuple[bytes, bool]:
        """Take a segment; return the response and whether it was the last segment.

        Raises
        ------
        Abort
            TOGGLE, TOO_LONG or TOO_SHORT.
        """
        command = request[0]
        if command & 0x10 != self._toggle:
            raise Abort(AbortCode.TOGGLE)
        self.data += request[1 : 8 - (command >> 1 & 7)]
        last = bool(command & 1)
        self.judge(last=last)
        response = bytes((0x20 | self._toggle,)) + bytes(7)
        self._toggle ^= 0x10
        return response, last


class Upload:
    """Data of a segmented upload: the value of the entry when the transfer began."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0
        self._toggle = 0

    def segment(self, request: bytes) -> tuple[bytes, bool]:
        """Return the response with the next segment, and whether it was the last segment.

        Raises
        ------
        Abort
            TOGGLE.
        """
        if request[0] & 0x10 != self._toggle:
            raise Abort(AbortCode.TOGGLE)
        part = self._data[self._position : self._position + SEGMENT]
        self._position += len(part)
        last = self._position == len(self._data)
        command = self._toggle | (SEGMENT - len(part)) << 1 | last
        self._toggle ^= 0x10
        return bytes((command,)) + part.ljust(SEGMENT, b"\0"), last


_LAST: Final = 0x80
_SEQUENCE: Final = 0x7F

# Command specifiers of a client. A block transfer request initiates a transfer if its low bits are
# 0.
_SEGMENTS: Final = (0, 3)
_BLOCK_UPLOAD: Final = 5
_BLOCK_DOWNLOAD: Final = 6


# Frames that a client sent before it received the end of the transfer must not be answered, as the
# client would take the answer for that to its next request. Also, a segment of a block download
# that is interpreted as a request could write any object.


class LateSegments:
    """Segments of a block download that may arrive although the server has answered.

    If a client stops among them, its next command may equal the number of the next segment. The
    command is then ignored; the repeated request is processed.

    Parameters
    ----------
    number
        Number of the next segment, 1..127; 0 without one.
    aborted
        Whether the transfer was aborted: a new sub-block of the client is then late, too.

    Attributes
    ----------
    part
        Divisor of the time-out within which the next segment has to arrive.
    follows
        Number of the next segment after those received; 0 if none was received or expected.
    """

    part: Final = 1

    def __init__(self, number: int = 0, *, aborted: bool = False) -> None:
        self.follows = 0
        self._number = number
        self._aborted = aborted

    def include(self, command: int) -> bool:
        """Return whether a frame is the next late segment; after another frame none is late."""
        number = command & _SEQUENCE
        late = number > 0 and (number == self._number or (self._aborted and number == 1))
        self.follows = (number + 1) & _SEQUENCE if late and not command & _LAST else 0
        self._number = self.follows
        return late


class LateRequest:
    """One request of any other transfer that the client may have sent before it received the abort.

    A client that sends a second one has ignored the abort, and receives it again.

    Attributes
    ----------
    part
        Divisor of the time-out within which the request has to arrive.
    """

    part: Final = 10

    def __init__(self) -> None:
        self._came = False

    def include(self, command: int) -> bool:
        """Return whether a frame is this request: the first frame, and it continues a transfer."""
        specifier = command >> 5
        goes_on = (
            specifier in _SEGMENTS
            or (specifier == _BLOCK_UPLOAD and command & 3 != 0)
            or (specifier == _BLOCK_DOWNLOAD and command & 1 != 0)
        )
        late = goes_on and not self._came
        self._came = True
        return late


BLOCK_SIZE: Final = 127
"""Most segments in a sub-block; the server requests this number."""

MOST_UNHEARD: Final = 16
"""Sub-blocks of an upload in a row of which a client may confirm nothing."""


class BlockDownload(Received):
    """Data of a block download into an entry.

    Parameters
    ----------
    entry, size
        As for `Received`.
    crc
        Whether the client sends a CRC.

    Attributes
    ----------
    receiving
        Whether the next frame is a segment; otherwise the client still has to end the transfer.
    """

    def __init__(self, entry: Entry, size: int | None, *, crc: bool) -> None:
        super().__init__(entry, size)
        self.receiving = True
        self._with_crc = crc
        self._crc = 0
        self._summed = 0
        self._most = max(self._limit, 1) + SEGMENT - 1
        self._heard = 0
        self._sequence = 0
        self._late = LateSegments()

    @property
    def interrupted(self) -> bool:
        """Whether a sub-block is incomplete."""
        return self._heard > 0

    def rest(self) -> LateSegments:
        """Return the segments that may still arrive after the transfer is aborted."""
        return LateSegments(self._late.follows or self._heard + 1, aborted=True)

    def segment(self, request: bytes) -> bytes | None:
        """Take a segment; return the confirmation at the end of a sub-block.

        After a gap the rest of the sub-block is dropped, and the client repeats it. An error is
        reported only at the end of the sub-block; the remaining segments would otherwise be
        interpreted as requests.

        Raises
        ------
        Abort
            SEQUENCE for number 0, TOO_LONG.
        """
        command = request[0]
        if self._late.include(command):
            return None
        sequence = command & _SEQUENCE
        if not sequence:
            raise Abort(AbortCode.SEQUENCE)
        self._heard = sequence
        if sequence == self._sequence + 1:
            self._sequence = sequence
            if len(self.data) <= self._most:
                self.data += request[1:]
            if command & _LAST:
                self.receiving = False
        if command & _LAST or sequence == BLOCK_SIZE:
            self._heard = 0
            if len(self.data) > self._most:
                raise Abort(AbortCode.TOO_LONG)
            return self._confirm()
        return None

    def confirm_early(self) -> bytes:
        """Confirm the segments received in order of a sub-block whose last segment may be lost.

        If that segment is only late, the rest of the sub-block is not confirmed separately.
        """
        self._late = LateSegments(self._heard + 1)
        self._heard = 0
        return self._confirm()

    def _confirm(self) -> bytes:
        response = bytes((0xA2, self._sequence, BLOCK_SIZE)) + bytes(5)
        self._sequence = 0
        # How many bytes of the last segment are data is known only at the end.
        self._sum_up(len(self.data) - SEGMENT)
        return response

    def end(self, request: bytes) -> bytes:
        """Check the complete data; return the response.

        Raises
        ------
        Abort
            TOO_LONG, TOO_SHORT or CRC.
        """
        del self.data[len(self.data) - (request[0] >> 2 & 7) :]
        self.judge(last=True)
        self._sum_up(len(self.data))
        if self._with_crc and self._crc != int.from_bytes(request[1:3], "little"):
            raise Abort(AbortCode.CRC)
        return b"\xa1" + bytes(7)

    def _sum_up(self, end: int) -> None:
        if self._with_crc and end > self._summed:
            self._crc = crc_hqx(self.data[self._summed : end], self._crc)
            self._summed = end


class BlockUpload:
    """Data of a block upload: the value of the entry when the transfer began.

    Parameters
    ----------
    block_size
        Segments in a sub-block that the client requests.
    crc
        Whether the client requests a CRC.

    Attributes
    ----------
    ended
        Whether the client has received all data, and only its last confirmation is missing.
    """

    def __init__(self, data: bytes, block_size: int, *, crc: bool) -> None:
        self._data = data
        self._with_crc = crc
        self._crc = 0
        self._position = 0
        self._count = 0
        self._sent = 0
        self._unheard = 0
        self.ended = False
        self._block_size = _checked(block_size)

    def start(self) -> None:
        """Start the first sub-block.

        Raises
        ------
        Abort
            COMMAND if it was started before.
        """
        if self._count:
            raise Abort(AbortCode.COMMAND)
        self._begin()

    def segment(self) -> bytes | None:
        """Return the next segment of the sub-block, None if there are no more."""
        if self._sent == self._count:
            return None
        begin = self._position + SEGMENT * self._sent
        end = begin + SEGMENT
        self._sent += 1
        command = self._sent | (_LAST if end >= len(self._data) else 0)
        return bytes((command,)) + self._data[begin:end].ljust(SEGMENT, b"\0")

    def confirm(self, request: bytes) -> bytes | None:
        """Start the next sub-block, with the first lost segment; or return the end of the transfer.

        Segments of the last sub-block that were not sent are dropped.

        Raises
        ------
        Abort
            SEQUENCE if more segments are confirmed than were sent, BLOCK_SIZE, COMMAND if no
            confirmation is expected, TIME_OUT if nothing of `MOST_UNHEARD` sub-blocks was
            confirmed.
        """
        if not self._count or self.ended:
            raise Abort(AbortCode.COMMAND)
        if request[1] > self._sent:
            raise Abort(AbortCode.SEQUENCE)
        self._block_size = _checked(request[2])
        self._unheard = 0 if request[1] else self._unheard + 1
        if self._unheard == MOST_UNHEARD:
            raise Abort(AbortCode.TIME_OUT)
        begin = self._position
        self._position += SEGMENT * request[1]
        if self._with_crc:
            self._crc = crc_hqx(self._data[begin : self._position], self._crc)
        if self._position < len(self._data) or not request[1]:
            self._begin()
            return None
        self.ended = True
        unused = min(self._position - len(self._data), SEGMENT)
        return bytes((0xC1 | unused << 2,)) + self._crc.to_bytes(2, "little") + bytes(5)

    def end(self) -> None:
        """Take the client's confirmation of the end.

        Raises
        ------
        Abort
            COMMAND if the end was not announced before.
        """
        if not self.ended:
            raise Abort(AbortCode.COMMAND)

    def _begin(self) -> None:
        left = max(1, -(-(len(self._data) - self._position) // SEGMENT))
        self._count = min(left, self._block_size)
        self._sent = 0


def _checked(block_size: int) -> int:
    if not 1 <= block_size <= BLOCK_SIZE:
        raise Abort(AbortCode.BLOCK_SIZE)
    return block_size


TIME_OUT: Final = 1_000_000
"""Default time in us without a request after which a transfer is aborted."""
TIME_OUT_NAME: Final = "SDO server time-out"
"""Name of the manufacturer object that holds the time-out in ms."""

_ABORT: Final = 0x80
# Steps of a block upload, as the client's sub-command.
_INITIATE: Final = 0
_END: Final = 1
_START: Final = 3
_NO_TRANSFER: Final = bytes(3)


class SDOServer(Service):
    """One SDO server with one transfer at a time; a new transfer replaces an abandoned one."""

    states: ClassVar = CONFIGURABLE

    def __init__(self, port: Port, od: ObjectDictionary, index: int, access: Access) -> None:
        super().__init__(port, od, (index,))
        self._access = access
        self._rx = self._tx = cia.COB_INVALID
        self._timer = port.clock.timer(self._on_time_out)
        entry = od.find(TIME_OUT_NAME)
        self._time_out = None if entry is None or entry.data_type not in UNSIGNED else entry
        self._address = _NO_TRANSFER
        self._transfer: Download | Upload | BlockDownload | BlockUpload | None = None
        self._late: LateSegments | LateRequest | None = None
        self._commands: Final = (
            self._segment,
            self._initiate_download,
            self._initiate_upload,
            self._segment,
            self._drop,
            self._block_upload,
            self._block_download,
            self._unknown,
        )

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse another CAN-ID while the present one is valid."""
        if entry.subindex in (1, 2):
            check_cob_id(entry, value)

    def apply(self, entry: Entry) -> None:
        """Apply a new CAN-ID; a disabled server drops its transfer."""
        self.configure()
        if not self._valid:
            self._end()

    def configure(self) -> None:
        """Read the CAN-IDs; the first server has those of the pre-defined connection set."""
        index = self.objects[0]
        default = index == cia.SDO_SERVER_FIRST
        rx = cia.SDO_RX_ID + self.od.node_id if default else cia.COB_INVALID
        tx = cia.SDO_TX_ID + self.od.node_id if default else cia.COB_INVALID
        self._rx, self._tx = self._cob_id(1, rx), self._cob_id(2, tx)

    def _cob_id(self, subindex: int, absent: int) -> int:
        """Return a COB-ID; one of another type, or with the CAN-ID of NMT, counts as absent."""
        entry = self.od.get(self.objects[0], subindex)
        if entry is None or entry.data_type is not DataType.UNSIGNED32:
            return absent
        cob_id = int(entry.read())
        return cob_id if cob_id & cia.CAN_ID_MASK else absent

    @property
    def _valid(self) -> bool:
        return not (self._rx | self._tx) & cia.COB_INVALID

    @property
    def sends(self) -> tuple[int, ...]:
        """CAN-ID of the responses, if the server is enabled."""
        return (self._tx & cia.CAN_ID_MASK,) if self._valid else ()

    def cease(self) -> None:
        """Drop the present transfer, without an abort."""
        self._end()

    def listen(self) -> None:
        """Listen to the client, if the server is enabled."""
        if self._valid:
            self.port.listen(self._rx & cia.CAN_ID_MASK, self.receive)

    def receive(self, frame: Frame) -> None:
        """Take a request; frames of other than 8 bytes are no SDO."""
        data = frame.data
        if len(data) != cia.FRAME_BYTES or frame.rtr:
            return
        tx = self._tx
        transfer = self._transfer
        late = self._late
        if late is not None and late.include(data[0]):
            self._wait(late.part)
            return
        try:
            if type(transfer) is BlockDownload and transfer.receiving and data[0] != _ABORT:
                response = self._block_segment(transfer, data)
            else:
                response = self._commands[data[0] >> 5](data)
        except Abort as abort:
            response = self._abort(abort.code, self._rest())
        if response is not None:
            # The write may have changed the CAN-ID of the server; the client still listens to the
            # old one.
            self._send(response, tx)

    def segment(self) -> Frame | None:
        """Return the next segment of a block upload, None if there is none to send now."""
        transfer = self._transfer
        data = transfer.segment() if isinstance(transfer, BlockUpload) else None
        if data is None:
            return None
        # Restart the time-out: the client cannot answer before the last segment, however slow the
        # bus is.
        self._wait()
        return Frame(self._tx & cia.CAN_ID_MASK, data)

    def _initiate_download(self, request: bytes) -> bytes:
        command, index, subindex = self._address_of(request)
        if command & 2:
            size = 4 - (command >> 2 & 3) if command & 1 else None
            entry = self._access.writable(index, subindex, size)
            self._access.write(entry, request[4 : 4 + (size or entry.size or 4)])
            self._end()
        else:
            size = int.from_bytes(request[4:], "little") if command & 1 else None
            entry = self._access.writable(index, subindex, size)
            self._transfer = Download(entry, size)
            self._wait()
        return b"\x60" + request[1:4] + bytes(4)

    def _initiate_upload(self, request: bytes) -> bytes:
        _, index, subindex = self._address_of(request)
        return self._upload(self._access.read(index, subindex), request)

    def _upload(self, data: bytes, request: bytes) -> bytes:
        if 1 <= len(data) <= cia.EXPEDITED_BYTES:
            self._end()
            return bytes((0x43 | (4 - len(data)) << 2,)) + request[1:4] + data.ljust(4, b"\0")
        self._transfer = Upload(data)
        self._wait()
        return b"\x41" + request[1:4] + len(data).to_bytes(4, "little")

    def _segment(self, request: bytes) -> bytes:
        transfer = self._transfer
        if not isinstance(transfer, Upload if request[0] >> 5 else Download):
            raise Abort(AbortCode.COMMAND)
        response, last = transfer.segment(request)
        if not last:
            self._wait()
            return response
        if isinstance(transfer, Download):
            self._access.write(transfer.entry, bytes(transfer.data))
        self._end()
        return response

    def _block_download(self, request: bytes) -> bytes:
        transfer = self._transfer
        if request[0] & 1:
            if not isinstance(transfer, BlockDownload):
                raise Abort(AbortCode.COMMAND)
            response = transfer.end(request)
            self._access.write(transfer.entry, bytes(transfer.data))
            self._end()
            return response
        command, index, subindex = self._address_of(request)
        size = int.from_bytes(request[4:], "little") if command & 2 else None
        entry = self._access.writable(index, subindex, size)
        self._transfer = BlockDownload(entry, size, crc=bool(command & 4))
        self._wait()
        return b"\xa4" + request[1:4] + bytes((BLOCK_SIZE, 0, 0, 0))

    def _block_segment(self, transfer: BlockDownload, request: bytes) -> bytes | None:
        response = transfer.segment(request)
        # If the last segment of a sub-block is lost, confirm half-way to the time-out.
        self._wait(2 if response is None else 1)
        return response

    def _block_upload(self, request: bytes) -> bytes | None:
        step = request[0] & 3
        if step == _INITIATE:
            return self._initiate_block_upload(request)
        transfer = self._transfer
        if not isinstance(transfer, BlockUpload):
            raise Abort(AbortCode.COMMAND)
        if step == _END:
            transfer.end()
            self._end()
            return None
        response = None
        if step == _START:
            transfer.start()
        else:
            response = transfer.confirm(request)
        self.port.stream(self.segment)
        self._wait()
        return response

    def _initiate_block_upload(self, request: bytes) -> bytes:
        command, index, subindex = self._address_of(request)
        data = self._access.read(index, subindex)
        block_size, threshold = request[4:6]
        transfer = BlockUpload(data, block_size, crc=bool(command & 4))
        if len(data) <= threshold and threshold:
            return self._upload(data, request)
        self._transfer = transfer
        self._wait()
        return b"\xc6" + request[1:4] + len(data).to_bytes(4, "little")

    def _drop(self, _: bytes) -> None:
        """Take the client's abort, which is not answered."""
        self._end()

    def _unknown(self, _: bytes) -> None:
        raise Abort(AbortCode.COMMAND)

    def _wait(self, part: int = 1) -> None:
        """Start the time-out of the client, or a fraction of it."""
        entry = self._time_out
        time_out = TIME_OUT if entry is None else 1000 * max(1, entry.value)
        self._timer.start(time_out // part)

    def _address_of(self, request: bytes) -> tuple[int, int, int]:
        self._end()
        self._address = request[1:4]
        return request[0], int.from_bytes(request[1:3], "little"), request[3]

    def _end(self, late: LateSegments | LateRequest | None = None) -> None:
        self._transfer = None
        self._late = late
        self._address = _NO_TRANSFER
        if late is None:
            self._timer.stop()
        else:
            self._wait(late.part)

    def _abort(self, code: int, late: LateSegments | LateRequest | None) -> bytes:
        response = b"\x80" + self._address + code.to_bytes(4, "little")
        self._end(late)
        return response

    def _rest(self) -> LateSegments | None:
        """Return the segments that the client may still send; None without a block download."""
        transfer = self._transfer
        if isinstance(transfer, BlockDownload) and transfer.receiving:
            return transfer.rest()
        return None

    def _on_time_out(self) -> None:
        transfer = self._transfer
        if isinstance(transfer, BlockDownload) and transfer.interrupted:
            self._send(transfer.confirm_early(), self._tx)
            self._wait(2)
        elif transfer is None:
            self._end()
        elif isinstance(transfer, BlockUpload) and transfer.ended:
            # The client waits for no answer, and would take an abort for the answer to its next
            # request.
            self._end(LateRequest())
        else:
            late = self._rest() or LateRequest()
            self._send(self._abort(AbortCode.TIME_OUT, late), self._tx)

    def _send(self, response: bytes, tx: int) -> None:
        self.port.out.append(Frame(tx & cia.CAN_ID_MASK, response))
