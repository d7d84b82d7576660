"""Which frames the kernel drops before they cost anything, and how many it holds."""

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

ID_KEY: Final = b"\xaearbitration_id"
"""Key of the identifier in a frame of udp_multicast, a map in MessagePack."""
ID_AT: Final = 20
"""Its place behind a time stamp of 8 bytes, as python-can writes it."""
UINT8, UINT16, PLAIN_END = 0xCC, 0xCD, 0x80
"""What MessagePack puts before an integer of one byte, and of two; one below the last is plain."""
ID_BYTES: Final = 3
"""Bytes of an identifier of 11 bits, at most."""
_CHANNEL_AT: Final = 58
"""Place of the text of the channel behind the identifier: four keys, and three truth values."""

_MOST_IDS: Final = 200
"""A jump in such a program goes no farther than 255 instructions."""
_SO_ATTACH_FILTER: Final = 26
_SO_RCVBUFFORCE: Final = 33
_MOST_HELD: Final = 8 << 20
_UDP_HEADER: Final = 8
_LOAD_WORD, _LOAD_HALF, _LOAD_BYTE, _LOAD_LENGTH = 0x20, 0x28, 0x30, 0x80
_INDEX, _LOAD_WORD_FROM_INDEX = 0x01, 0x40
_JUMP, _JUMP_IF_EQUAL, _JUMP_IF_NOT_BELOW, _RETURN = 0x05, 0x15, 0x35, 0x06
_ACCEPT: Final = (_RETURN, 0, 0, 0xFFFF)


def hear_only(bus: can.BusABC, can_ids: Iterable[int] | None, own: bytes = b"") -> None:
    """Have the kernel drop frames with other identifiers on their way to a bus of python-can.

    What comes before the process has changed its mind is lost. Of udp_multicast frames in another
    layout than python-can's pass. All pass on other interfaces, and where the system cannot: the
    caller looks as well.

    Parameters
    ----------
    can_ids
        Identifiers of 11 bits that are heard. None stands for all, as do more than 200.
    own
        What the channel of the party's own frames begins with on udp_multicast, of whole words of 4
        bytes: these echoes are dropped, too. Empty for none; SocketCAN has none.
    """
    wanted = None if can_ids is None else sorted(can_ids)
    if wanted is not None and len(wanted) > _MOST_IDS:
        wanted = None
    if isinstance(bus, SocketcanBus):
        filters: can.typechecking.CanFilters = [
            {"can_id": can_id, "can_mask": CAN_ID_MASK, "extended": False}
            for can_id in wanted or ()
        ]
        bus.set_filters(None if wanted is None else filters)
    elif isinstance(bus, UdpMulticastBus) and sys.platform == "linux":
        _attach(bus, _program(wanted, own))


def hold_more(bus: can.BusABC) -> None:
    """Have the kernel hold as many frames for a bus of python-can as it allows.

    What a process does not take in time, as on a machine that is busy, is lost beyond that; the
    default holds some 70 ms of a loop on udp_multicast. Privileged processes may have more.
    """
    if isinstance(bus, SocketcanBus | UdpMulticastBus) and sys.platform == "linux":
        for option in (socket.SO_RCVBUF, _SO_RCVBUFFORCE):
            _set_option(bus, option, struct.pack("@i", _MOST_HELD))


def _program(can_ids: list[int] | None, own: bytes) -> list[tuple[int, int, int, int]]:
    """Compare the identifier in a frame: rows of code, jump if true, jump if false, constant.

    None stands for any identifier.
    """
    value = _UDP_HEADER + ID_AT + len(ID_KEY)
    two_bytes, one_byte, compare = 8, 11, 13
    echo = compare if can_ids is None else compare + len(can_ids) + 1
    look = _is_own(value + _CHANNEL_AT, own) if own else []
    accept = echo + len(look)
    compared = [
        (_JUMP_IF_EQUAL, echo - at - 1, 0, can_id)
        for at, can_id in enumerate(can_ids or (), compare)
    ]
    if can_ids is not None:
        compared.append((_RETURN, 0, 0, 0))
    return [
        (_LOAD_WORD, 0, 0, _UDP_HEADER + ID_AT),
        (_JUMP_IF_EQUAL, 0, accept - 2, int.from_bytes(ID_KEY[:4], "big")),
        (_LOAD_BYTE, 0, 0, value),
        (_JUMP_IF_EQUAL, one_byte - 4, 0, UINT8),
        (_JUMP_IF_EQUAL, two_bytes - 5, 0, UINT16),
        (_JUMP_IF_NOT_BELOW, accept - 6, 0, PLAIN_END),
        (_INDEX, 0, 0, 1),
        (_JUMP, 0, 0, compare - 8),
        (_INDEX, 0, 0, 3),
        (_LOAD_HALF, 0, 0, value + 1),
        (_JUMP, 0, 0, compare - 11),
        (_INDEX, 0, 0, 2),
        (_LOAD_BYTE, 0, 0, value + 1),
        *compared,
        *look,
        _ACCEPT,
    ]


def _is_own(channel: int, own: bytes) -> list[tuple[int, int, int, int]]:
    """Compare the channel, the index being the width of the identifier; drop, or jump behind."""
    words = struct.unpack(f">{len(own) // 4}I", own)
    behind = 3 + 2 * len(words)
    rows = [
        # A load beyond the end would drop the frame.
        (_LOAD_LENGTH, 0, 0, 0),
        (_JUMP_IF_NOT_BELOW, 0, behind - 2, channel + ID_BYTES + len(own)),
    ]
    for number, word in enumerate(words):
        rows.append((_LOAD_WORD_FROM_INDEX, 0, 0, channel + 4 * number))
        rows.append((_JUMP_IF_EQUAL, 0, behind - len(rows) - 1, word))
    return [*rows, (_RETURN, 0, 0, 0)]


def _attach(bus: can.BusABC, program: list[tuple[int, int, int, int]]) -> None:
    code = b"".join(struct.pack("=HBBI", *row) for row in program)
    buffer = ctypes.create_string_buffer(code)
    _set_option(bus, _SO_ATTACH_FILTER, struct.pack("@HP", len(program), ctypes.addressof(buffer)))


def _set_option(bus: can.BusABC, option: int, value: bytes) -> None:
    """Set an option of the bus's socket where the system can.

    It is set by the descriptor. A second socket object of it would stay open if a signal came
    between its making and the block that closes it.
    """
    ctypes.CDLL(None).setsockopt(bus.fileno(), socket.SOL_SOCKET, option, value, len(value))
