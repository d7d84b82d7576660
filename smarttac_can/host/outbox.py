"""Frames on their way to a bus: those of the loop first, and nothing here waits."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import Final, Protocol

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import QueueFullError
from smarttac_can.host.node import HostedNode
from smarttac_can.od.cia import BOOT_UP, HEARTBEAT_ID, LAST_NODE_ID
from smarttac_can.vocabulary.signals import TICK_US

_MOST_WAITING: Final = 64
"""Frames of no urgency, or emergency messages, that wait before the oldest is dropped."""


_ERROR_CONTROL: Final = range(HEARTBEAT_ID + 1, HEARTBEAT_ID + LAST_NODE_ID + 1)


class Taker(Protocol):
    """Where frames go: a `Bus`, or what stands for one."""

    def send(self, frame: Frame) -> None:
        """Take a frame, or raise QueueFullError."""


class Outbox:
    """Hands the frames of a node over as fast as the bus takes them.

    Urgent frames go first. One that the bus has not taken a tick after it was made is a fault: the
    node is told, and of those that wait only emergency messages, and what the node says then, are
    kept. Other frames wait, and never count; a boot-up message drops those.

    Parameters
    ----------
    node
        The frames are its own.
    bus
        Never asked to wait.
    full
        Called when a fault begins, with the text of the bus; it ends when all was handed over.
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
        """Whether nothing waits."""
        return not self._urgent and not self._others

    def put(self, frames: Iterable[Frame]) -> None:
        """Take frames of the node, made now."""
        if not frames:
            return
        urgent = self._node.ids.urgent
        for frame in frames:
            if frame.data == BOOT_UP and frame.can_id in _ERROR_CONTROL:
                # What still waits is of before the reset.
                self._others.clear()
            if frame.can_id in urgent:
                self._urgent.append((self._node.clock.now + TICK_US, frame))
            else:
                self._others.append(frame)
        while len(self._others) > _MOST_WAITING:
            self._others.popleft()

    def hand_over(self) -> bool:
        """Hand the next frame over; return whether another one may follow at once."""
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
        """Drop urgent frames whose cycle is over, but for emergencies, and tell the node."""
        if not self._urgent or self._urgent[0][0] > self._node.clock.now:
            return
        emcy_id = self._node.ids.emcy
        kept = [frame for _, frame in self._urgent if frame.can_id == emcy_id][-_MOST_WAITING:]
        self._urgent.clear()
        self.put([*kept, *self._node.transmit_failed()])
        if not self._failing:
            self._failing = True
            self._full(reason)
