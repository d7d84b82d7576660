"""A bus over any interface of python-can: socketcan, pcan, udp_multicast, virtual and so on."""

from __future__ import annotations

import errno
from time import monotonic, sleep, time_ns
from typing import Any

import can
from can.interfaces.udp_multicast import UdpMulticastBus

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import BusError, LogHook, QueueFullError

_SEND_TRIES = 100
_QUEUE_FULL = (errno.ENOBUFS, errno.EAGAIN)
_SEND_PAUSE_S = 0.001


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


class PythonCanBus:
    """One party's connection to a bus of python-can.

    Parameters
    ----------
    interface, channel, bitrate
        As python-can has them. What is not given comes from python-can's configuration: the
        environment (``CAN_INTERFACE``, ...) or its files (``~/.canrc``, ``can.ini``, ...).
    log
        Called with the time since the epoch in us and the frame, for every frame sent or received.
    options
        Anything else the interface takes, e.g. ``port=`` for udp_multicast.

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
        *,
        log: LogHook | None = None,
        **options: Any,
    ) -> None:
        if bitrate is not None:
            options["bitrate"] = bitrate
        try:
            self._bus = can.Bus(channel=channel, interface=interface, **options)
        except Exception as error:  # drivers raise what they like, down to NameError
            if interface is None:
                asked = "bus of python-can's configuration (no interface was given)"
            else:
                asked = f"{interface} bus, channel {channel or 'configured'}"
            raise BusError(f"cannot open the {asked}: {error}") from error
        self._log = log
        # A multicast socket hears itself, and its address is that of every other party on this
        # machine: the channel field, which travels in the datagram there, tells the echo.
        self._mark = f"{id(self):x}-{time_ns():x}" if self._hears_itself() else None

    def send(self, frame: Frame) -> None:
        """Send a frame; while the transmit queue is full try again for 0.1 s at least.

        Raises
        ------
        QueueFullError
            If the queue is still full.
        BusError
            If the bus takes no frame for another reason.
        """
        message = to_message(frame)
        message.channel = self._mark
        for _ in range(_SEND_TRIES):
            try:
                self._bus.send(message)
            except (can.CanError, OSError) as error:
                reason = error
                sleep(_SEND_PAUSE_S)
            else:
                if self._log is not None:
                    self._log(time_ns() // 1000, frame)
                return
        kind = QueueFullError if _is_queue_full(reason) else BusError
        raise kind(f"cannot send frame {frame.can_id:03X}: {reason}") from reason

    def receive(self, timeout: float) -> Frame | None:
        """Return the next classical 11-bit frame of another party.

        Parameters
        ----------
        timeout
            Longest wait in s; 0 takes what is there.

        Returns
        -------
        Frame or None
            None if no frame came in time.

        Raises
        ------
        BusError
            If the bus has failed.
        """
        end = monotonic() + timeout
        while True:
            try:
                message = self._bus.recv(timeout)
            except (can.CanError, OSError) as error:
                raise BusError(f"cannot receive: {error}") from error
            if message is None:
                return None
            frame = to_frame(message)
            if frame is not None and (self._mark is None or message.channel != self._mark):
                if self._log is not None:
                    self._log(time_ns() // 1000, frame)
                return frame
            timeout = max(0.0, end - monotonic())

    def close(self) -> None:
        """Leave the bus and free its sockets and handles; may be called twice.

        Raises
        ------
        BusError
            If the driver fails at it.
        """
        try:
            self._bus.shutdown()
        except (can.CanError, OSError) as error:
            raise BusError(f"cannot leave the bus: {error}") from error

    def _hears_itself(self) -> bool:
        return isinstance(self._bus, UdpMulticastBus)


def _is_queue_full(reason: can.CanError | OSError) -> bool:
    number = reason.error_code if isinstance(reason, can.CanError) else reason.errno
    return number in _QUEUE_FULL
