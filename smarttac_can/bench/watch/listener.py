"""A bus in a separate thread: received frames with their time, and transmitted frames."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from queue import SimpleQueue
from time import monotonic
from typing import Final

from smarttac_can.canopen.bus.bus import Bus, BusError, QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.background import Background
from smarttac_can.host.reconnecting_bus import ReconnectingBus

_WAIT_S: Final = 0.01
_END_S: Final = 5.0


class Listener(Background):
    """Receives every frame of a bus during a block, also after the bus was lost and is back.

    `send` transmits in the thread of its caller, so that a stop does not wait for the receiving
    thread. Buses of python-can allow one sender beside a receiver, as python-canopen does. The lock
    separates senders from each other, and from closing the bus.

    Parameters
    ----------
    open_bus
        Function that opens the bus or raises BusError. Called at once.

    Attributes
    ----------
    lost
        Reason why there is no bus; empty while there is one.
    """

    def __init__(self, open_bus: Callable[[], Bus]) -> None:
        self._over = threading.Event()
        super().__init__("listener", self._listen, self._over.set, _END_S)
        self.lost = ""
        self._heard: SimpleQueue[tuple[float, Frame]] = SimpleQueue()
        self._sending = threading.Lock()
        self._failed: BusError | None = None
        self._bus = ReconnectingBus(open_bus, _Nobody(), lost=self._lose, back=self._find)

    def heard(self) -> Iterator[tuple[float, Frame]]:
        """Yield new frames since the last call, each after its time of `time.monotonic`."""
        for _ in range(self._heard.qsize()):
            yield self._heard.get()

    def send(self, frame: Frame) -> None:
        """Send a frame; it is dropped without a bus, or if the queue of the bus is full."""
        with self._sending:
            if self._over.is_set():
                return
            try:
                self._bus.send(frame)
            except QueueFullError:
                # Reads and stops are repeated by their callers.
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

    def _lose(self, reason: BusError) -> None:
        self.lost = str(reason)

    def _find(self) -> None:
        self.lost = ""


class _Nobody:
    """A party that ignores the loss and the return of the bus."""

    def bus_off(self) -> list[Frame]:
        """Return no frames."""
        return []

    def bus_recovered(self) -> list[Frame]:
        """Return no frames."""
        return []
