"""A bus over any interface of python-can: socketcan, pcan, udp_multicast, virtual and so on."""

from __future__ import annotations

import errno
from time import monotonic, time_ns
from typing import Any

import can
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.virtual import VirtualBus

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import BusError, LogHook, QueueFullError
from smarttac_can.host.bus_options import configured, kept_here
from smarttac_can.host.can_socket import open_socket
from smarttac_can.host.drivers import opening

_REFUSING_S = 0.1
"""How long a driver that does not say why may take no frame before its bus is lost."""
_STRAY_S = 0.1
_QUEUE_FULL = (errno.ENOBUFS, errno.EAGAIN)


def to_message(frame: Frame) -> can.Message:
    """Return a frame as python-can's message."""
    return can.Message(
        arbitration_id=frame.can_id,
        is_extended_id=False,
        is_remote_frame=frame.rtr,
        data=frame.data,
    )


def to_frame(message: can.Message) -> Frame | None:
    """Return python-can's message as a frame; None for an error, extended or CAN FD frame."""
    if message.is_error_frame or message.is_extended_id or message.is_fd:
        return None
    return Frame(message.arbitration_id, bytes(message.data), message.is_remote_frame)


def hears_others_of_process(bus: can.BusABC) -> bool:
    """Whether another handle on the same bus, in this process too, hears what this one sends."""
    return isinstance(bus, SocketcanBus | UdpMulticastBus | VirtualBus)


def is_stray(bus: can.BusABC, error: Exception) -> bool:
    """Whether a bus has received what is no message: anybody may send anything to a group."""
    if not isinstance(bus, UdpMulticastBus) or not isinstance(error, can.CanOperationError):
        return False
    # A bus that fails has an OSError for its cause, or none.
    return error.__cause__ is not None and not isinstance(error.__cause__, OSError)


def received(bus: can.BusABC, timeout: float) -> can.Message | None:
    """Return the next message of a bus, None if none came within so many s.

    What is no message is passed over, for 0.1 s longer at most: it may come without end.
    """
    end = monotonic() + timeout
    while True:
        try:
            return bus.recv(max(0.0, end - monotonic()))
        except can.CanOperationError as error:
            if not is_stray(bus, error):
                raise
            if monotonic() > end + _STRAY_S:
                return None


class PythonCanBus:
    """One party's connection to a bus of python-can.

    Parameters
    ----------
    interface, channel, bitrate
        As python-can has them. What is not given comes from python-can's configuration: the
        environment (``CAN_INTERFACE``, ...) or its files (``~/.canrc``, ``can.ini``, ...).
    log
        Called with the time since the epoch in us and the frame, for every frame sent or received;
        `listen_to` is then for nothing.
    options
        Anything else the interface takes, e.g. ``port=`` for udp_multicast, whose frames stay on
        this computer unless ``hop_limit=`` is given, or configured.

    Raises
    ------
    BusError
        If there is no such interface or channel, or it cannot be opened.

    Notes
    -----
    Of socketcan and udp_multicast the socket is used, which never waits. Other interfaces send by
    their driver, which decides.
    """

    def __init__(
        self,
        interface: str | None = None,
        channel: str | None = None,
        bitrate: int | None = None,
        *,
        log: LogHook | None = None,
        **options: Any,
    ) -> None:
        if bitrate is not None:
            options["bitrate"] = bitrate
        with opening(interface, channel, BusError):
            opened = kept_here({"interface": interface, "channel": channel, **options})
            self._bus = can.Bus(**opened)
        self._log = log
        self._can_ids: frozenset[int] | None = None
        self._refusing_since: float | None = None
        self._socket = open_socket(self._bus, configured(opened).get("channel"))

    def send(self, frame: Frame) -> None:
        """Hand a frame over.

        Raises
        ------
        QueueFullError
            If the transmit queue is full.
        BusError
            If the bus takes no frame for another reason.
        """
        try:
            if self._socket is not None:
                self._socket.send(frame)
            else:
                self._bus.send(to_message(frame))
        except (can.CanError, OSError) as error:
            kind = QueueFullError if self._is_queue_full(error) else BusError
            raise kind(f"cannot send frame {frame.can_id:03X}: {error}") from error
        self._refusing_since = None
        if self._log is not None:
            self._log(time_ns() // 1000, frame)

    def receive(
        self, timeout: float, patience: float = 0.0, *, every: bool = False
    ) -> Frame | None:
        """Return the next classical 11-bit frame of another party that is listened to.

        Parameters
        ----------
        timeout
            Longest wait in s; 0 takes what is there.
        patience
            How long, in s, it may take to pass over frames that are there and not listened to.
        every
            Whether a frame that is not listened to is returned, too.

        Returns
        -------
        Frame or None
            None if no such frame came in time.

        Raises
        ------
        BusError
            If the bus has failed.
        """
        end = monotonic() + timeout
        try:
            while True:
                there, frame = self._take(timeout, every)
                if frame is not None:
                    if self._log is not None:
                        self._log(time_ns() // 1000, frame)
                    return frame
                if not there:
                    return None
                timeout = end - monotonic()
                if timeout <= -patience:
                    return None
                timeout = max(0.0, timeout)
        except (can.CanError, OSError) as error:
            raise BusError(f"cannot receive: {error}") from error

    def listen_to(self, can_ids: frozenset[int]) -> None:
        """Pass over frames with other identifiers from now on; in a flood the kernel does."""
        if self._log is not None:
            return
        self._can_ids = can_ids
        if self._socket is not None:
            self._socket.listen_to(can_ids)

    def close(self) -> None:
        """Leave the bus and free its sockets and handles; may be called twice.

        Raises
        ------
        BusError
            If the driver fails at it.
        """
        if self._socket is not None:
            self._socket.close()
        try:
            self._bus.shutdown()
        except (can.CanError, OSError) as error:
            raise BusError(f"cannot leave the bus: {error}") from error

    def _take(self, timeout: float, every: bool) -> tuple[bool, Frame | None]:
        """Wait for a frame: whether one came, and what it is if it is one to return."""
        if self._socket is not None:
            if timeout > 0.0 and not self._socket.wait(timeout):
                return False, None
            return self._socket.read(every=every)
        message = self._bus.recv(timeout)
        if message is None:
            return False, None
        frame = to_frame(message)
        can_ids = None if every else self._can_ids
        heard = frame is not None and (can_ids is None or frame.can_id in can_ids)
        return True, frame if heard else None

    def _is_queue_full(self, reason: can.CanError | OSError) -> bool:
        number = reason.error_code if isinstance(reason, can.CanError) else reason.errno
        if number in _QUEUE_FULL:
            return True
        if self._socket is not None:
            return False
        now = monotonic()
        if self._refusing_since is None:
            self._refusing_since = now
        return now - self._refusing_since < _REFUSING_S
