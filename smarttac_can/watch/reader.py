"""A guest at an SDO server: one expedited read at a time, seldom, and never in another's way."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.master import requests
from smarttac_can.od.cia import SDO_RX_ID, Abort
from smarttac_can.od.entry import Entry

PAUSE_S: Final = 0.05
"""Between two reads: below 0.6 % of a bus of 1 Mbit/s."""
TIMEOUT_S: Final = 0.5
YIELD_S: Final = 0.3
"""How long it asks nothing after another client has: an upload would end that one's transfer."""


class SdoReader:
    """Reads entries in turn, over and over; some of them once, before the others.

    Parameters
    ----------
    node_id
        Node-ID of the server.
    once
        Entries of 1 to 4 bytes to read first.
    again
        Those to read over and over.

    Attributes
    ----------
    values
        Raw value of each entry that was read.
    silent
        Whether the last request has not been answered.
    read_at
        Time in s at which each entry was read last.
    """

    def __init__(self, node_id: int, once: Iterable[Entry], again: Iterable[Entry]) -> None:
        self._node_id = node_id
        self._once, self._again = list(once), list(again)
        self.values: dict[Entry, int] = {}
        self.read_at: dict[Entry, float] = {}
        self.silent = False
        self._asked: tuple[Entry, Frame] | None = None
        self._next = 0.0
        self._deadline = 0.0
        self.restart()

    def restart(self) -> None:
        """Begin with the first entry; what was read is forgotten."""
        self.values.clear()
        self.read_at.clear()
        self._asked = None
        self._open = set(self._once)
        self._turn = deque([*self._once, *self._again])

    @property
    def begun(self) -> bool:
        """Whether all that is read once has been asked for."""
        return not self._open

    def take(self, now: float, frame: Frame) -> bool:
        """Take any frame of the bus, maybe another client's request; tell if it is an answer."""
        if frame.can_id == SDO_RX_ID + self._node_id:
            self._next = now + YIELD_S
            return False
        if self._asked is None or not requests.answers(frame, self._asked[1]):
            return False
        entry = self._asked[0]
        self._done(entry)
        self.silent = False
        self._next = max(self._next, now + PAUSE_S)
        try:
            self.values[entry] = int(requests.value(frame, entry))
            self.read_at[entry] = now
        except Abort:
            self.values.pop(entry, None)
        return True

    def request(self, now: float) -> Frame | None:
        """Return the request that is due at a time in s, if one is."""
        if self._asked is not None:
            if now < self._deadline:
                return None
            self.silent = True
            self._turn.appendleft(self._asked[0])
            self._asked = None
            self._next = now + TIMEOUT_S
        if now < self._next or not self._turn:
            return None
        entry = self._turn.popleft()
        frame = requests.upload(self._node_id, entry)
        self._asked = entry, frame
        self._deadline = now + TIMEOUT_S
        return frame

    def _done(self, entry: Entry) -> None:
        self._asked = None
        if entry in self._open:
            self._open.discard(entry)
        else:
            self._turn.append(entry)
