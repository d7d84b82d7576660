"""A bus in a thread of its own: what it brings, with the time, and what goes out."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from time import monotonic
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.host.background import Background
from smarttac_can.host.bus import Bus, BusError, QueueFullError
from smarttac_can.host.reconnecting_bus import ReconnectingBus

_WAIT_S: Final = 0.01
_END_S: Final = 5.0


class Listener(Background):
    """Hears every frame of a bus while its block lasts, also when the bus goes and comes back.

    Frames are sent by whoever calls `send`, at once: a stop does not wait until the thread that
    listens has heard something. python-can's buses take a sender beside a receiver, as
    python-canopen does; the lock keeps senders from each other, and from a bus that is closed.

    Parameters
    ----------
    open_bus
        Opens the bus; raises BusError. Called at once.

    Attributes
    ----------
    lost
        Why there is no bus; empty while there is one.
    """

    def __init__(self, open_bus: Callable[[], Bus]) -> None:
        super().__init__("listener", self._listen, self._stop, _END_S)
        self.lost = ""
        self._over = threading.Event()
        self._heard: SimpleQueue[tuple[float, Frame]] = SimpleQueue()
        self._sending = threading.Lock()
        self._failed: BusError | None = None
        self._bus = ReconnectingBus(open_bus, _Nobody(), lost=self._lose, back=self._find)

    def heard(self) -> Iterator[tuple[float, Frame]]:
        """Take out what has come so far: times of `time.monotonic`, and frames."""
        for _ in range(self._heard.qsize()):
            yield self._heard.get()

    def send(self, frame: Frame) -> None:
        """Send a frame; it is dropped without a bus, and where the queue of the bus is full."""
        with self._sending:
            if self._over.is_set():
                return
            try:
                self._bus.send(frame)
            except QueueFullError:
                # A read is asked again, a stop is written again.
                return
            except BusError as error:
                self._failed = error

    def _listen(self) -> None:
        try:
            frames: deque[Frame] = deque()
            while not self._over.is_set():
                try:
                    if self._failed is not None:
                        raise self._failed
                    if not self._bus.read(frames) and not frames:
                        self._bus.wait(_WAIT_S)
                except BusError as error:
                    with self._sending:
                        self._failed = None
                        self._bus.lose(error)
                while frames:
                    self._heard.put((monotonic(), frames.popleft()))
        finally:
            with self._sending:
                self._close()

    def _close(self) -> None:
        try:
            self._bus.close()
        except BusError as error:
            self.lost = str(error)

    def _stop(self) -> None:
        self._over.set()

    def _lose(self, reason: BusError) -> None:
        self.lost = str(reason)

    def _find(self) -> None:
        self.lost = ""


class _Nobody:
    """Whom it does not concern that the bus goes and comes back."""

    def bus_off(self) -> list[Frame]:
        """Say nothing."""
        return []

    def bus_recovered(self) -> list[Frame]:
        """Say nothing."""
        return []
