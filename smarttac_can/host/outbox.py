"""Queue of frames for a bus: urgent frames first, and without waiting."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import Final, Protocol

from smarttac_can.canopen.bus.bus import QueueFullError
from smarttac_can.canopen.bus.node import HostedNode
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od import cia
from smarttac_can.vocabulary.signals import TICK_US

_MOST_WAITING: Final = 64
"""Most waiting frames that are not urgent, or emergency messages; then the oldest is dropped."""


_ERROR_CONTROL: Final = range(cia.HEARTBEAT_ID + 1, cia.HEARTBEAT_ID + cia.LAST_NODE_ID + 1)


class Taker(Protocol):
    """Receiver of frames: a `Bus`, or a substitute."""

    def send(self, frame: Frame) -> None:
        """Accept a frame, or raise QueueFullError."""


class Outbox:
    """Hands the frames of a node over as fast as the bus accepts them.

    Urgent frames go first. It is a fault if the bus has not accepted an urgent frame within a tick.
    The node is then informed, and of the urgent frames only emergency messages and the new frames
    of the node are kept. For other frames there is no time limit; a boot-up message drops them.

    Parameters
    ----------
    node
        Node that sends the frames.
    bus
        Bus for the frames; `send` must not wait.
    full
        Function called when a fault begins, with the error of the bus. The fault ends when all
        frames have been handed over.
    """

    def __init__(
        self, node: HostedNode, bus: Taker, full: Callable[[QueueFullError], None]
    ) -> None:
        self._node = node
        self._bus = bus
        self._full = full
        self._urgent: deque[tuple[int, Frame]] = deque()
        self._others: deque[Frame] = deque()
        self._failing = False

    @property
    def empty(self) -> bool:
        """Whether no frames wait."""
        return not self._urgent and not self._others

    def put(self, frames: Iterable[Frame]) -> None:
        """Queue frames that the node has just made."""
        if not frames:
            return
        urgent = self._node.ids.urgent
        for frame in frames:
            if frame.data == cia.BOOT_UP and frame.can_id in _ERROR_CONTROL:
                # Frames that still wait are from before the reset.
                self._others.clear()
            if frame.can_id in urgent:
                self._urgent.append((self._node.clock.now + TICK_US, frame))
            else:
                self._others.append(frame)
        while len(self._others) > _MOST_WAITING:
            self._others.popleft()

    def hand_over(self) -> bool:
        """Hand over the next frame; return whether another one may follow at once."""
        if self.empty:
            return False
        try:
            if self._urgent:
                self._bus.send(self._urgent[0][1])
                self._urgent.popleft()
            else:
                self._bus.send(self._others[0])
                self._others.popleft()
        except QueueFullError as error:
            self._give_up(error)
            return False
        if self.empty:
            self._failing = False
        return not self.empty

    def _give_up(self, reason: QueueFullError) -> None:
        """Drop urgent frames of past cycles, except emergency messages, and inform the node."""
        if not self._urgent or self._urgent[0][0] > self._node.clock.now:
            return
        emcy_id = self._node.ids.emcy
        kept = [frame for _, frame in self._urgent if frame.can_id == emcy_id][-_MOST_WAITING:]
        self._urgent.clear()
        self.put([*kept, *self._node.transmit_failed()])
        if not self._failing:
            self._failing = True
            self._full(reason)
