"""python-canopen's network on a local bus: its frames go in and out by function calls."""

from __future__ import annotations

from smarttac_can.bench.tapped_network import TappedNetwork
from smarttac_can.device.frame import Frame
from smarttac_can.host.local_bus import LocalBus


class LocalNetwork(TappedNetwork):
    """A network without threads: what a sent frame causes has happened when sending returns.

    Parameters
    ----------
    bus
        The bus to take part in.
    """

    def __init__(self, bus: LocalBus) -> None:
        super().__init__()
        self._local_bus = bus
        self._port = bus.connect(self._on_frame)

    def now(self) -> float:
        """Return the time on the bus in s."""
        return self._local_bus.time * 1e-6

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame; all that it causes has happened on return."""
        frame = Frame(can_id, bytes(data), remote)
        if not remote:
            for can_ids, hear in self.taps:
                if can_id in can_ids:
                    hear(can_id, frame.data)
        self._port.send(frame)

    def disconnect(self) -> None:
        """Shut the nodes down and leave the bus."""
        self._local_bus.shutdown()
        self._port.close()

    def _on_frame(self, frame: Frame) -> None:
        can_id, data, rtr = frame
        if not rtr:
            for can_ids, hear in self.taps:
                if can_id in can_ids:
                    hear(can_id, data)
            for callback in self.subscribers.get(can_id, ()):
                callback(can_id, bytearray(data), self._local_bus.time * 1e-6)
