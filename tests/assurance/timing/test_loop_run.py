"""The listener that takes part in nothing: its figures, and how it ends."""

import os
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from typing import Any

import can
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus
from nodes_on_a_bus import GUARD_S

from smarttac_can.assurance.timing.loop_run import listening, node_process, require_free
from smarttac_can.bench.simulation import plate_od
from smarttac_can.canopen.bus.bus import BusError
from smarttac_can.canopen.device.frame import Frame

SO_TIMESTAMPNS = 35
"""Of Linux; Python has no name for it before 3.14."""
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="time stamps of Linux")


@contextmanager
def stamping() -> Iterator[None]:
    """Have Linux stamp frames: it begins some time after a socket has asked for it."""
    with socket.socket(type=socket.SOCK_DGRAM) as asks:
        asks.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        asks.bind(("127.0.0.1", 0))
        guard = time.monotonic() + GUARD_S
        while True:
            asks.sendto(b"", asks.getsockname())
            sent = time.time()
            time.sleep(0.01)
            _, ((_, _, stamp), *_), _, _ = asks.recvmsg(1, socket.CMSG_SPACE(16))
            seconds, nanoseconds = struct.unpack("qq", stamp)
            # A frame that came before has the time at which it is read.
            if seconds + nanoseconds * 1e-9 < sent + 0.005:
                break
            assert time.monotonic() < guard
        yield


@contextmanager
def flooding(send: Callable[[], object], pause: float = 0.0) -> Iterator[None]:
    """Send again and again until the block ends, so many s apart."""
    over = threading.Event()

    def flood() -> None:
        while not over.wait(pause):
            send()

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.fixture
def send_no_message(multicast: dict[str, Any]) -> Iterator[Callable[[], object]]:
    """Send bytes that are no CAN message to the group of the bus."""
    group = (multicast["channel"], multicast["port"])
    with socket.socket(type=socket.SOCK_DGRAM) as foreign:
        yield lambda: foreign.sendto(b"no message" * 10, group)


@pytest.mark.usefixtures("without_privileges")
def test_listener_says_when_priority_is_not_granted(
    multicast: dict[str, Any],
) -> None:
    with node_process(["plate"], multicast, 50) as plate:
        ordinary = os.sched_getscheduler(plate.pid) == os.SCHED_OTHER
        assert any("SCHED_FIFO 50 is refused" in line for line in plate.refused) == ordinary


def message(can_id: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=can_id, is_extended_id=False, data=data)


def test_listener_feeds_all_frames_of_the_block_with_their_time(
    multicast: dict[str, Any],
) -> None:
    heard: list[tuple[float, Frame]] = []
    with can.Bus(**multicast) as sender, stamping():
        begin = time.time()
        with listening(multicast, {0x181}, lambda stamp, frame: heard.append((stamp, frame))):
            for number in range(200):
                sender.send(message(0x181, bytes((number,))))
                sender.send(message(0x182))
        end = time.time()
        sender.send(message(0x181))
    assert [frame for _, frame in heard] == [Frame(0x181, bytes((n,))) for n in range(200)]
    stamps = [stamp for stamp, _ in heard]
    assert begin <= stamps[0] and stamps == sorted(stamps) and stamps[-1] <= end


def test_it_does_not_wake_up_for_each_frame(multicast: dict[str, Any]) -> None:
    fed: list[float] = []
    guard = time.monotonic() + GUARD_S
    sent = pauses = 0
    with can.Bus(**multicast) as sender, listening(
        multicast, {0x181}, lambda _stamp, _frame: fed.append(time.monotonic())
    ):  # fmt: skip
        # However rarely a busy machine lets it fetch, it pauses, and then fetches several.
        while pauses < 10:
            assert time.monotonic() < guard
            sender.send(message(0x181))
            sent += 1
            time.sleep(0.0005)
            pauses = sum(later - earlier > 0.003 for earlier, later in pairwise(fed[:]))
    assert len(fed) == sent > 2 * pauses


@pytest.mark.parametrize("messages", [True, False])
def test_it_ends_while_something_comes_without_end(
    messages: bool, multicast: dict[str, Any], send_no_message: Callable[[], object]
) -> None:
    with can.Bus(**multicast) as sender:
        send = partial(sender.send, message(0x181)) if messages else send_no_message
        with flooding(send):
            with listening(multicast, {0x181}, lambda _stamp, _frame: time.sleep(0.0002)):
                time.sleep(0.2)
                left = time.monotonic()
            assert time.monotonic() - left < GUARD_S


def test_listener_ignores_datagrams_without_a_frame(
    multicast: dict[str, Any], send_no_message: Callable[[], object]
) -> None:
    heard: list[Frame] = []
    with (
        can.Bus(**multicast) as sender,
        stamping(),
        listening(multicast, {0x181}, lambda _stamp, frame: heard.append(frame)),
    ):
        for number in range(3):
            send_no_message()
            sender.send(message(0x181, bytes((number,))))
    assert heard == [Frame(0x181, bytes((number,))) for number in range(3)]


@pytest.mark.parametrize("failure", [OSError(5, "it broke"), can.CanTimeoutError("it broke")])
def test_a_bus_that_fails_is_told_behind_the_block(
    multicast: dict[str, Any], monkeypatch: pytest.MonkeyPatch, failure: Exception
) -> None:
    def fail(_bus: can.BusABC, _timeout: float) -> None:
        raise failure

    monkeypatch.setattr(UdpMulticastBus, "recv", fail)
    with (
        pytest.raises(BusError, match=r"the loop was timed until its bus failed: .*it broke"),
        listening(multicast, {0x181}, lambda _stamp, _frame: None),
    ):
        pass


def test_listener_counts_no_cycle_for_datagrams_without_a_frame(
    multicast: dict[str, Any], send_no_message: Callable[[], object]
) -> None:
    with flooding(send_no_message, 0.002):
        require_free(multicast, plate_od())
