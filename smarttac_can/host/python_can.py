"""A bus over any interface of python-can: socketcan, pcan, udp_multicast, virtual and so on."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from time import monotonic
from typing import Any, Final, cast

import can
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.virtual import VirtualBus
from can.util import load_config

from smarttac_can.canopen.bus.bus import BusError, QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.can_socket import (
    QUEUE_FULL,
    MulticastBus,
    open_socket,
    to_frame,
    to_message,
)
from smarttac_can.host.drivers import opening

_THIS_COMPUTER: Final = 0
"""Hop limit of IP; 1 would be the local network of the computer."""
_OF_CONFIGURATION: Final = ("interface", "config_context", "context", "ignore_config")
"""Options by which `can.Bus` finds a class and its options."""


def configured(options: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the options that `can.Bus` uses: with its configuration files, and texts parsed."""
    if options.get("ignore_config"):
        return options
    # Interface and channel come from the configuration if they are not given.
    left = [key for key in ("interface", "channel") if options.get(key) is None]
    given = {key: value for key, value in options.items() if key not in left}
    context = options.get("config_context", options.get("context"))  # former name
    return cast("Mapping[str, Any]", load_config(config=given, context=context))


def open_bus(options: Mapping[str, Any]) -> can.BusABC:
    """Open a bus of python-can, as `can.Bus` does with these options.

    Of udp_multicast it is a `MulticastBus`, and frames stay on this computer unless ``hop_limit``
    is an option or in python-can's configuration. By default python-can sends them into the local
    network, to all users of the same group.
    """
    known = configured(options)
    if known.get("interface") != "udp_multicast":
        return can.Bus(**options)
    own = {key: value for key, value in known.items() if key not in _OF_CONFIGURATION}
    if own.get("channel") is None:
        own.pop("channel", None)
    return MulticastBus(**{"hop_limit": _THIS_COMPUTER, **own})


_REFUSING_S = 0.1
"""Time in s for which a driver may refuse frames without a reason before the bus is lost."""
_READING_S = 0.001


def hears_others_of_process(bus: can.BusABC) -> bool:
    """Return whether another handle on this bus, also of this process, receives sent frames."""
    return isinstance(bus, SocketcanBus | UdpMulticastBus | VirtualBus)


class PythonCanBus:
    """A connection to a bus of python-can.

    Parameters
    ----------
    interface, channel, bitrate
        Arguments of python-can; what is omitted comes from python-can's configuration: the
        environment (``CAN_INTERFACE``, ...) or its files (``~/.canrc``, ``can.ini``, ...).
    options
        Other options of the interface, e.g. ``port=`` for udp_multicast, whose frames stay on
        this computer unless ``hop_limit=`` is given or configured.

    Attributes
    ----------
    send, wait, read, block
        Methods of a `Bus`. For socketcan and udp_multicast they use the socket and `send` never
        waits. For other interfaces the driver decides.

    Raises
    ------
    BusError
        If there is no such interface or channel, or it cannot be opened.
    """

    def __init__(
        self,
        interface: str | None = None,
        channel: str | None = None,
        bitrate: int | None = None,
        **options: Any,
    ) -> None:
        if bitrate is not None:
            options["bitrate"] = bitrate
        with opening(interface, channel, BusError):
            self._bus = open_bus({"interface": interface, "channel": channel, **options})
        self._socket = open_socket(self._bus)
        wire = self._socket or _Driver(self._bus)
        self.send = wire.send
        self.wait = wire.wait
        self.read = wire.read
        self.block = wire.block
        self._came: deque[Frame] = deque()

    def receive(self, timeout: float) -> Frame | None:
        """Return the next frame of another party, None if none came within `timeout` s.

        Raises
        ------
        BusError
            If the bus has failed.
        """
        end = monotonic() + timeout
        while not self._came:
            more = self.read(self._came)
            left = end - monotonic()
            if not self._came and left <= 0.0:
                return None
            if not self._came and not more:
                self.wait(left)
        return self._came.popleft()

    def close(self) -> None:
        """Leave the bus and free its sockets and handles; may be called twice.

        Raises
        ------
        BusError
            If the driver fails to close.
        """
        if self._socket is not None:
            self._socket.close()
        try:
            self._bus.shutdown()
        except (can.CanError, OSError) as error:
            raise BusError(f"cannot leave the bus: {error}") from error


class _Driver:
    """A bus that is used through its driver."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._first: can.Message | None = None
        """Message received by `wait`."""
        self._refusing_since: float | None = None

    def send(self, frame: Frame) -> None:
        try:
            self._bus.send(to_message(frame))
        except (can.CanError, OSError) as error:
            kind = QueueFullError if self._is_queue_full(error) else BusError
            raise kind(f"cannot send frame {frame.can_id:03X}: {error}") from error
        self._refusing_since = None

    def wait(self, timeout: float) -> bool:
        if self._first is None:
            self._first = self._receive(timeout)
        return self._first is not None

    def read(self, frames: deque[Frame]) -> bool:
        end = monotonic() + _READING_S
        while True:
            message, self._first = self._first or self._receive(0.0), None
            if message is None:
                return False
            frame = to_frame(message)
            if frame is not None:
                frames.append(frame)
            if monotonic() >= end:
                return True

    def block(self, can_ids: frozenset[int]) -> None:
        """Do nothing: filtering in a driver costs as much as ignoring the frames."""

    def _receive(self, timeout: float) -> can.Message | None:
        try:
            return self._bus.recv(timeout)
        except (can.CanError, OSError) as error:
            raise BusError(f"cannot receive: {error}") from error

    def _is_queue_full(self, reason: can.CanError | OSError) -> bool:
        number = reason.error_code if isinstance(reason, can.CanError) else reason.errno
        if number in QUEUE_FULL:
            return True
        now = monotonic()
        if self._refusing_since is None:
            self._refusing_since = now
        return now - self._refusing_since < _REFUSING_S
