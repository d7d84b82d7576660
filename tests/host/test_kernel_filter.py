"""What passes the kernel: told by python-can's own party, on the interfaces that there are."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import can
import msgpack
import pytest
from can.interfaces.socketcan import SocketcanBus
from interrupts import interrupted
from nodes_on_a_bus import GUARD_S

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host import kernel_filter
from smarttac_can.host.can_socket import open_socket
from smarttac_can.host.kernel_filter import drop, enlarge_buffer, receive_only
from smarttac_can.host.python_can import open_bus

WIDTHS = (0x000, 0x001, 0x07F, 0x080, 0x0CC, 0x0CD, 0x0FF, 0x100, 0x7CC, 0x7FF)
"""Identifiers at the ends of what MessagePack writes in one, two and three bytes."""
LAST = can.Message(arbitration_id=0x12345678, is_extended_id=True)
"""Passes any filter, and is the last."""


def passed(receiver: can.BusABC) -> list[int]:
    heard = []
    while True:
        message = receiver.recv(GUARD_S)
        assert message is not None
        if message.is_extended_id:
            return heard
        heard.append(message.arbitration_id)


@pytest.mark.skipif(sys.platform != "linux", reason="the filter is one of Linux")
@pytest.mark.parametrize("own", [None, b"", b"16 bytes, a mark"])
@pytest.mark.parametrize("chosen", [(), (0x080,), WIDTHS, WIDTHS[::2], tuple(range(0x100, 0x1C8))])
def test_kernel_filter_drops_unwanted_and_blocked_identifiers(
    multicast: dict[str, Any], chosen: tuple[int, ...], own: bytes | None
) -> None:
    sent = sorted({*WIDTHS, 0x100, 0x1C7, 0x1C8})
    with can.Bus(**multicast) as sender, can.Bus(**multicast) as receiver:
        if own is None:
            receive_only(receiver, chosen)
        else:
            drop(receiver, chosen, own)
        for can_id in sent:
            sender.send(can.Message(arbitration_id=can_id, is_extended_id=False))
        sender.send(LAST)
        assert passed(receiver) == [
            can_id for can_id in sent if (can_id in chosen) == (own is None)
        ]


def test_kernel_filter_takes_the_last_choice_of_bounded_size(
    multicast: dict[str, Any],
) -> None:
    with can.Bus(**multicast) as sender, can.Bus(**multicast) as receiver:
        for wanted in ({0x101}, {0x102}, set(range(0x200, 0x300))):
            receive_only(receiver, wanted)
            for can_id in (0x101, 0x102, 0x200):
                sender.send(can.Message(arbitration_id=can_id, is_extended_id=False))
            sender.send(LAST)
            heard = passed(receiver)
            assert heard == ([0x101, 0x102, 0x200] if len(wanted) > 200 else sorted(wanted))


REVERSED = {
    "arbitration_id": 0x123, "timestamp": 0.0, "is_extended_id": False,
    "is_remote_frame": False, "is_error_frame": False, "channel": None, "dlc": 0, "data": b"",
    "is_fd": False, "bitrate_switch": False, "error_state_indicator": False,
}  # fmt: skip
SHORT = {
    "timestamp": 0.0, "arbitration_id": 0x123, "is_extended_id": False, "data": b"",
    "is_remote_frame": False,
}  # fmt: skip


@pytest.mark.parametrize(
    ("frame", "choose"),
    [
        (REVERSED, lambda bus: receive_only(bus, {0x080})),
        (SHORT, lambda bus: drop(bus, (), b"16 bytes, a mark")),
    ],
    ids=["written otherwise", "too short for an echo"],
)
def test_kernel_filter_passes_datagrams_of_another_layout(
    frame: dict[str, object], choose: Callable[[can.BusABC], None], multicast: dict[str, Any]
) -> None:
    with can.Bus(**multicast) as sender, can.Bus(**multicast) as receiver:
        choose(receiver)
        with socket.socket(type=socket.SOCK_DGRAM) as foreign:
            foreign.sendto(msgpack.packb(frame), (multicast["channel"], multicast["port"]))
        sender.send(LAST)
        assert passed(receiver) == [0x123]


@pytest.mark.skipif(sys.platform != "linux", reason="the filter is one of Linux")
@pytest.mark.parametrize("rtr", [False, True])
@pytest.mark.parametrize("blocked", [None, (), (0x123,), range(0x200, 0x2C8)])
def test_kernel_filter_drops_own_echoes_not_equal_foreign_frames(
    multicast: dict[str, Any], blocked: Iterable[int] | None, rtr: bool
) -> None:
    with open_bus(multicast) as mine, open_bus(multicast) as other:
        sockets = [open_socket(bus) for bus in (mine, other)]
        me, another = (party for party in sockets if party is not None)
        with closing(me), closing(another):
            if blocked is not None:  # else the filter is the one that open_socket has set
                drop(mine, blocked, me._codec.mark)
            for can_id in WIDTHS:
                me.send(Frame(can_id, b"", rtr))
                another.send(Frame(can_id, b"", rtr))
                other.send(can.Message(arbitration_id=can_id, is_extended_id=False))
            other.send(LAST)
            assert passed(mine) == [can_id for can_id in WIDTHS for _ in range(2)]


class KernelFilters(SocketcanBus):
    """A SocketCAN bus without its socket, which may not exist here."""

    def __init__(self) -> None:
        self.asked: list[list[dict[str, object]] | None] = []
        self._is_shutdown = True

    def set_filters(self, filters: list[dict[str, object]] | None) -> None:
        self.asked.append(filters)


def test_on_socketcan_it_is_the_filter_of_the_interface() -> None:
    bus = KernelFilters()
    for number in (200, 201, 0):
        receive_only(bus, frozenset(range(number)))
    few, *others = bus.asked
    assert [entry["can_id"] for entry in few or []] == list(range(200))
    assert others == [None, []]


def test_elsewhere_nothing_happens() -> None:
    with can.Bus("toy", "virtual") as bus, can.Bus("toy", "virtual") as other:
        receive_only(bus, {1})
        drop(bus, {2})
        enlarge_buffer(bus)
        other.send(can.Message(arbitration_id=2, is_extended_id=False))
        assert bus.recv(GUARD_S) is not None


@pytest.mark.skipif(sys.platform != "linux", reason="the buffer is one of Linux")
def test_the_kernel_holds_more(multicast: dict[str, Any]) -> None:
    def room(bus: can.BusABC) -> int:
        with socket.socket(fileno=os.dup(bus.fileno())) as same:
            return same.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    with can.Bus(**multicast) as bus:
        before = room(bus)
        enlarge_buffer(bus)
        assert room(bus) > before


@pytest.mark.skipif(sys.platform != "linux", reason="the filter is one of Linux")
def test_an_interrupt_at_any_instruction_leaves_no_socket(multicast: dict[str, Any]) -> None:
    def opened() -> list[str]:
        return sorted(file.name for file in Path("/proc/self/fd").iterdir())

    def ended(instruction: int) -> bool:
        try:
            with interrupted(instruction, kernel_filter, socket):
                receive_only(bus, (0x101,))
                enlarge_buffer(bus)
        except KeyboardInterrupt:
            return False
        return True

    instruction = 0
    with can.Bus(**multicast) as bus:
        before = opened()
        while not ended(instruction):
            assert opened() == before, instruction
            instruction += 1
    assert instruction > 100
