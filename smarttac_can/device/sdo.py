"""SDO server: expedited, segmented and block transfers (CiA 301, 7.2.4)."""

from __future__ import annotations

from typing import Any, ClassVar, Final

from smarttac_can.device.access import Access
from smarttac_can.device.block import BLOCK_SIZE, BlockDownload, BlockUpload
from smarttac_can.device.frame import Frame
from smarttac_can.device.late import LateRequest, LateSegments
from smarttac_can.device.nmt import CONFIGURABLE
from smarttac_can.device.port import Port
from smarttac_can.device.segmented import Download, Upload
from smarttac_can.device.service import Service, check_cob_id
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
from smarttac_can.od.entry import Entry

TIME_OUT: Final = 1_000_000
"""Device time in us after which a client that does not go on is aborted, where no object says."""
TIME_OUT_NAME: Final = "SDO server time-out"
"""Name of the manufacturer object that holds it in ms."""

_ABORT: Final = 0x80
# Steps of a block upload, as the client's sub-command.
_INITIATE: Final = 0
_END: Final = 1
_START: Final = 3
_NO_TRANSFER: Final = bytes(3)


class SDOServer(Service):
    """One server, with one transfer at a time; a new one takes the place of one left behind."""

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
