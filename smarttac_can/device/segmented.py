"""Segmented SDO transfers (CiA 301, 7.2.4.3.3 to 7.2.4.3.6), from the second frame on."""

from __future__ import annotations

from smarttac_can.od.cia import Abort, AbortCode
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
