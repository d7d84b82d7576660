"""python-canopen's network with ears: who listens hears its own frames, too, in their order."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any, Final, Self

import can
import canopen

from smarttac_can.bench.link import Hear
from smarttac_can.host.bus_options import configured, kept_here
from smarttac_can.host.drivers import opening
from smarttac_can.host.python_can import is_stray
from smarttac_can.master.errors import BenchError
from smarttac_can.od.cia import CAN_ID_MASK

Tap = tuple[Container[int], Hear]
"""Identifiers, and what is called with the frames that have one of them."""
ALL: Final = range(CAN_ID_MASK + 1)
"""All identifiers."""


class _Strays(can.Listener):
    """Has python-can's thread that receives go on after what is no message."""

    def __init__(self, network: canopen.Network) -> None:
        self._network = network
        self.last: Exception | None = None

    def on_message_received(self, msg: can.Message) -> None:
        """Do nothing: python-can asks for it."""

    def on_error(self, exc: Exception) -> None:
        """Note what is no message and go on; anything else python-can has to handle.

        Raises
        ------
        NotImplementedError
            If the bus has failed: python-can takes this for "not handled" and ends the thread.
        """
        if not is_stray(self._network.bus, exc):
            raise NotImplementedError
        self.last = exc


class TappedNetwork(canopen.Network):  # type: ignore[misc]  # python-canopen is untyped
    """A network whose data frames, sent and received, are told to its taps.

    Attributes
    ----------
    taps
        Called before who subscribes to a frame, in the thread that sends or receives.
    own_taps
        These are told of sent frames alone.
    hears_itself
        Whether its bus was told to echo what is sent, by an option or python-can's configuration.
    """

    def __init__(self) -> None:
        super().__init__()
        self._strays = _Strays(self)
        self.listeners.append(self._strays)
        self.taps: tuple[Tap, ...] = ()
        self.own_taps: tuple[Tap, ...] = ()
        self._options: Mapping[str, Any] = {}
        self.hears_itself = False

    def connect(self, **options: Any) -> Self:
        """Connect to a bus of python-can, by its options."""
        self._options = kept_here(options)
        self.hears_itself = bool(configured(options).get("receive_own_messages"))
        super().connect(**self._options)
        return self

    def second_bus(self) -> can.BusABC:
        """Open the same bus again; the caller closes it.

        Raises
        ------
        BenchError
            If it cannot be opened twice.
        """
        options = {**self._options, "can_filters": None}
        with opening(options.get("interface"), options.get("channel"), BenchError):
            return can.Bus(**options)

    def check(self) -> None:
        """Raise what has ended the receiving, if anything has."""
        error = None if self.notifier is None else self.notifier.exception
        if error is None or error is self._strays.last or is_stray(self.bus, error):
            return
        super().check()

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame."""
        if not remote:
            for can_ids, hear in (*self.taps, *self.own_taps):
                if can_id in can_ids:
                    hear(can_id, bytes(data))
        super().send_message(can_id, data, remote)

    def notify(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Take a received frame."""
        for can_ids, hear in self.taps:
            if can_id in can_ids:
                hear(can_id, bytes(data))
        super().notify(can_id, data, timestamp)
