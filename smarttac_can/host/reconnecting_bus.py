"""A connection that outlives its interface: unplugged and plugged in again, down and up."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from math import inf
from time import monotonic, sleep

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import Bus, BusError, QueueFullError
from smarttac_can.host.node import Connected

FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 5.0
_STEADY_S = 1.0
"""A bus that was back for a shorter time is tried again at the growing intervals."""
_NAP_S = 0.02


class ReconnectingBus:
    """Opens its bus again, at growing intervals, whenever it has failed.

    Whoever uses it calls `lose` with the BusError that a method has raised. While there is no bus,
    frames are dropped: they are about a moment that is over when it is back. It is back when it can
    be read: SocketCAN opens an interface that is still down.

    Parameters
    ----------
    open_bus
        Opens the bus; raises BusError. Called at once, and then must not fail.
    node
        Called when the bus is lost and when it is back; the latter returns frames to send.
    lost
        Called then with the reason, for people.
    back
        Called when it is there again.
    clock, pause
        Monotonic time in s, and a wait of so many s.

    Attributes
    ----------
    send, wait, read
        As `Bus` has them: those of the bus itself, while it is there.
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
        self._owed: deque[Frame] = deque()
        self._blocked: frozenset[int] = frozenset()
        self._on_trial = False
        self._bus: Bus | None = None
        self.send: Callable[[Frame], None]
        self.wait: Callable[[float], None]
        self.read: Callable[[deque[Frame]], bool]
        self._use(open_bus())

    def block(self, can_ids: frozenset[int]) -> None:
        """Drop frames with these identifiers from now on, also on a bus that is back."""
        self._blocked = can_ids
        if self._bus is not None:
            self._bus.block(can_ids)

    def close(self) -> None:
        """Leave the bus."""
        if self._bus is not None:
            self._bus.close()
        self._leave()

    def lose(self, reason: BusError) -> None:
        """Give up the bus that has failed, and open it again later."""
        with suppress(BusError):
            self.close()
        self._leave()
        self._owed.clear()
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

    def _nap(self, timeout: float) -> None:
        self._pause(min(timeout, _NAP_S))

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
        """Read a bus that was opened again; what the node says of that goes out before all else."""
        if self._bus is None:
            return False
        more = self._bus.read(frames)
        self._on_trial = False
        self._back_at = self._clock()
        self._back()
        self._owed.extend(self._node.bus_recovered())
        self._use(self._bus)
        if self._owed:
            self.send, self.read = self._send_behind, self._read_behind
            with suppress(QueueFullError):
                self._send_owed()
        return more

    def _read_behind(self, frames: deque[Frame]) -> bool:
        with suppress(QueueFullError):
            self._send_owed()
        return self._bus is not None and self._bus.read(frames)

    def _send_behind(self, frame: Frame) -> None:
        self._send_owed()
        if self._bus is not None:
            self._bus.send(frame)

    def _send_owed(self) -> None:
        while self._bus is not None and self._owed:
            self._bus.send(self._owed[0])
            self._owed.popleft()
        if self._bus is not None:
            self._use(self._bus)
