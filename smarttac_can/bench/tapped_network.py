"""python-canopen's network with ears: who listens hears its own frames, too, in their order."""

from __future__ import annotations

import canopen

from smarttac_can.bench.link import Hear


class TappedNetwork(canopen.Network):  # type: ignore[misc]  # python-canopen is untyped
    """A network whose data frames, sent and received, are told to its taps.

    Attributes
    ----------
    taps
        Each is called with the identifier and the data of a frame, before who subscribes to it; in
        the thread that sends or receives.
    own_taps
        These are told of sent frames alone.
    """

    def __init__(self) -> None:
        super().__init__()
        self.taps: tuple[Hear, ...] = ()
        self.own_taps: tuple[Hear, ...] = ()

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame."""
        if not remote:
            for tap in (*self.taps, *self.own_taps):
                tap(can_id, bytes(data))
        super().send_message(can_id, data, remote)

    def notify(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Take a received frame."""
        for tap in self.taps:
            tap(can_id, bytes(data))
        super().notify(can_id, data, timestamp)
