"""Frames as bytes of a socket, for the interfaces of python-can that use one.

python-can opens and configures the socket. Reading and writing the bytes here, without a message
object for each frame, takes a third of the time and never waits.

Any program on this computer may send any datagram to a group of udp_multicast. So everything of
this package that listens there, node or bench, uses the decoder of `MulticastBus`, and not
python-can's own. That one makes an array of as many bytes as the field ``data`` says if the field
is an integer, and keeps what its sender calls its channel.
"""

from __future__ import annotations

import logging
import os
import socket
from collections import deque
from errno import EAGAIN, ENOBUFS
from secrets import token_hex
from select import select
from struct import Struct
from typing import Any, Final, Protocol

import can
from can import CanProtocol
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.udp_multicast import UdpMulticastBus

from smarttac_can.canopen.bus.bus import BusError, QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.od import cia
from smarttac_can.host.kernel_filter import drop

try:
    import msgpack
except ImportError:  # python-can reports this when such a bus is opened
    msgpack = None

_log: Final = logging.getLogger(__name__)
_MOST_BYTES: Final = 4096
_MOST_FRAMES: Final = 64
"""Most frames read per call: about half a millisecond."""
_MOST_SKIPPED: Final = 1000
"""Most malformed datagrams skipped per call: about 5 ms."""
_FD_BYTES: Final = 64
_FIELDS: Final = {
    "arbitration_id": int,
    "is_extended_id": bool,
    "is_remote_frame": bool,
    "is_error_frame": bool,
    "dlc": int,
    "data": bytes,
    "is_fd": bool,
    "bitrate_switch": bool,
    "error_state_indicator": bool,
}
"""Fields of a message of udp_multicast that are used, with their types."""
_NOW: Final[int] = getattr(socket, "MSG_DONTWAIT", 0)
QUEUE_FULL: Final = (ENOBUFS, EAGAIN)
"""Error numbers of a transmit queue that takes no frame for now."""


class Codec(Protocol):
    """Format in which an interface writes frames."""

    @property
    def mark(self) -> bytes:
        """Bytes that identify the echo of a frame, as for `drop`; empty if there are no echoes."""

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes of a frame."""

    def decode(self, data: bytes) -> Frame | None:
        """Return the frame; None if the bytes are not a frame, or an echo."""


class SocketCan:
    """``struct can_frame`` of Linux; the kernel sends no echo.

    Attributes
    ----------
    size
        Bytes per frame.
    mark
        Empty, because there are no echoes.
    """

    _STRUCT: Final = Struct("=IB3x8s")
    _REMOTE: Final = 1 << 30
    size: Final = _STRUCT.size
    mark: Final = b""

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes of a frame."""
        can_id, data, rtr = frame
        return self._STRUCT.pack(can_id | self._REMOTE if rtr else can_id, len(data), data)

    def decode(self, data: bytes) -> Frame | None:
        """Return the frame; None if the bytes are not a classical frame of 11 bits."""
        if len(data) != self.size:
            return None
        can_id, size, payload = self._STRUCT.unpack(data)
        if can_id <= cia.CAN_ID_MASK:
            return Frame(can_id, payload[:size])
        # Extended and error frames have a higher bit set.
        can_id &= ~self._REMOTE
        return Frame(can_id, b"", True) if can_id <= cia.CAN_ID_MASK else None


class _Multicast:
    """The message of python-can's udp_multicast: a map in MessagePack.

    A multicast socket receives its own frames, and other parties on this machine have the same
    address. So an echo is recognised by the channel field.

    Apart from the time stamp, the bytes before the data of a frame depend only on its identifier,
    length and sender. They are encoded once, and decoded once.
    """

    _BEGIN: Final = b"\x8b\xa9timestamp\xcb"
    _TIME_BYTES: Final = 8
    _TAIL: Final = b"\xa5is_fd\xc2\xaebitrate_switch\xc2\xb5error_state_indicator\xc2"
    _AFTER_TIME: Final = len(_BEGIN) + _TIME_BYTES
    _MOST_HEADS: Final = 4096

    def __init__(self) -> None:
        self._channel = token_hex(8)
        self.mark: Final = self._channel.encode()
        self._heads: dict[tuple[int, bool, int], bytes] = {}
        self._known: dict[bytes, int] = {}
        self.malformed = 0

    def encode(self, frame: Frame) -> bytes:
        can_id, data, rtr = frame
        key = can_id, rtr, len(data)
        head = self._heads.get(key)
        if head is None:
            head = self._heads[key] = self._packed(frame).removesuffix(data + self._TAIL)
        return head + data + self._TAIL

    def _packed(self, frame: Frame) -> bytes:
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

    def decode(self, data: bytes) -> Frame | None:
        if data.startswith(self._BEGIN) and data.endswith(self._TAIL):
            end = len(data) - len(self._TAIL)
            # Frames of the loop have 8 bytes in a cycle, and SYNC has none.
            for begin in (end - cia.FRAME_BYTES, end):
                can_id = self._known.get(data[self._AFTER_TIME : begin])
                if can_id is not None:
                    return Frame(can_id, data[begin:end])
        if self.mark in data:
            return None
        frame = self._unpacked(data)
        if frame is not None and not frame.rtr:
            self._remember(frame, data)
        return frame

    def _remember(self, frame: Frame, data: bytes) -> None:
        """Store the bytes before the data, if they have the layout of python-can."""
        suffix = frame.data + self._TAIL
        if data.startswith(self._BEGIN) and data.endswith(suffix):
            if len(self._known) >= self._MOST_HEADS:
                self._known.clear()
            self._known[data[self._AFTER_TIME : -len(suffix)]] = frame.can_id

    def _unpacked(self, data: bytes) -> Frame | None:
        message = self.message(data)
        return None if message is None else to_frame(message)

    def message(self, data: bytes, timestamp: float = 0.0) -> can.Message | None:
        """Return a datagram as a message of any kind; None, and count it, if it is malformed."""
        try:
            # Nothing in a message is an array or an extension, and a short one can announce a lot.
            said = msgpack.unpackb(data, max_bin_len=_FD_BYTES, max_array_len=0, max_ext_len=0)
            fields: dict[str, Any] = {name: said[name] for name in _FIELDS}
            if all(type(value) is _FIELDS[name] for name, value in fields.items()):
                return can.Message(timestamp, check=True, **fields)
        except (ValueError, TypeError, KeyError):
            pass
        self.malformed += 1
        return None


class MulticastBus(UdpMulticastBus):
    """python-can's bus over udp_multicast, with a decoder that nobody in the group can upset.

    A malformed datagram is skipped and counted. When the bus is closed, their number is logged.

    Attributes
    ----------
    group
        Group to which frames are sent.
    codec
        Decoder, which counts what is malformed.
    """

    def __init__(self, channel: str = UdpMulticastBus.DEFAULT_GROUP_IPv6, **options: Any) -> None:
        self.group: Final = channel
        self.codec: Final = _Multicast()
        super().__init__(channel, **options)

    def shutdown(self) -> None:
        """Close the bus."""
        super().shutdown()
        if count := self.codec.malformed:
            self.codec.malformed = 0
            _log.warning(
                "skipped %d datagrams to %s that are no CAN frames: another program sends to this "
                "group; choose another group (channel) if it goes on",
                count,
                self.group,
            )

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        takes_fd = self.protocol is CanProtocol.CAN_FD
        for _ in range(_MOST_SKIPPED):
            came = self._multicast.recv(timeout)
            if came is None:
                break
            data, _address, timestamp = came
            message = self.codec.message(data, timestamp)
            if message is not None and (takes_fd or not message.is_fd):
                return message, False
            timeout = 0.0
        return None, False


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


class CanSocket:
    """The socket of a bus of python-can, read and written as bytes.

    Parameters
    ----------
    bus
        Bus with its own descriptor of the same socket; its owner closes it.
    codec
        Format of the frames.
    group
        Group to which frames are sent, at the port of the socket; None for a connected socket.
    """

    def __init__(self, bus: can.BusABC, codec: Codec, group: str | None) -> None:
        self._bus = bus
        self._socket = socket.socket(fileno=os.dup(bus.fileno()))
        self._codec = codec
        self._address = None if group is None else (group, self._socket.getsockname()[1])
        if codec.mark:
            drop(bus, (), codec.mark)

    def send(self, frame: Frame) -> None:
        """Write a frame to the socket, as `Bus.send`."""
        try:
            if self._address is None:
                self._socket.send(self._codec.encode(frame), _NOW)
            else:
                self._socket.sendto(self._codec.encode(frame), _NOW, self._address)
        except OSError as error:
            kind = QueueFullError if error.errno in QUEUE_FULL else BusError
            raise kind(f"cannot send frame {frame.can_id:03X}: {error}") from error

    def wait(self, timeout: float) -> bool:
        """Wait until there is something to read, as `Bus.wait`."""
        try:
            # Not epoll or poll, which round up to milliseconds.
            return bool(select((self._socket,), (), (), timeout)[0])
        except (OSError, ValueError) as error:
            raise BusError(f"cannot receive: {error}") from error

    def read(self, frames: deque[Frame]) -> bool:
        """Read waiting frames, as `Bus.read`."""
        receive, decode = self._socket.recv, self._codec.decode
        try:
            for _ in range(_MOST_FRAMES):
                frame = decode(receive(_MOST_BYTES, _NOW))
                if frame is not None:
                    frames.append(frame)
        except BlockingIOError:
            return False
        except OSError as error:
            raise BusError(f"cannot receive: {error}") from error
        return True

    def block(self, can_ids: frozenset[int]) -> None:
        """Make the kernel drop frames with these identifiers."""
        drop(self._bus, can_ids, self._codec.mark)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def open_socket(bus: can.BusABC) -> CanSocket | None:
    """Return the socket of a bus; None if the bus works only through python-can."""
    if not _NOW:  # Windows
        return None
    if isinstance(bus, SocketcanBus):
        return CanSocket(bus, SocketCan(), None)
    if isinstance(bus, MulticastBus):
        return CanSocket(bus, bus.codec, bus.group)
    return None
