"""The bench's heartbeat, which the stimulator watches: if the bench is killed, the plate stops."""

from __future__ import annotations

import threading
from typing import Final

import can
import canopen

from smarttac_can.bench.remote_device import RemoteDevice
from smarttac_can.device.nmt import NMTState
from smarttac_can.master.errors import BenchError, BusLostError
from smarttac_can.od.cia import HEARTBEAT_CONSUMER, HEARTBEAT_ID, LAST_NODE_ID
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import Control

_IDS: Final = 16
_PERIOD_S: Final = 0.1
_LISTEN_MS: Final = 250
"""Two heartbeats of another bench, and some delay."""
_LOST_MS: Final = 1000
_OPERATIONAL: Final = bytes((NMTState.OPERATIONAL,))


def bench_id(stimulator_id: int) -> int:
    """Return the node-ID, 112..127, of the heartbeat of the bench that drives a stimulator.

    Stimulators on one bus have benches of their own, so each watches another node-ID.
    """
    return LAST_NODE_ID - stimulator_id % _IDS


def drives(name: str, raw: int) -> bool:
    """Tell whether a write leads to a voltage; a quick stop does not: any bench may ask for it."""
    if name == "Controlword":
        return bool(raw & (Control.ARM | Control.FAULT_RESET))
    return name == "Mode" and raw != Mode.OFF


class BenchHeartbeat:
    """Heartbeat of a bench that drives in real time, from `begin` until `end`.

    A bench that only reads has none: nobody has to miss it, and its heartbeat would stand for that
    of a driver that was killed.

    Parameters
    ----------
    network
        Connected network of python-canopen.
    stimulator
        It watches the heartbeat by the first free entry of 1016h; by none if they are all taken,
        as a bus has a master of its own then.
    """

    def __init__(self, network: canopen.Network, stimulator: RemoteDevice) -> None:
        self._network = network
        self._stimulator = stimulator
        self._id = bench_id(stimulator.od.node_id)
        self._watch = self._id << 16 | _LOST_MS
        self._over = threading.Event()
        # A task of python-can would do, but it cannot be waited for when it ends.
        self._thread = threading.Thread(target=self._beat, name="bench heartbeat", daemon=True)

    @property
    def begun(self) -> bool:
        """Whether this bench drives."""
        return self._thread.ident is not None

    def begin(self) -> None:
        """Have this bench watched; a watch that the stimulator lost by a reset is set up anew.

        Raises
        ------
        BenchError
            If another bench drives this stimulator, or the bus has failed.
        """
        watches = self._watches()
        own = [entry for entry, value in watches.items() if value >> 16 & 0x7F == self._id]
        if not self.begun and self._another_beats([watches[entry] & 0xFFFF for entry in own]):
            raise BenchError(
                f"another bench script drives node {self._stimulator.od.node_id}: "
                f"node {self._id}, its heartbeat, is on the bus; end that script first"
            )
        free = [entry for entry, value in watches.items() if value == 0]
        anew = not self.begun
        for entry in (own + free)[:1]:
            if watches[entry] != self._watch:
                self._stimulator.write(entry, self._watch)
                anew = True
        if anew:
            # The first one is on the bus before the bench goes on: it is watched from there, and a
            # fault that a killed bench has left behind is over.
            try:
                self._send()
            except can.CanError as error:
                raise BusLostError(f"cannot be watched: the bus has failed: {error}") from error
        if not self.begun:
            self._thread.start()

    def end(self, at_rest: bool) -> None:
        """Have the watch ended if the stimulator is at rest, then the heartbeat.

        One that still drives, or does not say, stops by the heartbeat that it misses.
        """
        try:
            if at_rest:
                for entry, value in self._watches().items():
                    if value == self._watch:
                        self._stimulator.write(entry, 0)
        finally:
            self._over.set()
            self._thread.join()

    def _beat(self) -> None:
        try:
            while not self._over.wait(_PERIOD_S):
                self._send()
        except can.CanError:
            # A bus that has failed stops the plate, and the bench finds out by its next transfer.
            return

    def _send(self) -> None:
        self._network.send_message(HEARTBEAT_ID + self._id, _OPERATIONAL)

    def _watches(self) -> dict[Entry, int]:
        device = self._stimulator
        entries = device.od.objects[HEARTBEAT_CONSUMER].entries
        return {
            entries[subindex]: device.read(entries[subindex]) for subindex in entries if subindex
        }

    def _another_beats(self, watched_ms: list[int]) -> bool:
        """Listen for as long as the stimulator would wait for the next heartbeat."""
        heard = threading.Event()

        def hear(_can_id: int, _data: bytearray, _timestamp: float) -> None:
            heard.set()

        self._network.subscribe(HEARTBEAT_ID + self._id, hear)
        try:
            return heard.wait(max([_LISTEN_MS, *watched_ms]) * 1e-3)
        finally:
            self._network.unsubscribe(HEARTBEAT_ID + self._id, hear)
