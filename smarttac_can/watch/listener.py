"""A bus in a thread of its own: what it brings, with the time, and what goes out."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.host.background import Background
from smarttac_can.host.bus import Bus, BusError, QueueFullError
from smarttac_can.host.reconnecting_bus import ReconnectingBus

_WAIT_S: Final = 0.01
"""Longest time a frame that is to go out waits for one that comes."""
_END_S: Final = 5.0


class Listener(Background):
    """Hears every frame of a bus while its block lasts, also when the bus goes and comes back.

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
        self._outgoing: SimpleQueue[Frame] = SimpleQueue()
        self._bus = ReconnectingBus(open_bus, _Nobody(), lost=self._lose, back=self._find)

    def heard(self) -> Iterator[tuple[float, Frame]]:
        """Take out what has come so far: times of `time.monotonic`, and frames."""
        for _ in range(self._heard.qsize()):
            yield self._heard.get()

    def send(self, frame: Frame) -> None:
        """Have a frame sent; without a bus it is dropped."""
        self._outgoing.put(frame)

    def _listen(self) -> None:
        try:
            frames: deque[Frame] = deque()
            while not self._over.is_set():
                try:
                    self._send_what_waits()
                    if not self._bus.read(frames) and not frames:
                        self._bus.wait(_WAIT_S)
                except BusError as error:
                    self._bus.lose(error)
                while frames:
                    self._heard.put((monotonic(), frames.popleft()))
            with suppress(BusError):
                self._send_what_waits()
        finally:
            self._close()

    def _send_what_waits(self) -> None:
        try:
            while True:
                self._bus.send(self._outgoing.get_nowait())
        except Empty:
            return
        except QueueFullError:
            # A read is asked again, a stop is written again.
            return

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
