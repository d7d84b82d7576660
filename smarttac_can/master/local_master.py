"""A master on a local bus; all effects of a call have happened when it returns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from smarttac_can.device.frame import Frame
from smarttac_can.host.local_bus import LocalBus
from smarttac_can.master import requests
from smarttac_can.master.errors import HeartbeatLostError
from smarttac_can.od.cia import SYNC_COUNTER_LAST
from smarttac_can.od.entry import Entry


class LocalMaster:
    """Sends frames to the nodes on a `LocalBus`, and reads and writes them by expedited SDO.

    Parameters
    ----------
    bus
        Bus to connect to.
    hear
        Function called with every frame of other parties.

    Attributes
    ----------
    sync_counter
        Counter of the last SYNC, 0 for SYNC without a counter.
    """

    def __init__(self, bus: LocalBus, hear: Callable[[Frame], None]) -> None:
        self.sync_counter = 0
        self._hear = hear
        self._heard: list[Frame] = []
        self._port = bus.connect(self._on_frame)

    def send(self, *frames: Frame) -> list[Frame]:
        """Send frames; return the frames that the nodes send because of them, in order."""
        self._heard = []
        for frame in frames:
            self._port.send(frame)
        heard, self._heard = self._heard, []
        return heard

    def sync(self) -> list[Frame]:
        """Send SYNC, with the next count if it has a counter; return the frames that follow."""
        if self.sync_counter:
            self.sync_counter = self.sync_counter % SYNC_COUNTER_LAST + 1
        return self.send(requests.sync(self.sync_counter))

    def read(self, node_id: int, entry: Entry) -> Any:
        """Return the raw value of an entry of 1 to 4 bytes.

        Raises
        ------
        Abort
            If the node refuses.
        HeartbeatLostError
            If the node does not answer at once.
        """
        return self._transfer(requests.upload(node_id, entry), node_id, entry)

    def write(self, node_id: int, entry: Entry, raw: Any) -> None:
        """Write a raw value to an entry of 1 to 4 bytes; raises as `read`."""
        self._transfer(requests.download(node_id, entry, raw), node_id, entry)

    def _transfer(self, request: Frame, node_id: int, entry: Entry) -> Any:
        for frame in self.send(request):
            if requests.answers(frame, request):
                return requests.value(frame, entry)
        raise HeartbeatLostError(f"node {node_id} does not answer to {entry.name}")

    def _on_frame(self, frame: Frame) -> None:
        self._heard.append(frame)
        self._hear(frame)
