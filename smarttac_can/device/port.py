"""What all services of a device share: frames out, listeners by identifier, time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from smarttac_can.device.frame import Frame
from smarttac_can.device.timer import Clock
from smarttac_can.od.cia import SYNC_ID


class Identifiers(NamedTuple):
    """CAN-IDs that matter to whoever connects a device to a bus."""

    heard: frozenset[int] = frozenset()
    """Of frames that it listens to in one NMT state or another; those of another identifier may be
    dropped before they get here, and the device ignores what its present state does not serve."""
    urgent: frozenset[int] = frozenset()
    """Of its frames that go before others and are of no use late: SYNC, EMCY, error control, and
    the TPDOs that somebody's control loop waits for."""
    emcy: int = 0
    """Of its emergency messages, which are of use however late."""
    sent: frozenset[int] = frozenset()
    """Those that are its own: no other device may send with them."""
    sync: int = SYNC_ID
    """Of SYNC."""


class Port:
    """The device's side of its CAN connection.

    Attributes
    ----------
    clock
        Device time.
    out
        Frames to send, in order of cause.
    listeners
        Handlers by identifier.
    """

    __slots__ = ("_streams", "clock", "listeners", "out")

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.out: list[Frame] = []
        self.listeners: dict[int, list[Callable[[Frame], None]]] = {}
        self._streams: deque[Callable[[], Frame | None]] = deque()

    def listen(self, can_id: int, handler: Callable[[Frame], None]) -> None:
        """Call the handler with every frame of this CAN-ID."""
        self.listeners.setdefault(can_id, []).append(handler)

    def take(self) -> list[Frame]:
        """Return the frames to send, and forget them."""
        out = self.out
        if not out:
            return []
        self.out = []
        return out

    def stream(self, source: Callable[[], Frame | None]) -> None:
        """Ask a source for frames as fast as the bus takes them, until it gives None."""
        if source not in self._streams:
            self._streams.append(source)

    def segments(self, most: int) -> list[Frame]:
        """Take the next frames of the sources, at most so many; the sources take turns."""
        frames: list[Frame] = []
        streams = self._streams
        while streams and len(frames) < most:
            source = streams.popleft()
            frame = source()
            if frame is not None:
                frames.append(frame)
                streams.append(source)
        return frames
