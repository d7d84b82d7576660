"""Filters and buffers of the kernel: which frames it drops, and how many it keeps."""

from __future__ import annotations

import ctypes
import socket
import struct
import sys
from collections.abc import Iterable
from typing import Final

import can
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.udp_multicast import UdpMulticastBus

from smarttac_can.canopen.od import cia

_ID_KEY: Final = b"\xaearbitration_id"
"""Key of the identifier in a frame of udp_multicast, a map in MessagePack."""
_ID_AT: Final = 20
"""Offset of this key after a time stamp of 8 bytes, in the layout of python-can."""
_UINT8, _UINT16, _PLAIN_END = 0xCC, 0xCD, 0x80
"""MessagePack prefix of an integer of one byte, and of two; a byte below the third is the value."""
_ID_BYTES: Final = 3
"""Most bytes of an identifier of 11 bits."""
_CHANNEL_AT: Final = 58
"""Offset from the identifier to the text of the channel: four keys and three booleans."""

_MOST_IDS: Final = 200
"""Limited because a jump in such a program spans at most 255 instructions."""
_SO_ATTACH_FILTER: Final = 26
_SO_RCVBUFFORCE: Final = 33
_MOST_HELD: Final = 8 << 20
_UDP_HEADER: Final = 8
_LOAD_WORD, _LOAD_HALF, _LOAD_BYTE, _LOAD_LENGTH = 0x20, 0x28, 0x30, 0x80
_INDEX, _LOAD_WORD_FROM_INDEX = 0x01, 0x40
_JUMP, _JUMP_IF_EQUAL, _JUMP_IF_NOT_BELOW, _RETURN = 0x05, 0x15, 0x35, 0x06
_Row = tuple[int, int, int, int]
_ACCEPT: Final[_Row] = (_RETURN, 0, 0, 0xFFFF)
_DROP: Final[_Row] = (_RETURN, 0, 0, 0)
_CAN_RAW: Final = 101
_CAN_RAW_FILTER, _CAN_RAW_JOIN_FILTERS = 1, 6
_EXTENDED, _INVERTED = 1 << 31, 1 << 29
_OF_11_BITS: Final = _EXTENDED | cia.CAN_ID_MASK


def receive_only(bus: can.BusABC, can_ids: Iterable[int]) -> None:
    """Set the receive filter of the kernel, for a bus of python-can, to these identifiers.

    Frames dropped before a change of the identifiers are lost. All frames pass on interfaces
    other than SocketCAN and udp_multicast, on systems without such filters, and on udp_multicast
    in a layout other than python-can's. So the caller filters, too.

    Parameters
    ----------
    can_ids
        Identifiers of 11 bits to pass; if there are more than 200, all frames pass.
    """
    heard = sorted(can_ids)
    if isinstance(bus, SocketcanBus):
        filters: can.typechecking.CanFilters = [
            {"can_id": can_id, "can_mask": cia.CAN_ID_MASK, "extended": False} for can_id in heard
        ]
        bus.set_filters(filters if len(heard) <= _MOST_IDS else None)
    elif _has_programs(bus):
        _attach(bus, _program(heard, kept=True) if len(heard) <= _MOST_IDS else [_ACCEPT])


def drop(bus: can.BusABC, can_ids: Iterable[int], own: bytes = b"") -> None:
    """Let the kernel drop frames with these identifiers, and pass all others.

    Parameters
    ----------
    can_ids
        Identifiers of 11 bits to drop; only the first 200 are used.
    own
        First bytes of the channel in this party's own frames on udp_multicast, a multiple of 4
        bytes: these echoes are dropped as well. Empty for none; SocketCAN has no echoes.
    """
    dropped = sorted(can_ids)[:_MOST_IDS]
    if isinstance(bus, SocketcanBus):
        # A frame must pass all filters: 11 bits, and not this identifier, and not that one.
        rows = [(0, _EXTENDED), *[(can_id | _INVERTED, _OF_11_BITS) for can_id in dropped]]
        _set_option(bus, _CAN_RAW, _CAN_RAW_JOIN_FILTERS, struct.pack("=i", 1))
        filters_ = b"".join(struct.pack("=II", *row) for row in rows)
        _set_option(bus, _CAN_RAW, _CAN_RAW_FILTER, filters_)
    elif _has_programs(bus):
        _attach(bus, _program(dropped, kept=False, own=own))


def _has_programs(bus: can.BusABC) -> bool:
    return isinstance(bus, UdpMulticastBus) and sys.platform == "linux"


def enlarge_buffer(bus: can.BusABC) -> None:
    """Set the receive buffer of a bus of python-can to the largest size that the kernel allows.

    Frames beyond that are lost if a busy machine reads them too late. The default is enough for
    some 70 ms of a loop on udp_multicast. Privileged processes may keep more.
    """
    if isinstance(bus, SocketcanBus | UdpMulticastBus) and sys.platform == "linux":
        for option in (socket.SO_RCVBUF, _SO_RCVBUFFORCE):
            _set_option(bus, socket.SOL_SOCKET, option, struct.pack("@i", _MOST_HELD))


def _program(can_ids: list[int], *, kept: bool, own: bytes = b"") -> list[_Row]:
    """Return a program for the identifier: rows of code, jump if true, jump if false, constant."""
    value = _UDP_HEADER + _ID_AT + len(_ID_KEY)
    two_bytes, one_byte, compare = 8, 11, 13
    look = _is_own(value + _CHANNEL_AT, own) if own else []
    others = [] if not kept else [_DROP]
    accept = compare + len(can_ids) + len(others) + len(look)
    equal = accept - len(look) if kept else accept + 1
    compared = [
        (_JUMP_IF_EQUAL, equal - at - 1, 0, can_id) for at, can_id in enumerate(can_ids, compare)
    ]
    return [
        (_LOAD_WORD, 0, 0, _UDP_HEADER + _ID_AT),
        (_JUMP_IF_EQUAL, 0, accept - 2, int.from_bytes(_ID_KEY[:4], "big")),
        (_LOAD_BYTE, 0, 0, value),
        (_JUMP_IF_EQUAL, one_byte - 4, 0, _UINT8),
        (_JUMP_IF_EQUAL, two_bytes - 5, 0, _UINT16),
        (_JUMP_IF_NOT_BELOW, accept - 6, 0, _PLAIN_END),
        (_INDEX, 0, 0, 1),
        (_JUMP, 0, 0, compare - 8),
        (_INDEX, 0, 0, 3),
        (_LOAD_HALF, 0, 0, value + 1),
        (_JUMP, 0, 0, compare - 11),
        (_INDEX, 0, 0, 2),
        (_LOAD_BYTE, 0, 0, value + 1),
        *compared,
        *others,
        *look,
        _ACCEPT,
        _DROP,
    ]


def _is_own(channel: int, own: bytes) -> list[_Row]:
    """Return rows that drop own frames; the index register holds the width of the identifier."""
    words = struct.unpack(f">{len(own) // 4}I", own)
    past = 3 + 2 * len(words)
    rows = [
        # A load beyond the end would drop the frame, so check the length first.
        (_LOAD_LENGTH, 0, 0, 0),
        (_JUMP_IF_NOT_BELOW, 0, past - 2, channel + _ID_BYTES + len(own)),
    ]
    for number, word in enumerate(words):
        rows.append((_LOAD_WORD_FROM_INDEX, 0, 0, channel + 4 * number))
        rows.append((_JUMP_IF_EQUAL, 0, past - len(rows) - 1, word))
    return [*rows, _DROP]


def _attach(bus: can.BusABC, program: list[_Row]) -> None:
    code = b"".join(struct.pack("=HBBI", *row) for row in program)
    buffer = ctypes.create_string_buffer(code)
    _set_option(
        bus,
        socket.SOL_SOCKET,
        _SO_ATTACH_FILTER,
        struct.pack("@HP", len(program), ctypes.addressof(buffer)),
    )


def _set_option(bus: can.BusABC, level: int, option: int, value: bytes) -> None:
    """Set an option of the bus's socket if the system supports it.

    The descriptor is used directly. A second socket object would stay open if a signal came
    between its constructor and the block that closes it.
    """
    ctypes.CDLL(None).setsockopt(bus.fileno(), level, option, value, len(value))
