"""A connection that survives its interface being unplugged, or set down, and up again."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from math import inf
from time import monotonic, sleep

from smarttac_can.canopen.bus.bus import Bus, BusError, QueueFullError
from smarttac_can.canopen.bus.node import Connected
from smarttac_can.canopen.device.frame import Frame

FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 5.0
_STEADY_S = 1.0
"""If the bus fails sooner after it came back, the intervals keep growing."""
_NAP_S = 0.02


class ReconnectingBus:
    """Opens its bus again, at growing intervals, whenever it has failed.

    The user calls `lose` with the BusError that a method has raised. While there is no bus, frames
    are dropped, because they would be outdated later. The bus is back when it can be read, as
    SocketCAN also opens an interface that is still down.

    Parameters
    ----------
    open_bus
        Function that opens the bus or raises BusError. Called at once; it must not fail then.
    node
        Party that is informed when the bus is lost, and when it is back; it then returns frames.
    lost
        Function called when the bus is lost, with the reason for people.
    back
        Function called when the bus is back.
    clock, pause
        Function that returns monotonic time in s, and function that waits for a time in s.

    Attributes
    ----------
    send, wait, read
        Methods of a `Bus`: those of the opened bus while there is one.
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
        self._back_at = -inf
        self._pending: deque[Frame] = deque()
        self._blocked: frozenset[int] = frozenset()
        self._on_trial = False
        self._bus: Bus | None = None
        self.send: Callable[[Frame], None]
        self.wait: Callable[[float], bool]
        self.read: Callable[[deque[Frame]], bool]
        self._use(open_bus())

    def block(self, can_ids: frozenset[int]) -> None:
        """Drop frames with these identifiers from now on, also after the bus has come back."""
        self._blocked = can_ids
        if self._bus is not None:
            self._bus.block(can_ids)

    def close(self) -> None:
        """Leave the bus."""
        if self._bus is not None:
            self._bus.close()
        self._leave()

    def lose(self, reason: BusError) -> None:
        """Give up the failed bus, and open it again later."""
        with suppress(BusError):
            self.close()
        self._leave()
        self._pending.clear()
        if self._on_trial:
            self._wait_longer()
            return
        if self._clock() - self._back_at >= _STEADY_S:
            self._wait = FIRST_WAIT_S
            self._next_try = self._clock() + self._wait
        else:
            self._wait_longer()
        self._node.bus_off()
        self._lost(reason)

    def _use(self, bus: Bus) -> None:
        self._bus = bus
        self.send, self.wait, self.read = bus.send, bus.wait, bus.read

    def _leave(self) -> None:
        self._bus = None
        self.send, self.wait, self.read = self._drop, self._nap, self._try_again

    def _drop(self, _frame: Frame) -> None:
        """Send nothing."""

    def _nap(self, timeout: float) -> bool:
        self._pause(min(timeout, _NAP_S))
        return True

    def _try_again(self, _frames: deque[Frame]) -> bool:
        if self._clock() < self._next_try:
            return False
        self._on_trial = True
        try:
            bus = self._open()
        except BusError:
            self._wait_longer()
            return False
        self._bus = bus
        self.wait, self.read = bus.wait, self._read_first
        if self._blocked:
            bus.block(self._blocked)
        return True

    def _wait_longer(self) -> None:
        self._wait = min(2.0 * self._wait, LONGEST_WAIT_S)
        self._next_try = self._clock() + self._wait

    def _read_first(self, frames: deque[Frame]) -> bool:
        """Read a reopened bus; the frames of the node for this go out before all others."""
        if self._bus is None:
            return False
        more = self._bus.read(frames)
        self._on_trial = False
        self._back_at = self._clock()
        self._back()
        self._pending.extend(self._node.bus_recovered())
        self._use(self._bus)
        if self._pending:
            self.send, self.read = self._send_after_pending, self._read_and_send_pending
            self.wait = self._wait_with_pending
            with suppress(QueueFullError):
                self._send_pending()
        return more

    def _wait_with_pending(self, timeout: float) -> bool:
        """Wait, and have the bus read whether a frame came or not: a read sends what is pending."""
        if self._bus is not None:
            self._bus.wait(timeout)
        return True

    def _read_and_send_pending(self, frames: deque[Frame]) -> bool:
        with suppress(QueueFullError):
            self._send_pending()
        return self._bus is not None and self._bus.read(frames)

    def _send_after_pending(self, frame: Frame) -> None:
        self._send_pending()
        if self._bus is not None:
            self._bus.send(frame)

    def _send_pending(self) -> None:
        while self._bus is not None and self._pending:
            self._bus.send(self._pending[0])
            self._pending.popleft()
        if self._bus is not None:
            self._use(self._bus)
