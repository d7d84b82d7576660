"""SDO block transfers (CiA 301, 7.2.4.3.9 to 7.2.4.3.15), from the second frame on."""

from __future__ import annotations

from binascii import crc_hqx
from typing import Final

from smarttac_can.device.late import LateSegments
from smarttac_can.device.segmented import SEGMENT
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.entry import MAX_BYTES, Entry

BLOCK_SIZE: Final = 127
"""Most segments in a sub-block, and what the server asks for."""

MOST_UNHEARD: Final = 16
"""Sub-blocks of an upload in a row, of which a client may have got nothing."""

_LAST: Final = 0x80
_SEQUENCE: Final = 0x7F


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
