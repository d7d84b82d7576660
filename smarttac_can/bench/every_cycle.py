"""TPDOs of a stimulator that are sent in every cycle for as long as somebody records.

Several benches may need it at once, and only the last of them may put the types back: until another
one asks anew, the cycles are lost. Who ends therefore asks whether anybody else needs them. The
question is the SDO request that reads a type, the answer one that writes 254 to it again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from threading import Event
from typing import Final

import can

from smarttac_can.bench.remote_device import RemoteDevice
from smarttac_can.bench.tapped_network import TappedNetwork
from smarttac_can.device.frame import Frame
from smarttac_can.master.errors import BenchError
from smarttac_can.master.requests import asked, download, takes, written
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

_ANSWERED_S: Final = 0.25
"""By then another bench has answered; who asks has heard that there may be one."""
_EVERY_CYCLE: Final = bytes((EVENT_MANUFACTURER,))


class EveryCycle:
    """Has TPDOs sent in every cycle, and puts their types back when no bench needs it any more.

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
        self._undone: set[Entry] = set()
        services = (HEARTBEAT_ID, SDO_RX_ID, SDO_TX_ID)
        self._tap = ({service + device.od.node_id for service in services}, self._keep)
        self._before: list[int] = []
        self._users = 0
        self._ends = False
        self._others = Event()

    @contextmanager
    def held(self) -> Iterator[None]:
        """Have them sent in every cycle; blocks may be nested.

        They are sent so again at once when a reset, or a tool that does not ask, puts them back.
        """
        if not self._users:
            self._ends = False
            self._others.clear()
            self._before = [self._take(entry) for entry in self._types]
            self._undone.clear()
            self._network.taps += (self._tap,)
        self._users += 1
        try:
            yield
        except BaseException:
            # The first failure is the one to report.
            with suppress(BenchError):
                self._release()
            raise
        self._release()

    def _take(self, entry: Entry) -> int:
        kind = int(self._device.read(entry))
        self._device.write(entry, EVENT_MANUFACTURER)
        if kind != EVENT_MANUFACTURER:
            return kind
        # Another bench needs it, or one that was killed has left it so.
        self._others.set()
        return int(entry.default)

    def _release(self) -> None:
        self._users -= 1
        if self._users:
            return
        try:
            needed = self._others_need_it()
        finally:
            network = self._network
            network.taps = tuple(tap for tap in network.taps if tap is not self._tap)
        if not needed:
            for entry, kind in zip(self._types, self._before, strict=True):
                self._device.write(entry, kind)

    def _others_need_it(self) -> bool:
        """Ask the benches that there may be besides this one."""
        self._ends = True
        if not self._others.is_set():
            return False
        self._others.clear()
        self._device.read(self._types[0])
        return self._others.wait(_ANSWERED_S)

    def _keep(self, can_id: int, data: bytes) -> None:
        """Hear what others ask for, answer, and ask again for what they have undone."""
        node_id, undone = self._device.od.node_id, self._undone
        frame = Frame(can_id, data)
        if can_id == HEARTBEAT_ID + node_id and data == BOOT_UP:
            self._ask_for(self._types)
        elif request := written(frame, node_id):
            entry = self._at.get(request.address)
            if entry is not None and request.data == _EVERY_CYCLE:
                self._others.set()
            elif entry is not None:
                undone.add(entry)
        elif entry := self._at.get(asked(frame, node_id) or (0, 0)):
            self._ask_for([entry])
        elif undone:
            ended = [entry for entry in undone if takes(frame, node_id, entry)]
            undone.difference_update(ended)
            self._ask_for(ended)

    def _ask_for(self, entries: Iterable[Entry]) -> None:
        """Write the types without waiting for an answer: who hears this is the one who receives."""
        if self._ends:
            return
        for entry in entries:
            frame = download(self._device.od.node_id, entry, EVENT_MANUFACTURER)
            # Of a bus that has failed the bench hears by its next transfer.
            with suppress(can.CanError):
                self._network.send_message(frame.can_id, frame.data)
