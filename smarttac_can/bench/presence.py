"""The bench's heartbeat, which the stimulator watches: if the bench is killed, the plate stops."""

from __future__ import annotations

import threading
from typing import Final

import can
import canopen

from smarttac_can.bench.remote_device import RemoteDevice
from smarttac_can.od.cia import HEARTBEAT_CONSUMER, HEARTBEAT_ID
from smarttac_can.od.dictionary import Entry

BENCH_ID: Final = 127
"""Node-ID of the bench's heartbeat."""
_PERIOD_S: Final = 0.1
_LOST_MS: Final = 1000
_OPERATIONAL: Final = b"\x05"
_WATCH: Final = BENCH_ID << 16 | _LOST_MS


class Presence:
    """Heartbeat of a bench that works in real time, from now until `end`.

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
        self._entry = self._free_entry()
        self._over = threading.Event()
        # A task of python-can would do, but it cannot be waited for when it ends.
        self._thread = threading.Thread(target=self._beat, name="bench heartbeat", daemon=True)
        if self._entry is not None:
            stimulator.write(self._entry, _WATCH)
        self._thread.start()

    def end(self, at_rest: bool) -> None:
        """Have the watch ended if the stimulator is at rest, then the heartbeat.

        One that still drives, or does not say, stops by the heartbeat that it misses.
        """
        try:
            if self._entry is not None and at_rest:
                self._stimulator.write(self._entry, 0)
        finally:
            self._over.set()
            self._thread.join()

    def _beat(self) -> None:
        try:
            while True:
                self._network.send_message(HEARTBEAT_ID + BENCH_ID, _OPERATIONAL)
                if self._over.wait(_PERIOD_S):
                    return
        except can.CanError:
            # A bus that has failed stops the plate, and the bench finds out by its next transfer.
            return

    def _free_entry(self) -> Entry | None:
        device = self._stimulator
        entries = device.od.objects[HEARTBEAT_CONSUMER].entries
        values = {subindex: device.read(entries[subindex]) for subindex in entries if subindex}
        # A bench that was killed has left its own behind.
        for wanted in (BENCH_ID, 0):
            for subindex, value in values.items():
                if value >> 16 & 0x7F == wanted:
                    return entries[subindex]
        return None
