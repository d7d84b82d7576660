"""SocketCAN as the wire of a local bus: every party has a socket of its own."""

from __future__ import annotations

import errno
import os
import select
import socket
from typing import Self

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import BusError
from smarttac_can.host.can_socket import SocketCan
from smarttac_can.host.drivers import opening
from smarttac_can.host.local_bus import Connection

_GUARD_S = 1.0


class SocketCanWire:
    """Carries the frames of a `LocalBus` over an interface of SocketCAN, such as vcan0.

    The kernel hands each frame to all sockets before the next one is sent, so a run has the same
    bits as without it. The sockets are used directly: python-can needs six times as long for a
    frame where system calls are slow.

    Parameters
    ----------
    channel
        Name of the interface, which has to be up.

    Raises
    ------
    BusError
        On entry, if there is no such interface; later, if it takes or brings no frame, or one that
        somebody else sent.
    """

    def __init__(self, channel: str) -> None:
        self._channel = channel
        self._codec = SocketCan()
        self._sockets: dict[Connection, socket.socket] = {}
        self._sent = b""
        self._frame = Frame(0)

    def __enter__(self) -> Self:
        self._open().close()
        return self

    def __exit__(self, *_: object) -> None:
        for party in self._sockets.values():
            party.close()
        self._sockets.clear()

    def connect(self, port: Connection) -> None:
        """Open a socket for a party.

        Raises
        ------
        BusError
            If the interface cannot be opened.
        """
        self._sockets[port] = self._open()

    def disconnect(self, port: Connection) -> None:
        """Close the socket of a party."""
        self._sockets.pop(port).close()

    def put(self, port: Connection, frame: Frame) -> None:
        """Send a frame over the interface.

        Raises
        ------
        BusError
            If the interface does not take it.
        """
        self._sent = self._codec.encode(frame)
        self._frame = frame
        try:
            self._sockets[port].send(self._sent)
        except OSError as error:
            raise BusError(f"cannot send on {self._channel}: {error}") from error

    def get(self, port: Connection) -> Frame:
        """Receive the frame that was put last, as it came over the interface.

        Raises
        ------
        BusError
            If it does not come, or another frame does.
        """
        party = self._sockets[port]
        try:
            data = party.recv(self._codec.size)
        except BlockingIOError:
            if not select.select([party], [], [], _GUARD_S)[0]:
                raise BusError(f"{self._channel} has lost {self._frame}") from None
            data = party.recv(self._codec.size)
        except OSError as error:
            raise BusError(f"cannot receive on {self._channel}: {error}") from error
        if data != self._sent:
            raise BusError(f"somebody else sends on {self._channel}, too")
        return self._frame

    def _open(self) -> socket.socket:
        with opening("socketcan", self._channel, BusError):
            if not hasattr(socket, "CAN_RAW"):
                raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))
            party = socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            try:
                party.bind((self._channel,))
            except OSError:
                party.close()
                raise
        party.setblocking(False)
        return party
