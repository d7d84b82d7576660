"""A bus between the examiner and a device in this process, on which waiting takes no real time."""

from __future__ import annotations

from collections import deque
from math import ceil
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.host.local_bus import LocalBus
from smarttac_can.host.node import Node

_STEP_US: Final = 1000
"""Time that passes between two looks."""


class DeviceTimeBus:
    """The examiner's place on a local bus: who waits here lets the time of the device pass.

    Parameters
    ----------
    node
        Switched on at once; its boot-up message is the first frame.
    """

    def __init__(self, node: Node) -> None:
        self._frames: deque[Frame] = deque()
        self._bus = LocalBus()
        self._port = self._bus.connect(self._frames.append)
        self._bus.attach(node, lockstep=False)

    def time(self) -> float:
        """Return the time of the device in s; the clock for `Examiner`."""
        return self._bus.time * 1e-6

    def send(self, frame: Frame) -> None:
        """Send a frame to the device; its answers wait for `receive`."""
        self._port.send(frame)

    def receive(self, timeout: float) -> Frame | None:
        """Return the next frame, with time passing in ticks of 1 ms until it comes."""
        end = self._bus.time + ceil(timeout * 1e6)  # up, so that every wait moves the time
        while not self._frames:
            left = end - self._bus.time
            if left <= 0:
                return None
            self._bus.advance(min(_STEP_US, left))
        return self._frames.popleft()

    def close(self) -> None:
        """Switch the device off."""
        self._bus.shutdown()
