"""A connection that outlives its interface: unplugged and plugged in again, down and up."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from time import monotonic, sleep

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import Bus, BusError, QueueFullError
from smarttac_can.host.node import Connected

FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 5.0
_NAP_S = 0.02


class ReconnectingBus:
    """Opens its bus again, at growing intervals, whenever it has failed.

    While there is no bus, frames are dropped: they are about a moment that is over when it is back.
    It is back when it can be listened to: SocketCAN opens an interface that is still down.

    Parameters
    ----------
    open_bus
        Opens the bus; raises BusError. Called at once, and then must not fail.
    node
        Told when there is no bus any more, and when it is back, of which it tells the others.
    lost
        Called then with the reason, for people.
    back
        Called when it is there again.
    clock, pause
        Monotonic time in s, and a wait of so many s.
    """

    def __init__(
        self,
        open_bus: Callable[[], Bus],
        node: Connected,
        *,
        lost: Callable[[BusError], None],
        back: Callable[[], None],
        clock: Callable[[], float] = monotonic,
        pause: Callable[[float], None] = sleep,
    ) -> None:
        self._open = open_bus
        self._node = node
        self._lost = lost
        self._back = back
        self._clock = clock
        self._pause = pause
        self._wait = FIRST_WAIT_S
        self._next_try = 0.0
        self._owed: deque[Frame] = deque()
        self._can_ids: frozenset[int] | None = None
        self._on_trial = False
        self._bus: Bus | None = open_bus()

    def send(self, frame: Frame) -> None:
        """Send a frame; without a bus it is dropped.

        Raises
        ------
        QueueFullError
            If the bus takes none for now.
        """
        if self._bus is None:
            return
        try:
            self._send_owed()
            self._bus.send(frame)
        except QueueFullError:
            raise
        except BusError as error:
            self._lose(error)

    def receive(
        self, timeout: float, patience: float = 0.0, *, every: bool = False
    ) -> Frame | None:
        """Return the next frame of another party, or None after timeout s; tries to get back."""
        if self._bus is None:
            self._try_again()
        if self._bus is None:
            self._pause(min(timeout, _NAP_S))
            return None
        try:
            frame = self._bus.receive(timeout, patience, every=every)
        except BusError as error:
            self._lose(error)
            return None
        self._end_trial()
        return frame

    def listen_to(self, can_ids: frozenset[int]) -> None:
        """Pass over frames with other identifiers from now on, also on a bus that is back."""
        self._can_ids = can_ids
        if self._bus is not None:
            self._bus.listen_to(can_ids)

    def close(self) -> None:
        """Leave the bus, and try to open it no more."""
        if self._bus is not None:
            self._bus.close()
            self._bus = None

    def _lose(self, reason: BusError) -> None:
        with suppress(BusError):
            self.close()
        self._bus = None
        self._owed.clear()
        if self._on_trial:
            self._wait_longer()
            return
        self._wait = FIRST_WAIT_S
        self._next_try = self._clock() + self._wait
        self._node.bus_off()
        self._lost(reason)

    def _try_again(self) -> None:
        if self._clock() < self._next_try:
            return
        self._on_trial = True
        try:
            self._bus = self._open()
        except BusError:
            self._wait_longer()
        else:
            if self._can_ids is not None:
                self._bus.listen_to(self._can_ids)

    def _wait_longer(self) -> None:
        self._wait = min(2.0 * self._wait, LONGEST_WAIT_S)
        self._next_try = self._clock() + self._wait

    def _end_trial(self) -> None:
        if not self._on_trial:
            return
        self._on_trial = False
        self._back()
        self._owed.extend(self._node.bus_recovered())
        try:
            self._send_owed()
        except QueueFullError:
            pass  # the next frame sends them
        except BusError as error:
            self._lose(error)

    def _send_owed(self) -> None:
        while self._bus is not None and self._owed:
            self._bus.send(self._owed[0])
            self._owed.popleft()
