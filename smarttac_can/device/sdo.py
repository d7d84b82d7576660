"""SDO server: expedited, segmented and block transfers (CiA 301, 7.2.4)."""

from __future__ import annotations

from binascii import crc_hqx
from typing import Any, ClassVar, Final

from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import CONFIGURABLE
from smarttac_can.device.port import Port
from smarttac_can.device.service import Access, Service, check_cob_id
from smarttac_can.od.cia import (
    CAN_ID_MASK,
    COB_INVALID,
    EXPEDITED_BYTES,
    FRAME_BYTES,
    SDO_RX_ID,
    SDO_SERVER_FIRST,
    SDO_TX_ID,
    Abort,
    AbortCode,
)
from smarttac_can.od.data_types import UNSIGNED
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import MAX_BYTES, Entry

SEGMENT = 7


class Download:
    """Data on its way into an entry.

    Parameters
    ----------
    size
        Bytes announced by the client, None if it announced nothing.
    """

    def __init__(self, entry: Entry, size: int | None) -> None:
        self.entry = entry
        self.data = bytearray()
        self._size = size
        self._toggle = 0

    def segment(self, request: bytes) -> tuple[bytes, bool]:
        """Take a segment; return the response and whether it was the last.

        Raises
        ------
        Abort
            TOGGLE, TOO_LONG, TOO_SHORT.
        """
        command = request[0]
        if command & 0x10 != self._toggle:
            raise Abort(AbortCode.TOGGLE)
        self.data += request[1 : 8 - (command >> 1 & 7)]
        limit = self._size if self._size is not None else self.entry.size or MAX_BYTES
        if len(self.data) > limit:
            raise Abort(AbortCode.TOO_LONG)
        last = bool(command & 1)
        if last and self._size is not None and len(self.data) < self._size:
            raise Abort(AbortCode.TOO_SHORT)
        response = bytes((0x20 | self._toggle,)) + bytes(7)
        self._toggle ^= 0x10
        return response, last


class Upload:
    """Data on its way to the client: a snapshot of the entry when the transfer began."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._position = 0
        self._toggle = 0

    def segment(self, request: bytes) -> tuple[bytes, bool]:
        """Return the response with the next segment, and whether it was the last.

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

# Command specifiers of a client; a request of a block transfer begins it if its low bits are 0.
_SEGMENTS: Final = (0, 3)
_BLOCK_UPLOAD: Final = 5
_BLOCK_DOWNLOAD: Final = 6


# Frames that a client sent before it heard that the server had ended the transfer. The server must
# not answer them, as the client would take a second answer for that to its next request. And a
# segment of a block download that is taken for a request could write anything.


class LateSegments:
    """Segments of a block download that may come although the server has answered.

    A client that stops among them may begin anew with a command that equals the next number. It is
    then not heard, but is when it repeats the request.

    Parameters
    ----------
    number
        Of the next segment, 1..127; 0 if none is under way.
    aborted
        Whether the transfer is over: a sub-block that the client begins is late as well.

    Attributes
    ----------
    part
        Of the time-out, as a divisor, within which the next one comes.
    follows
        Number of the next one after those that came; 0 if none came, or no more will.
    """

    part: Final = 1

    def __init__(self, number: int = 0, *, aborted: bool = False) -> None:
        self.follows = 0
        self._number = number
        self._aborted = aborted

    def include(self, command: int) -> bool:
        """Return whether a frame is the next of them; after one that is not, none is."""
        number = command & _SEQUENCE
        late = number > 0 and (number == self._number or (self._aborted and number == 1))
        self.follows = (number + 1) & _SEQUENCE if late and not command & _LAST else 0
        self._number = self.follows
        return late


class LateRequest:
    """The one request that a client of any other transfer may have sent before the abort.

    A client that sends a second one has not looked at the abort, and gets it again.

    Attributes
    ----------
    part
        Of the time-out, as a divisor, within which it comes.
    """

    part: Final = 10

    def __init__(self) -> None:
        self._came = False

    def include(self, command: int) -> bool:
        """Return whether a frame is that request: it goes on with a transfer, as the first."""
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
"""Most segments in a sub-block, and what the server asks for."""

MOST_UNHEARD: Final = 16
"""Sub-blocks of an upload in a row, of which a client may have got nothing."""


class BlockDownload:
    """Data on its way into an entry.

    Parameters
    ----------
    size
        Bytes announced by the client, None if it announced nothing.
    crc
        Whether the client sends a checksum.

    Attributes
    ----------
    receiving
        Whether the next frame is a segment; else the client has yet to end the transfer.
    data
        What came in order.
    """

    def __init__(self, entry: Entry, size: int | None, *, crc: bool) -> None:
        self.entry = entry
        self.data = bytearray()
        self.receiving = True
        self._size = size
        self._with_crc = crc
        self._crc = 0
        self._summed = 0
        self._limit = size if size is not None else entry.size or MAX_BYTES
        self._most = max(self._limit, 1) + SEGMENT - 1
        self._heard = 0
        self._sequence = 0
        self._late = LateSegments()

    @property
    def interrupted(self) -> bool:
        """Whether a sub-block has begun and not ended."""
        return self._heard > 0

    def rest(self) -> LateSegments:
        """Return the segments that may still come after the transfer is aborted."""
        return LateSegments(self._late.follows or self._heard + 1, aborted=True)

    def segment(self, request: bytes) -> bytes | None:
        """Take a segment; return the confirmation at the end of a sub-block.

        After a gap the rest of the sub-block is dropped: the client sends it again. An error is
        told at the end of the sub-block, because what the client still sends of it would
        otherwise be taken for requests.

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
        """Confirm what came in order of a sub-block whose last segment is perhaps lost.

        If it is not, but late, the rest of the sub-block has no confirmation of its own.
        """
        self._late = LateSegments(self._heard + 1)
        self._heard = 0
        return self._confirm()

    def _confirm(self) -> bytes:
        response = bytes((0xA2, self._sequence, BLOCK_SIZE)) + bytes(5)
        self._sequence = 0
        # How much of the last segment is data is only known at the end.
        self._sum_up(len(self.data) - SEGMENT)
        return response

    def end(self, request: bytes) -> bytes:
        """Check the whole; return the response.

        Raises
        ------
        Abort
            TOO_LONG, TOO_SHORT, CRC.
        """
        del self.data[len(self.data) - (request[0] >> 2 & 7) :]
        if len(self.data) > self._limit:
            raise Abort(AbortCode.TOO_LONG)
        if self._size is not None and len(self.data) < self._size:
            raise Abort(AbortCode.TOO_SHORT)
        self._sum_up(len(self.data))
        if self._with_crc and self._crc != int.from_bytes(request[1:3], "little"):
            raise Abort(AbortCode.CRC)
        return b"\xa1" + bytes(7)

    def _sum_up(self, end: int) -> None:
        if self._with_crc and end > self._summed:
            self._crc = crc_hqx(self.data[self._summed : end], self._crc)
            self._summed = end


class BlockUpload:
    """Data on its way to the client: a snapshot of the entry when the transfer began.

    Parameters
    ----------
    block_size
        Segments in a sub-block as the client asks for.
    crc
        Whether the client wants a checksum.

    Attributes
    ----------
    ended
        Whether the client has all, and only its last word is missing.
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
        """Begin the first sub-block.

        Raises
        ------
        Abort
            COMMAND if it was begun before.
        """
        if self._count:
            raise Abort(AbortCode.COMMAND)
        self._begin()

    def segment(self) -> bytes | None:
        """Cut the next segment of the sub-block, None if there are no more."""
        if self._sent == self._count:
            return None
        begin = self._position + SEGMENT * self._sent
        end = begin + SEGMENT
        self._sent += 1
        command = self._sent | (_LAST if end >= len(self._data) else 0)
        return bytes((command,)) + self._data[begin:end].ljust(SEGMENT, b"\0")

    def confirm(self, request: bytes) -> bytes | None:
        """Begin the next sub-block, with the first segment that was lost, or return the end.

        What was not yet sent of the last one is dropped.

        Raises
        ------
        Abort
            SEQUENCE if more is confirmed than was sent, BLOCK_SIZE, COMMAND if nothing is to be
            confirmed, TIME_OUT if nothing of `MOST_UNHEARD` sub-blocks was.
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
        """Take the client's confirmation that it has the whole.

        Raises
        ------
        Abort
            COMMAND if it comes before the end was announced.
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
"""Device time in us after which a client that does not go on is aborted, where no object says."""
TIME_OUT_NAME: Final = "SDO server time-out"
"""Name of the manufacturer object with its value in ms."""

_ABORT: Final = 0x80
# Steps of a block upload, as the client's sub-command.
_INITIATE: Final = 0
_END: Final = 1
_START: Final = 3
_NO_TRANSFER: Final = bytes(3)


class SDOServer(Service):
    """One server, with one transfer at a time; a new one takes the place of an abandoned one."""

    states: ClassVar = CONFIGURABLE

    def __init__(self, port: Port, od: ObjectDictionary, index: int, access: Access) -> None:
        super().__init__(port, od, (index,))
        self._access = access
        self._rx = self._tx = COB_INVALID
        self._timer = port.clock.timer(self._on_time_out)
        entry = od.find(TIME_OUT_NAME)
        self._time_out = None if entry is None or entry.data_type not in UNSIGNED else entry
        self._address = _NO_TRANSFER
        self._transfer: Download | Upload | BlockDownload | BlockUpload | None = None
        self._late: LateSegments | LateRequest | None = None
        self._commands: Final = (
            self._download_segment,
            self._initiate_download,
            self._initiate_upload,
            self._upload_segment,
            self._drop,
            self._block_upload,
            self._block_download,
            self._unknown,
        )

    def check(self, entry: Entry, value: Any) -> None:
        """Refuse another CAN-ID while the one in force is valid."""
        if entry.subindex in (1, 2):
            check_cob_id(entry.value, value)

    def apply(self, entry: Entry) -> None:
        """Take a new CAN-ID; a server switched off drops its transfer."""
        self.configure()
        if not self._valid:
            self._end()

    def configure(self) -> None:
        """Read the CAN-IDs; the first server has those of the pre-defined connection set."""
        index = self.objects[0]
        default = index == SDO_SERVER_FIRST
        rx = SDO_RX_ID + self.od.node_id if default else COB_INVALID
        tx = SDO_TX_ID + self.od.node_id if default else COB_INVALID
        self._rx = self.od.number(index, 1, rx)
        self._tx = self.od.number(index, 2, tx)

    @property
    def _valid(self) -> bool:
        return not (self._rx | self._tx) & COB_INVALID

    @property
    def sends(self) -> tuple[int, ...]:
        """That of its responses, if it is on."""
        return (self._tx & CAN_ID_MASK,) if self._valid else ()

    def cease(self) -> None:
        """Drop the transfer that is under way, without an abort."""
        self._end()

    def listen(self) -> None:
        """Listen to the client, if the server is valid."""
        if self._valid:
            self.port.listen(self._rx & CAN_ID_MASK, self.receive)

    def receive(self, frame: Frame) -> None:
        """Take a request; frames that are not 8 bytes long are no SDO."""
        data = frame.data
        if len(data) != FRAME_BYTES or frame.rtr:
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
            # The write may have moved the server; the client still waits at the old CAN-ID.
            self._send(response, tx)

    def segment(self) -> Frame | None:
        """Cut the next segment of a block upload, None if there is none to send now."""
        transfer = self._transfer
        data = transfer.segment() if isinstance(transfer, BlockUpload) else None
        if data is None:
            return None
        # The client cannot answer before it has the last segment, however slow the bus is.
        self._wait()
        return Frame(self._tx & CAN_ID_MASK, data)

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
        if 1 <= len(data) <= EXPEDITED_BYTES:
            self._end()
            return bytes((0x43 | (4 - len(data)) << 2,)) + request[1:4] + data.ljust(4, b"\0")
        self._transfer = Upload(data)
        self._wait()
        return b"\x41" + request[1:4] + len(data).to_bytes(4, "little")

    def _download_segment(self, request: bytes) -> bytes:
        transfer = self._transfer
        if not isinstance(transfer, Download):
            raise Abort(AbortCode.COMMAND)
        response, last = transfer.segment(request)
        if last:
            self._access.write(transfer.entry, bytes(transfer.data))
        self._go_on(last)
        return response

    def _upload_segment(self, request: bytes) -> bytes:
        transfer = self._transfer
        if not isinstance(transfer, Upload):
            raise Abort(AbortCode.COMMAND)
        response, last = transfer.segment(request)
        self._go_on(last)
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
        # A sub-block whose last segment is lost is confirmed half-way to the time-out.
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
        """Take the client's abort, which has no answer."""
        self._end()

    def _unknown(self, _: bytes) -> None:
        raise Abort(AbortCode.COMMAND)

    def _go_on(self, last: bool) -> None:
        if last:
            self._end()
        else:
            self._wait()

    def _wait(self, part: int = 1) -> None:
        """Give the client the time-out, or a part of it, to go on."""
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
            # The client waits for nothing: it would take an abort for its next answer.
            self._end(LateRequest())
        else:
            late = self._rest() or LateRequest()
            self._send(self._abort(AbortCode.TIME_OUT, late), self._tx)

    def _send(self, response: bytes, tx: int) -> None:
        self.port.out.append(Frame(tx & CAN_ID_MASK, response))
