"""Frames as bytes of a socket, for the interfaces of python-can that are one.

python-can opens and sets up the socket. Reading and writing it here, without a message object for
each frame, takes a third of the time, and does not wait.
"""

from __future__ import annotations

import os
import socket
from errno import EBADF
from secrets import token_hex
from select import select
from struct import Struct
from time import monotonic
from typing import Final, Protocol

import can
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.udp_multicast import UdpMulticastBus

from smarttac_can.device.frame import Frame
from smarttac_can.host.kernel_filter import (
    ID_AT,
    ID_BYTES,
    ID_KEY,
    PLAIN_END,
    UINT8,
    UINT16,
    hear_only,
)
from smarttac_can.od.cia import CAN_ID_MASK, FRAME_BYTES

try:
    import msgpack
except ImportError:  # python-can says so itself when such a bus is opened
    msgpack = None

_MOST_BYTES: Final = 4096
_FLOOD: Final = 100
_FLOOD_S: Final = 0.01
"""So many frames that are passed over in less than this time are a flood: a bus of 1 Mbit/s carries
nine of 8 bytes in a millisecond."""
_CLOSED_S: Final = 1.0
"""For how long the kernel drops them then."""
_NOW: Final[int] = getattr(socket, "MSG_DONTWAIT", 0)


class Codec(Protocol):
    """How an interface writes frames."""

    @property
    def mark(self) -> bytes:
        """What tells the echo of a frame, as `hear_only` has it; empty where there is none."""

    def encode(self, frame: Frame) -> bytes:
        """Return what is sent for a frame."""

    def decode(self, data: bytes, can_ids: frozenset[int] | None) -> Frame | None:
        """Return the frame; None for what is none, an echo, or not listened to (None: all is)."""


class SocketCan:
    """``struct can_frame`` of Linux; the kernel sends no echo.

    Attributes
    ----------
    size
        Of a frame in bytes.
    mark
        Empty, for there are no echoes.
    """

    _STRUCT: Final = Struct("=IB3x8s")
    _REMOTE: Final = 1 << 30
    size: Final = _STRUCT.size
    mark: Final = b""

    def encode(self, frame: Frame) -> bytes:
        """Return what is sent for a frame."""
        can_id, data, rtr = frame
        return self._STRUCT.pack(can_id | self._REMOTE if rtr else can_id, len(data), data)

    def decode(self, data: bytes, can_ids: frozenset[int] | None) -> Frame | None:
        """Return the frame; None for what is none, or not listened to."""
        if len(data) != self.size:
            return None
        can_id, size, payload = self._STRUCT.unpack(data)
        rtr = bool(can_id & self._REMOTE)
        can_id &= ~self._REMOTE
        # Extended and error frames have a higher bit set.
        if can_id > CAN_ID_MASK or (can_ids is not None and can_id not in can_ids):
            return None
        return Frame(can_id, b"" if rtr else payload[:size], rtr)


class _Multicast:
    """The message of python-can's udp_multicast: a map in MessagePack.

    A multicast socket hears itself, and its address is that of every other party on this machine:
    the channel field tells the echo.
    """

    _ID_VALUE: Final = ID_AT + len(ID_KEY)

    def __init__(self) -> None:
        self._channel = token_hex(8)
        self.mark: Final = self._channel.encode()

    def encode(self, frame: Frame) -> bytes:
        can_id, data, rtr = frame
        return bytes(
            msgpack.packb(
                {
                    "timestamp": 0.0,
                    "arbitration_id": can_id,
                    "is_extended_id": False,
                    "is_remote_frame": rtr,
                    "is_error_frame": False,
                    "channel": self._channel,
                    "dlc": len(data),
                    "data": data,
                    "is_fd": False,
                    "bitrate_switch": False,
                    "error_state_indicator": False,
                }
            )
        )

    def decode(self, data: bytes, can_ids: frozenset[int] | None) -> Frame | None:
        if self.mark in data or (can_ids is not None and self._foreign(data, can_ids)):
            return None
        try:
            message = msgpack.unpackb(data)
            can_id, rtr = message["arbitration_id"], bool(message["is_remote_frame"])
            other = message["is_extended_id"] or message["is_error_frame"] or message["is_fd"]
            payload = b"" if message["data"] is None else message["data"]
        except (ValueError, TypeError, KeyError):
            return None  # anybody may send anything to the group
        sound = type(can_id) is int and 0 <= can_id <= CAN_ID_MASK
        # A number would be made that many bytes.
        sound = sound and type(payload) is bytes and len(payload) <= FRAME_BYTES
        if other or not sound or (can_ids is not None and can_id not in can_ids):
            return None
        return Frame(can_id, b"" if rtr else payload, rtr)

    def _foreign(self, data: bytes, can_ids: frozenset[int]) -> bool:
        """Tell whether the identifier can be read at its place, and is not listened to."""
        value = data[self._ID_VALUE : self._ID_VALUE + ID_BYTES]
        if data[ID_AT : self._ID_VALUE] != ID_KEY or len(value) < ID_BYTES:
            return False
        if value[0] == UINT16:
            return int.from_bytes(value[1:], "big") not in can_ids
        if value[0] == UINT8:
            return value[1] not in can_ids
        return value[0] < PLAIN_END and value[0] not in can_ids


class CanSocket:
    """The socket of a bus of python-can, read and written as bytes.

    Parameters
    ----------
    bus
        Keeps its own descriptor of the same socket, and is closed by its owner.
    codec
        How it writes frames.
    group
        Where a frame is sent to, at the port that the socket hears; None for a socket that knows.
    """

    def __init__(self, bus: can.BusABC, codec: Codec, group: str | None) -> None:
        self._bus = bus
        self._socket = socket.socket(fileno=os.dup(bus.fileno()))
        self._codec = codec
        self._can_ids: frozenset[int] | None = None
        self._passed = 0
        self._first_passed = 0.0
        self._closed_until: float | None = None
        if codec.mark:
            hear_only(bus, None, codec.mark)
        self._address = None if group is None else (group, self._socket.getsockname()[1])

    def send(self, frame: Frame) -> None:
        """Write a frame to the socket, without waiting.

        Raises
        ------
        OSError
            ENOBUFS or EAGAIN for a full queue, others if the interface has failed.
        """
        data = self._codec.encode(frame)
        if self._address is None:
            self._socket.send(data, _NOW)
        else:
            self._socket.sendto(data, _NOW, self._address)

    def wait(self, timeout: float) -> bool:
        """Tell whether there is something to read, waiting so many s at most.

        Raises
        ------
        OSError
            If it is closed.
        """
        if self._closed_until is not None and monotonic() >= self._closed_until:
            self._closed_until = None
            hear_only(self._bus, None, self._codec.mark)
        try:
            # epoll and poll round up to milliseconds.
            return bool(select((self._socket,), (), (), timeout)[0])
        except ValueError as error:
            raise OSError(EBADF, os.strerror(EBADF)) from error

    def listen_to(self, can_ids: frozenset[int]) -> None:
        """Pass over frames with other identifiers; in a flood of them the kernel drops them."""
        self._can_ids = can_ids
        if self._closed_until is not None:
            hear_only(self._bus, can_ids, self._codec.mark)

    def read(self, *, every: bool = False) -> tuple[bool, Frame | None]:
        """Take what is there: whether there was anything, and the frame if it is one to hear.

        Parameters
        ----------
        every
            Whether every frame is.
        """
        try:
            data = self._socket.recv(_MOST_BYTES, _NOW)
        except BlockingIOError:
            return False, None
        frame = self._codec.decode(data, None if every else self._can_ids)
        if frame is None:
            self._note_passed()
        return True, frame

    def _note_passed(self) -> None:
        """Count what was passed over; have the kernel drop the like if it is a flood."""
        if not self._passed:
            self._first_passed = monotonic()
        self._passed += 1
        if self._passed < _FLOOD:
            return
        self._passed = 0
        now = monotonic()
        if now - self._first_passed < _FLOOD_S and self._can_ids is not None:
            if self._closed_until is None:
                hear_only(self._bus, self._can_ids, self._codec.mark)
            self._closed_until = now + _CLOSED_S

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def open_socket(bus: can.BusABC, channel: str | None) -> CanSocket | None:
    """Return the socket of a bus, None where python-can alone knows how to use it.

    Parameters
    ----------
    channel
        As the bus was opened with, by an option or python-can's configuration; None without.
    """
    if not _NOW:  # Windows
        return None
    if isinstance(bus, SocketcanBus):
        return CanSocket(bus, SocketCan(), None)
    if isinstance(bus, UdpMulticastBus):
        return CanSocket(bus, _Multicast(), channel or bus.DEFAULT_GROUP_IPv6)
    return None
