"""TPDOs of a stimulator that are sent in every cycle for as long as somebody records."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress

import can

from smarttac_can.bench.remote_device import RemoteDevice
from smarttac_can.bench.tapped_network import TappedNetwork
from smarttac_can.device.frame import Frame
from smarttac_can.master.errors import BenchError
from smarttac_can.master.requests import download, takes, written
from smarttac_can.od.cia import (
    BOOT_UP,
    EVENT_MANUFACTURER,
    HEARTBEAT_ID,
    PDO_TRANSMISSION,
    SDO_RX_ID,
    SDO_TX_ID,
    TPDO_COMMUNICATION,
)
from smarttac_can.od.entry import Entry


class EveryCycle:
    """Has TPDOs sent in every cycle, and puts their types back when nobody needs it any more.

    Parameters
    ----------
    network
        Network of the stimulator.
    device
        The stimulator.
    numbers
        Numbers of the TPDOs.

    Attributes
    ----------
    numbers
        The same.
    """

    def __init__(self, network: TappedNetwork, device: RemoteDevice, numbers: list[int]) -> None:
        self._network = network
        self._device = device
        self.numbers = numbers
        self._types = [
            device.od.entry(TPDO_COMMUNICATION + number - 1, PDO_TRANSMISSION) for number in numbers
        ]
        self._at = {(entry.index, entry.subindex): entry for entry in self._types}
        self._asked: set[Entry] = set()
        services = (HEARTBEAT_ID, SDO_RX_ID, SDO_TX_ID)
        self._told = {service + device.od.node_id for service in services}
        self._before: list[int] = []
        self._users = 0

    @contextmanager
    def held(self) -> Iterator[None]:
        """Have them sent in every cycle; blocks may be nested.

        They are sent so again at once when a script that ends, or a reset, puts them back.
        """
        if not self._users:
            self._before = [self._take(entry) for entry in self._types]
            self._asked.clear()
            self._network.taps += (self._keep,)
        self._users += 1
        try:
            yield
        except BaseException:
            # The first failure is the one to report.
            with suppress(BenchError):
                self._release()
            raise
        self._release()

    def _keep(self, can_id: int, data: bytes) -> None:
        """Hear what others ask for, and ask again once it is answered."""
        if can_id not in self._told:
            return
        node_id, asked = self._device.od.node_id, self._asked
        frame = Frame(can_id, data)
        if can_id == HEARTBEAT_ID + node_id and data == BOOT_UP:
            self._ask_again(self._types)
        elif request := written(frame, node_id):
            entry = self._at.get(request.address)
            if entry is not None and request.data != bytes((EVENT_MANUFACTURER,)):
                asked.add(entry)
        elif asked:
            ended = [entry for entry in asked if takes(frame, node_id, entry)]
            asked.difference_update(ended)
            self._ask_again(ended)

    def _take(self, entry: Entry) -> int:
        kind = int(self._device.read(entry))
        self._device.write(entry, EVENT_MANUFACTURER)
        # A recording that was killed, or one that another bench makes, has left it so.
        return int(entry.default) if kind == EVENT_MANUFACTURER else kind

    def _release(self) -> None:
        self._users -= 1
        if not self._users:
            network = self._network
            network.taps = tuple(tap for tap in network.taps if tap != self._keep)
            for entry, kind in zip(self._types, self._before, strict=True):
                self._device.write(entry, kind)

    def _ask_again(self, entries: Iterable[Entry]) -> None:
        """Write the types without waiting for an answer: who hears this is the one who receives."""
        for entry in entries:
            frame = download(self._device.od.node_id, entry, EVENT_MANUFACTURER)
            # Of a bus that has failed the bench hears by its next transfer.
            with suppress(can.CanError):
                self._network.send_message(frame.can_id, frame.data)
