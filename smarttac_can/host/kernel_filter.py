"""Which frames the kernel drops before they cost anything, and how many it keeps."""

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

from smarttac_can.od.cia import CAN_ID_MASK

_ID_KEY: Final = b"\xaearbitration_id"
"""Key of the identifier in a frame of udp_multicast, a map in MessagePack."""
_ID_AT: Final = 20
"""Its place after a time stamp of 8 bytes, as python-can writes it."""
_UINT8, _UINT16, _PLAIN_END = 0xCC, 0xCD, 0x80
"""What MessagePack puts before an integer of one byte, and of two; one below the last is plain."""
_ID_BYTES: Final = 3
"""Bytes of an identifier of 11 bits, at most."""
_CHANNEL_AT: Final = 58
"""Place of the text of the channel after the identifier: four keys, and three truth values."""

_MOST_IDS: Final = 200
"""A jump in such a program goes no farther than 255 instructions."""
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
_OF_11_BITS: Final = _EXTENDED | CAN_ID_MASK


def hear_only(bus: can.BusABC, can_ids: Iterable[int]) -> None:
    """Make the kernel drop frames with other identifiers on their way to a bus of python-can.

    What comes before the process has changed its mind is lost. Of udp_multicast frames in another
    layout than python-can's pass. All pass on other interfaces, and where the system cannot: the
    caller looks as well.

    Parameters
    ----------
    can_ids
        Identifiers of 11 bits that are heard; more than 200 stand for all.
    """
    heard = sorted(can_ids)
    if isinstance(bus, SocketcanBus):
        filters: can.typechecking.CanFilters = [
            {"can_id": can_id, "can_mask": CAN_ID_MASK, "extended": False} for can_id in heard
        ]
        bus.set_filters(filters if len(heard) <= _MOST_IDS else None)
    elif _has_programs(bus):
        _attach(bus, _program(heard, kept=True) if len(heard) <= _MOST_IDS else [_ACCEPT])


def drop(bus: can.BusABC, can_ids: Iterable[int], own: bytes = b"") -> None:
    """Make the kernel drop frames with these identifiers, and let all others in.

    Parameters
    ----------
    can_ids
        Identifiers of 11 bits, of which 200 count.
    own
        What the channel of the party's own frames begins with on udp_multicast, of whole words of 4
        bytes: these echoes are dropped, too. Empty for none; SocketCAN has none.
    """
    dropped = sorted(can_ids)[:_MOST_IDS]
    if isinstance(bus, SocketcanBus):
        # A frame has to pass all: of 11 bits, and not this one, and not this one.
        rows = [(0, _EXTENDED), *[(can_id | _INVERTED, _OF_11_BITS) for can_id in dropped]]
        _set_option(bus, _CAN_RAW, _CAN_RAW_JOIN_FILTERS, struct.pack("=i", 1))
        filters_ = b"".join(struct.pack("=II", *row) for row in rows)
        _set_option(bus, _CAN_RAW, _CAN_RAW_FILTER, filters_)
    elif _has_programs(bus):
        _attach(bus, _program(dropped, kept=False, own=own))


def _has_programs(bus: can.BusABC) -> bool:
    return isinstance(bus, UdpMulticastBus) and sys.platform == "linux"


def hold_more(bus: can.BusABC) -> None:
    """Make the kernel keep as many frames for a bus of python-can as it allows.

    What a process does not take in time, as on a machine that is busy, is lost beyond that; the
    default keeps some 70 ms of a loop on udp_multicast. Privileged processes may have more.
    """
    if isinstance(bus, SocketcanBus | UdpMulticastBus) and sys.platform == "linux":
        for option in (socket.SO_RCVBUF, _SO_RCVBUFFORCE):
            _set_option(bus, socket.SOL_SOCKET, option, struct.pack("@i", _MOST_HELD))


def _program(can_ids: list[int], *, kept: bool, own: bytes = b"") -> list[_Row]:
    """Compare the identifier in a frame: rows of code, jump if true, jump if false, constant."""
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
    """Compare the channel, the index being the width of the identifier; drop or jump past them."""
    words = struct.unpack(f">{len(own) // 4}I", own)
    past = 3 + 2 * len(words)
    rows = [
        # A load beyond the end would drop the frame.
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
    """Set an option of the bus's socket where the system can.

    It is set by the descriptor. A second socket object of it would stay open if a signal came
    between its constructor and the block that closes it.
    """
    ctypes.CDLL(None).setsockopt(bus.fileno(), level, option, value, len(value))
