from collections.abc import Iterator
from typing import Any

import can
import pytest
from conftest import GUARD_S
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_node import SYNC

from smarttac_can.device.frame import Frame
from smarttac_can.host import python_can
from smarttac_can.host.bus import BusError
from smarttac_can.host.lasting_bus import LastingBus
from smarttac_can.host.python_can import PythonCanBus, to_frame, to_message

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
def test_what_is_no_classical_base_frame_is_passed_over(
    bus: PythonCanBus, foreign: can.Message
) -> None:
    with can.Bus("toy", "virtual") as other:
        other.send(foreign)
        assert bus.receive(0) is None
        other.send(foreign)
        other.send(to_message(SYNC))
        assert bus.receive(GUARD_S) == SYNC


def test_receive_without_waiting(bus: PythonCanBus) -> None:
    assert bus.receive(0) is None


@pytest.mark.parametrize(
    ("interface", "channel", "says"),
    [
        ("carrier_pigeon", "coop", "carrier_pigeon bus, channel coop"),
        ("udp_multicast", "10.0.0.1", "udp_multicast bus, channel 10.0.0.1"),
        ("socketcan", "nosuchcan0", "socketcan bus, channel nosuchcan0"),
    ],
)
def test_bus_that_cannot_be_opened_is_one_clear_error(
    interface: str, channel: str, says: str
) -> None:
    with pytest.raises(BusError, match=f"cannot open the {says}: .") as refusal:
        PythonCanBus(interface, channel)
    assert "\n" not in str(refusal.value)


def test_what_is_not_given_comes_from_python_can(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    monkeypatch.setenv("CAN_CHANNEL", "from the environment")
    configured = PythonCanBus()
    named = PythonCanBus("virtual", "from the environment")
    configured.send(SYNC)
    assert named.receive(GUARD_S) == SYNC
    configured.close()
    named.close()


class JammedOnce:
    """A transmit path that is full for a number of tries."""

    def __init__(self, tries: int, error: Exception) -> None:
        self.tries = tries
        self.error = error
        self.sent: list[can.Message] = []

    def send(self, message: can.Message) -> None:
        if self.tries:
            self.tries -= 1
            raise self.error
        self.sent.append(message)


@pytest.mark.parametrize(
    "error",
    [can.CanOperationError("Transmit buffer full"), OSError(105, "No buffer space available")],
)
def test_full_transmit_queue_is_tried_again_for_a_while(
    bus: PythonCanBus, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    naps: list[float] = []
    monkeypatch.setattr(python_can, "sleep", naps.append)
    for_a_while = JammedOnce(50, error)
    monkeypatch.setattr(bus._bus, "send", for_a_while.send)
    bus.send(SYNC)
    assert [to_frame(message) for message in for_a_while.sent] == [SYNC]
    for_good = JammedOnce(10**9, error)
    monkeypatch.setattr(bus._bus, "send", for_good.send)
    del naps[:]
    with pytest.raises(BusError, match="cannot send frame 080: "):
        bus.send(SYNC)
    assert sum(naps) == pytest.approx(0.1)


def test_failure_to_receive(bus: PythonCanBus, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(timeout: float) -> None:
        raise can.CanOperationError("Network is down")

    monkeypatch.setattr(bus._bus, "recv", fail)
    with pytest.raises(BusError, match="cannot receive: Network is down"):
        bus.receive(0)


def test_log_has_both_directions_in_order() -> None:
    log: list[tuple[int, Frame]] = []
    mine = PythonCanBus("virtual", "toy", log=lambda time, frame: log.append((time, frame)))
    other = PythonCanBus("virtual", "toy")
    mine.send(Frame(1))
    other.send(Frame(2))
    mine.receive(GUARD_S)
    mine.close()
    other.close()
    assert [frame for _, frame in log] == [Frame(1), Frame(2)]
    assert 1_500_000_000_000_000 < log[0][0] <= log[1][0]


def test_multicast_party_hears_an_equal_frame_of_another_but_not_its_own(
    multicast: dict[str, Any],
) -> None:
    parties = [PythonCanBus(**multicast) for _ in range(3)]
    parties[0].send(SYNC)
    parties[1].send(SYNC)
    parties[2].send(Frame(1))
    heard = [[party.receive(GUARD_S), party.receive(GUARD_S)] for party in parties]
    leftover = [party.receive(0) for party in parties]
    for party in parties:
        party.close()
    assert heard == [[SYNC, Frame(1)], [SYNC, Frame(1)], [SYNC, SYNC]]
    assert leftover == [None, None, None]


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


def test_an_interface_that_is_gone_and_cannot_be_closed_is_only_lost(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def gone(*_: object) -> None:
        raise OSError("no such device")

    connection = PythonCanBus("virtual", "toy")
    lost: list[BusError] = []
    lasting = LastingBus(lambda: connection, lost=lost.append, back=list, full=lambda _: [])
    with monkeypatch.context() as patch:
        for method in ("recv", "shutdown"):
            patch.setattr(connection._bus, method, gone)
        assert lasting.receive(0) is None
    assert [str(reason) for reason in lost] == ["cannot receive: no such device"]
    connection.close()
