import errno
import socket
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nodes_on_a_bus import GUARD_S
from toy_node import SYNC

from smarttac_can.canopen.bus.bus import BusError, QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host import python_can
from smarttac_can.host.can_socket import to_frame, to_message
from smarttac_can.host.python_can import PythonCanBus

DATA_FRAMES = st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8), st.just(False))
REMOTE_FRAMES = st.builds(Frame, st.integers(0, 0x7FF), st.just(b""), st.just(True))


@pytest.fixture
def bus() -> Iterator[PythonCanBus]:
    opened = PythonCanBus("virtual", "toy")
    yield opened
    opened.close()
    opened.close()


@settings(max_examples=100)
@given(DATA_FRAMES | REMOTE_FRAMES)
def test_conversion_loses_nothing(frame: Frame) -> None:
    message = to_message(frame)
    message._check()
    back = to_frame(message)
    assert back == frame
    assert type(back.data) is bytes


@pytest.mark.parametrize(
    "foreign",
    [
        can.Message(arbitration_id=0x80, is_extended_id=True),
        can.Message(is_error_frame=True, is_extended_id=False),
        can.Message(arbitration_id=0x80, is_extended_id=False, is_fd=True),
    ],
)
def test_python_can_bus_ignores_extended_fd_and_error_frames(
    bus: PythonCanBus, foreign: can.Message
) -> None:
    with can.Bus("toy", "virtual") as other:
        other.send(foreign)
        assert bus.receive(0) is None
        other.send(foreign)
        other.send(to_message(SYNC))
        assert bus.receive(GUARD_S) == SYNC


class Driver:
    """A driver of python-can by script, and its clock."""

    def __init__(self, bus: PythonCanBus, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        self.error: Exception | None = None
        self.sent: list[can.Message] = []
        self.tries = 0
        self.inbox: list[tuple[float, Frame | can.Message]] = []
        """What comes, and how long it takes."""
        self.waits: list[float] = []
        monkeypatch.setattr(bus._bus, "send", self.send)
        monkeypatch.setattr(bus._bus, "recv", self.recv)
        monkeypatch.setattr(python_can, "monotonic", lambda: self.now)

    def send(self, message: can.Message) -> None:
        self.tries += 1
        if self.error is not None:
            raise self.error
        self.sent.append(message)

    def recv(self, timeout: float) -> can.Message | None:
        self.waits.append(timeout)
        if not self.inbox:
            self.now += timeout
            return None
        takes, frame = self.inbox.pop(0)
        self.now += takes
        return frame if isinstance(frame, can.Message) else to_message(frame)


@pytest.fixture
def driver(bus: PythonCanBus, monkeypatch: pytest.MonkeyPatch) -> Iterator[Driver]:
    with monkeypatch.context() as patch:
        yield Driver(bus, patch)


def test_a_driver_that_does_not_say_why_has_a_tenth_of_a_second(
    bus: PythonCanBus, driver: Driver
) -> None:
    for start in (0.0, 50.0):
        driver.error = can.CanOperationError("Transmit buffer full")
        for driver.now in (start, start + 0.05, start + 0.0999):
            with pytest.raises(QueueFullError, match="cannot send frame 080: Transmit buffer full"):
                bus.send(SYNC)
        driver.error = None
        bus.send(SYNC)
    assert len(driver.sent) == 2, "it took one meanwhile: the time begins anew"
    driver.error = can.CanOperationError("Transmit buffer full")
    driver.now = 60.0
    with pytest.raises(QueueFullError):
        bus.send(SYNC)
    driver.now = 60.1001
    with pytest.raises(BusError, match="cannot send frame 080: Transmit buffer full") as refusal:
        bus.send(SYNC)
    assert not isinstance(refusal.value, QueueFullError)


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.ENOBUFS, "No buffer space available"),
        can.CanOperationError("No buffer space available", errno.ENOBUFS),
        OSError(errno.EAGAIN, "Resource temporarily unavailable"),
        can.CanOperationError("Resource temporarily unavailable", errno.EAGAIN),
    ],
)
def test_a_full_queue_is_one_for_as_long_as_it_lasts(
    bus: PythonCanBus, driver: Driver, error: Exception
) -> None:
    driver.error = error
    for driver.now in (0.0, 0.2, 3600.0):
        with pytest.raises(QueueFullError, match="cannot send frame 080: "):
            bus.send(SYNC)
    assert driver.tries == 3, "it is tried once, and not waited for"
    assert driver.now == 3600.0


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (errno.ENOBUFS, QueueFullError),
        (errno.EAGAIN, QueueFullError),
        (errno.ENETDOWN, BusError),
        (errno.ENODEV, BusError),
        (errno.EIO, BusError),
    ],
)
def test_socket_tells_a_full_queue_from_a_lost_bus_at_once(
    multicast: dict[str, Any], monkeypatch: pytest.MonkeyPatch, number: int, kind: type[BusError]
) -> None:
    class Refusing:
        def sendto(self, *_: object) -> None:
            raise OSError(number, "refused")

        def close(self) -> None:
            """Do nothing."""

    connection = PythonCanBus(**multicast)
    assert connection._socket is not None
    with connection._socket._socket:
        monkeypatch.setattr(connection._socket, "_socket", Refusing())
    for _ in range(3):
        with pytest.raises(BusError, match=r"cannot send frame 080: .*refused") as refusal:
            connection.send(SYNC)
        assert type(refusal.value) is kind
    connection.close()
    connection.close()


@pytest.mark.parametrize("bus_of_sockets", [False, True])
def test_a_frame_that_comes_later_is_waited_for(
    bus_of_sockets: bool, virtual: dict[str, Any], multicast: dict[str, Any]
) -> None:
    options = multicast if bus_of_sockets else virtual
    mine, other = PythonCanBus(**options), PythonCanBus(**options)
    later = threading.Timer(0.05, other.send, [SYNC])
    later.start()
    heard = mine.receive(GUARD_S)
    later.join()
    mine.close()
    other.close()
    assert heard == SYNC


EXTENDED = can.Message(arbitration_id=2, is_extended_id=True)


def test_wait_ends_on_time_in_a_flood_of_ignored_frames(bus: PythonCanBus, driver: Driver) -> None:
    driver.inbox = [(0.0007, EXTENDED)] * 4000
    assert bus.receive(1.0) is None
    assert driver.now == pytest.approx(1.0, abs=0.003)
    assert all(wait >= 0.0 for wait in driver.waits)


def test_a_driver_is_read_for_a_millisecond_and_a_frame(bus: PythonCanBus, driver: Driver) -> None:
    driver.inbox = [(0.0003, Frame(at)) for at in range(6)]
    frames: deque[Frame] = deque()
    assert bus.read(frames)
    assert [frame.can_id for frame in frames] == [0, 1, 2, 3]
    assert not bus.read(frames)
    assert [frame.can_id for frame in frames] == [0, 1, 2, 3, 4, 5]
    assert set(driver.waits) == {0.0}, "nothing is waited for"


def test_malformed_datagram_does_not_lose_the_bus(
    multicast: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(python_can, "open_socket", lambda *_: None)
    mine, other = PythonCanBus(**multicast), PythonCanBus(**multicast)
    with closing(mine), closing(other), socket.socket(type=socket.SOCK_DGRAM) as foreign:
        foreign.sendto(b"garbage", (multicast["channel"], multicast["port"]))
        other.send(Frame(1))
        assert mine.receive(GUARD_S) == Frame(1)


def test_wait_ends_with_a_frame_that_is_read(bus: PythonCanBus, driver: Driver) -> None:
    driver.inbox = [(0.2, SYNC), (0.0, Frame(1))]
    bus.wait(1.0)
    bus.wait(1.0)
    assert driver.now == 0.2
    frames: deque[Frame] = deque()
    assert not bus.read(frames)
    assert list(frames) == [SYNC, Frame(1)]


def test_failure_to_receive(bus: PythonCanBus, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(timeout: float) -> None:
        raise can.CanOperationError("Network is down")

    monkeypatch.setattr(bus._bus, "recv", fail)
    with pytest.raises(BusError, match=r"cannot receive: Network is down"):
        bus.receive(0)


@pytest.mark.parametrize("error", [OSError("no such device"), can.CanError("handle is gone")])
def test_a_driver_that_fails_to_close_is_an_error_of_the_bus(
    bus: PythonCanBus, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def fail() -> None:
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(bus._bus, "shutdown", fail)
        with pytest.raises(BusError, match=f"cannot leave the bus: {error}"):
            bus.close()
