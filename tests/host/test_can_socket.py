"""Sockets of python-can's interfaces, with python-can as the other party and as the oracle."""

import socket
import struct
import tracemalloc
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import Queue
from time import monotonic
from typing import Any

import can
import msgpack
import pytest
from can.interfaces.socketcan.constants import CAN_RTR_FLAG
from can.interfaces.socketcan.socketcan import build_can_frame, dissect_can_frame
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message, unpack_message
from hypothesis import example, given, settings
from hypothesis import strategies as st
from nodes_on_a_bus import GUARD_S

from smarttac_can.bench.network import TappedNetwork
from smarttac_can.canopen.bus.bus import BusError, QueueFullError
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host import can_socket
from smarttac_can.host.can_socket import (
    CanSocket,
    MulticastBus,
    SocketCan,
    _Multicast,
    open_socket,
    to_frame,
    to_message,
)
from smarttac_can.host.python_can import PythonCanBus, open_bus

WIDTHS = (0, 0x7F, 0x80, 0xFF, 0x100, 0x7FF)
"""Identifiers at which the width of an integer in MessagePack changes, and the last one."""
CAN_IDS = st.sampled_from(WIDTHS) | st.integers(0, 0x7FF)
FRAMES = st.builds(Frame, CAN_IDS, st.binary(max_size=8), st.just(False)) | st.builds(
    Frame, CAN_IDS, st.just(b""), st.just(True)
)
CODECS = {"socketcan": SocketCan, "udp_multicast": _Multicast}

many = settings(deadline=None, max_examples=200)


@st.composite
def messages(draw: st.DrawFn) -> can.Message:
    """Every kind of message that python-can takes."""
    kind = draw(st.sampled_from(["data", "remote", "error", "fd"]))
    extended = draw(st.booleans())
    options: dict[str, object] = {"dlc": draw(st.integers(0, 8))} if kind == "remote" else {}
    if kind == "data":
        options["data"] = draw(st.binary(max_size=8))
    if kind == "fd":
        options["data"] = bytes(draw(st.sampled_from([*range(9), 12, 16, 20, 24, 32, 48, 64])))
        options["bitrate_switch"] = draw(st.booleans())
        options["error_state_indicator"] = draw(st.booleans())
    return can.Message(
        timestamp=draw(st.floats(0, 1e10)),
        arbitration_id=draw(CAN_IDS | st.integers(0, 0x1FFFFFFF) if extended else CAN_IDS),
        is_extended_id=extended,
        is_remote_frame=kind == "remote",
        is_error_frame=kind == "error",
        is_fd=kind == "fd",
        channel=draw(st.none() | st.integers(0, 300) | st.text(max_size=40)),
        check=True,
        **options,
    )


# Bytes of udp_multicast


@many
@given(FRAMES)
def test_python_can_unpacks_datagrams_sent_to_the_group(frame: Frame) -> None:
    message = unpack_message(_Multicast().encode(frame), check=True)
    assert to_frame(message) == frame
    assert message.dlc == len(frame.data)


@many
@given(st.lists(messages(), max_size=2))
def test_each_datagram_packed_by_python_can_is_received(sent: list[can.Message]) -> None:
    codec = _Multicast()
    for message in sent + sent:
        assert codec.decode(pack_message(message)) == to_frame(message)


@pytest.mark.parametrize("can_id", WIDTHS)
@pytest.mark.parametrize("data", [b"", b"8 bytes!"])
@pytest.mark.parametrize("write", [_Multicast().encode, lambda f: pack_message(to_message(f))])
def test_a_frame_of_the_loop_is_unpacked_once(
    can_id: int, data: bytes, write: Callable[[Frame], bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    codec, frame = _Multicast(), Frame(can_id, data)
    assert codec.decode(write(frame)) == frame

    def refuse(data: bytes, **_limits: int) -> None:
        raise AssertionError("unpacked")

    monkeypatch.setattr(can_socket.msgpack, "unpackb", refuse)
    another = Frame(can_id, data[::-1])
    assert codec.decode(write(another)) == another
    with pytest.raises(AssertionError, match="unpacked"):
        codec.decode(write(Frame(can_id ^ 1, data)))


def test_multicast_memory_of_senders_is_bounded() -> None:
    codec = _Multicast()
    for sender in range(3):
        for can_id in range(0x800):
            packed = _Multicast().encode(Frame(can_id)) if sender else b""
            codec.decode(packed)
    assert len(codec._known) <= 4096


INTEGERS = {
    b"\xcc": ">B", b"\xcd": ">H", b"\xce": ">I", b"\xcf": ">Q",
    b"\xd0": ">b", b"\xd1": ">h", b"\xd2": ">i", b"\xd3": ">q",
}  # fmt: skip
MAPS = {b"\xde": ">H", b"\xdf": ">I"}


@st.composite
def by_another_library(draw: st.DrawFn, message: can.Message) -> bytes:
    """The same map, of keys in another order and numbers in other widths."""

    def text(value: str) -> bytes:
        if draw(st.booleans()):
            return msgpack.packb(value)
        return b"\xd9" + bytes((len(value),)) + value.encode()

    def number(value: int) -> bytes:
        if value < 0x80 and draw(st.booleans()):
            return bytes((value,))
        fitting = [
            (kind, form)
            for kind, form in INTEGERS.items()
            if value < 1 << 8 * struct.calcsize(form) - form[1].islower()
        ]
        kind, form = draw(st.sampled_from(fitting))
        return kind + struct.pack(form, value)

    fields = msgpack.unpackb(pack_message(message))
    keys = draw(st.just(list(fields)) | st.permutations(list(fields)))
    head = draw(st.sampled_from([*MAPS, b""]))
    packed = head + struct.pack(MAPS[head], len(keys)) if head else bytes((0x80 | len(keys),))
    for key in keys:
        packed += text(key)
        if key == "timestamp":
            whole = number(int(fields[key]))
            packed += draw(st.sampled_from([whole, b"\xca\0\0\0\0", msgpack.packb(fields[key])]))
        elif type(fields[key]) is int:
            packed += number(fields[key])
        else:
            packed += msgpack.packb(fields[key])
    return packed


@many
@given(st.data(), messages())
def test_another_library_may_write_the_message(data: st.DataObject, message: can.Message) -> None:
    packed = data.draw(by_another_library(message))
    assert to_frame(unpack_message(packed, check=True)) == to_frame(message)
    assert _Multicast().decode(packed) == to_frame(message)


SOUND = {
    "arbitration_id": 1,
    "is_extended_id": False,
    "is_remote_frame": False,
    "is_error_frame": False,
    "is_fd": False,
    "dlc": 0,
    "data": b"",
    "bitrate_switch": False,
    "error_state_indicator": False,
}
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text()
    | st.binary(max_size=70),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=8,
)  # fmt: skip


def sound(frame: Frame | None) -> bool:
    """Whether it is one that a node can be given."""
    return frame is None or (
        type(frame.can_id) is int
        and 0 <= frame.can_id <= 0x7FF
        and type(frame.data) is bytes
        and len(frame.data) <= 8
        and type(frame.rtr) is bool
    )


@many
@given(st.dictionaries(st.sampled_from(list(SOUND)), ANYTHING), st.sets(st.sampled_from([*SOUND])))
@example({"data": 2**63 - 1}, set())
@example({"data": 2**64 - 1}, set())
@example({"arbitration_id": True}, set())
@example({"arbitration_id": 1.0}, set())
@example({"arbitration_id": -1}, set())
@example({"arbitration_id": 0x800}, set())
@example({"data": bytes(9)}, set())
def test_a_map_of_anything_is_a_frame_or_none(
    replaced: dict[str, object], missing: set[str]
) -> None:
    fields = {key: value for key, value in {**SOUND, **replaced}.items() if key not in missing}
    packed = msgpack.packb(fields)
    heard = _Multicast().decode(packed)
    assert sound(heard)
    if missing or fields["arbitration_id"] not in range(0x800):
        assert heard is None


MALFORMED = [
    *({"data": data} for data in (0, 3, True, None, "text", [1, 2], {1: 2}, 1.5, bytes(9))),
    *({"data": data, "dlc": 65, "is_fd": True} for data in (bytes(65), 1 << 30)),
    *({"dlc": dlc} for dlc in (1, -1, None, 0.0, "0", False)),
    *({"arbitration_id": number} for number in (-1, 0x800, 1.0, True, None, "1")),
    *({flag: value} for flag in SOUND if flag.startswith("is_") for value in (0, 1, None, "")),
    {"bitrate_switch": True},
    {"error_state_indicator": True},
    {"is_remote_frame": True, "is_error_frame": True},
]


@pytest.mark.parametrize("fields", MALFORMED, ids=repr)
def test_a_malformed_field_is_skipped_and_counted(fields: dict[str, object]) -> None:
    codec = _Multicast()
    assert codec.decode(msgpack.packb(SOUND | fields)) is None
    assert codec.malformed == 1
    assert codec.decode(msgpack.packb(SOUND)) == Frame(1)
    assert codec.malformed == 1


def test_a_missing_field_is_skipped_and_counted() -> None:
    codec = _Multicast()
    for count, name in enumerate(SOUND, 1):
        rest = {key: value for key, value in SOUND.items() if key != name}
        assert codec.decode(msgpack.packb(rest)) is None
        assert codec.malformed == count


@many
@given(messages())
def test_the_decoder_reads_a_message_as_python_can_does(message: can.Message) -> None:
    heard, wanted = _Multicast().message(pack_message(message), 7.0), message
    assert heard is not None
    assert heard.equals(wanted, timestamp_delta=None, check_channel=False)
    assert (heard.timestamp, heard.channel) == (7.0, None)


HUGE = [
    msgpack.packb(SOUND | {"data": 1 << 30}),
    msgpack.packb(SOUND | {"data": 3 << 30, "is_fd": True, "dlc": 64}),
    b"\xdd\xff\xff\xff\xff",  # an array of 4 294 967 295 elements
    b"\xdc\x0f\xff" * 500 + bytes(2000),  # arrays of 4095, one in the other
    b"\xdf\xff\xff\xff\xff",
    b"\xc6\xff\xff\xff\xff",
]


@pytest.mark.parametrize("datagram", HUGE, ids=lambda data: data[:5].hex())
def test_a_datagram_takes_no_more_memory_than_it_has(
    datagram: bytes, multicast: dict[str, Any]
) -> None:
    with open_bus(multicast) as bus, can.Bus(**multicast) as other:
        assert isinstance(bus, MulticastBus)
        other._multicast.send(datagram)
        other.send(to_message(Frame(1, b"sound")))
        tracemalloc.start()
        try:
            heard = bus.recv(GUARD_S)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert heard is not None and to_frame(heard) == Frame(1, b"sound")
        assert bus.codec.malformed == 1
    assert peak < 100_000


def test_malformed_datagrams_are_logged_when_the_bus_closes(
    multicast: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    node, bench = PythonCanBus(**multicast), TappedNetwork().connect(**multicast)
    with can.Bus(**multicast) as other:
        heard: Queue[bytes] = Queue()
        bench.subscribe(1, lambda _can_id, data, _stamp: heard.put(bytes(data)))
        for _ in range(3):
            other._multicast.send(b"no message" * 10)
        other.send(to_message(Frame(1, b"after")))
        assert node.receive(GUARD_S) == Frame(1, b"after")
        assert heard.get(timeout=GUARD_S) == b"after"
        bench.check()
    assert not caplog.messages
    node.close()
    bench.disconnect()
    wanted = "skipped 3 datagrams to 239.74.163.3 that are no CAN frames"
    assert [message.partition(":")[0] for message in caplog.messages] == [wanted] * 2
    node.close()
    assert len(caplog.messages) == 2


@pytest.mark.parametrize("fd", [False, True])
def test_a_bus_without_can_fd_hears_no_fd_frame(fd: bool, multicast: dict[str, Any]) -> None:
    wide = can.Message(arbitration_id=1, is_extended_id=False, is_fd=True, data=bytes(64))
    with open_bus(multicast | {"fd": fd}) as bus, can.Bus(**multicast) as other:
        other.send(wide)
        other.send(to_message(Frame(2)))
        heard = [bus.recv(GUARD_S) for _ in range(1 + fd)]
    assert [message and message.arbitration_id for message in heard] == [1, 2][not fd :]


def test_own_echo_is_dropped_and_an_equal_foreign_frame_received() -> None:
    mine, other = _Multicast(), _Multicast()
    frame = Frame(0x123, b"same")
    assert mine.encode(frame) != other.encode(frame)
    for _ in range(2):
        assert mine.decode(mine.encode(frame)) is None
        assert mine.decode(other.encode(frame)) == frame
        assert mine.decode(pack_message(to_message(frame))) == frame


# Bytes of SocketCAN


@many
@given(FRAMES)
def test_socketcan_struct_equals_that_of_python_can(frame: Frame) -> None:
    data = SocketCan().encode(frame)
    built = bytearray(build_can_frame(to_message(frame)))
    built[7] = 0  # len8_dlc, which counts from 9 on only
    assert data == built
    can_id, dlc, flags, payload = dissect_can_frame(data)
    assert (can_id, dlc, flags) == (frame.can_id | frame.rtr * CAN_RTR_FLAG, len(frame.data), 0)
    assert payload == frame.data


@many
@given(messages())
def test_struct_that_python_can_builds_is_heard(message: can.Message) -> None:
    assert SocketCan().decode(build_can_frame(message)) == to_frame(message)


@many
@given(st.integers(0, 2**32 - 1) | CAN_IDS, st.integers(0, 255), st.binary(min_size=8, max_size=8))
def test_any_struct_is_read_as_python_can_reads_it(word: int, size: int, payload: bytes) -> None:
    packed = struct.pack("=IB3x8s", word, size, payload)
    frame = SocketCan().decode(packed)
    assert sound(frame)
    if word <= 0x7FF and size <= 8:
        can_id, _, _, data = dissect_can_frame(packed)
        assert frame == Frame(can_id, data)


# Both


@many
@pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS)
@given(data=st.binary(max_size=120))
def test_garbage_is_nothing_to_hear(
    codec: Callable[[], _Multicast | SocketCan], data: bytes
) -> None:
    assert sound(codec().decode(data))


@many
@pytest.mark.parametrize("codec", CODECS.values(), ids=CODECS)
@given(st.data(), FRAMES)
def test_truncated_or_garbled_datagrams_are_dropped(
    codec: Callable[[], _Multicast | SocketCan], data: st.DataObject, frame: Frame
) -> None:
    whole = codec().encode(frame)
    knowing = codec()
    assert knowing.decode(whole) == frame
    for end in range(len(whole)):
        assert knowing.decode(whole[:end]) is None
    broken = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        broken[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    heard = codec().decode(bytes(broken))
    assert sound(heard)
    assert knowing.decode(bytes(broken)) == heard, "what it knows of the sender changes nothing"


# The socket


class Party:
    """One end of a pair of sockets, where a bus of python-can is expected."""

    def __init__(self, end: socket.socket) -> None:
        self.fileno = end.fileno


Pair = tuple[CanSocket, socket.socket]


@pytest.fixture(params=["socketcan", "udp_multicast"])
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    """A socket under test, and the other end."""
    mine, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with mine, other:
        mine.setblocking(True)
        under_test = CanSocket(Party(mine), CODECS[request.param](), None)
        yield under_test, other
        under_test.close()
        assert mine.fileno() >= 0, "the bus keeps its own descriptor"
        mine.getsockname()


def written(under_test: CanSocket, frame: Frame) -> bytes:
    """A frame as another party writes it."""
    return type(under_test._codec)().encode(frame)


def all_read(under_test: CanSocket) -> list[Frame]:
    frames: deque[Frame] = deque()
    while under_test.read(frames):
        pass
    return list(frames)


def test_an_empty_socket_is_not_waited_for(pair: Pair) -> None:
    under_test, _ = pair
    frames: deque[Frame] = deque()
    assert not under_test.read(frames)
    assert not frames


def test_queued_frames_are_read_in_order(pair: Pair) -> None:
    under_test, other = pair
    frames = [Frame(number, bytes(number)) for number in range(9)]
    for frame in frames:
        other.send(written(under_test, frame))
    assert all_read(under_test) == frames


def test_no_more_is_read_at_once_than_takes_a_millisecond(pair: Pair) -> None:
    under_test, other = pair
    other.setblocking(False)
    read: deque[Frame] = deque()
    sent = 0
    while sent < 200:
        try:
            other.send(written(under_test, Frame(sent)))
            sent += 1
        except BlockingIOError:
            under_test.read(read)
    before = len(read)
    assert under_test.read(read) == (sent - before >= 64)
    assert len(read) - before <= 64
    assert [*read, *all_read(under_test)] == [Frame(number) for number in range(sent)]


def test_a_full_queue_is_not_waited_for(pair: Pair) -> None:
    under_test, other = pair
    sent = 0
    with pytest.raises(QueueFullError, match="cannot send frame"):
        while sent < 1_000_000:
            under_test.send(Frame(sent & 0x7FF, sent.to_bytes(8, "little")))
            sent += 1
    assert sent > 0
    reader = type(under_test._codec)()
    for number in range(sent):
        frame = Frame(number & 0x7FF, number.to_bytes(8, "little"))
        assert reader.decode(other.recv(4096)) == frame


def test_wait_ends_when_there_is_something(pair: Pair) -> None:
    under_test, other = pair
    for timeout in (0.0, 0.05):
        before = monotonic()
        under_test.wait(timeout)
        assert timeout <= monotonic() - before < timeout + GUARD_S
    other.send(b"whatever")
    before = monotonic()
    under_test.wait(GUARD_S)
    assert monotonic() - before < GUARD_S
    assert all_read(under_test) == []


def test_a_socket_that_is_closed_is_an_error_of_the_bus(pair: Pair) -> None:
    under_test, _ = pair
    under_test.close()
    with pytest.raises(BusError, match="cannot receive"):
        under_test.wait(0.0)
    with pytest.raises(BusError, match="cannot receive"):
        under_test.read(deque())
    with pytest.raises(BusError, match="cannot send frame 001"):
        under_test.send(Frame(1))


@pytest.mark.sources
def test_only_an_interface_whose_bytes_are_known_is_used(
    multicast: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    with can.Bus("toy", "virtual") as bus:
        assert open_socket(bus) is None
    monkeypatch.setattr(can_socket, "_NOW", 0)
    with open_bus(multicast) as bus:
        assert open_socket(bus) is None, "a system whose sockets cannot but wait"


def test_python_can_on_the_same_group(multicast: dict[str, Any]) -> None:
    ours = PythonCanBus(**multicast)
    with can.Bus(**multicast) as theirs:
        frames = [Frame(0x7FF, bytes(range(8))), Frame(0), Frame(0x181, rtr=True)]
        for frame in frames:
            ours.send(frame)
        messages = [theirs.recv(GUARD_S) for _ in frames]
        for frame in frames:
            theirs.send(to_message(frame))
        heard = [ours.receive(GUARD_S) for _ in frames]
    leftover = ours.receive(0.0)
    ours.close()
    assert [message and to_frame(message) for message in messages] == frames
    assert (heard, leftover) == (frames, None)


@pytest.mark.parametrize("context", [None, "LAB"])
def test_group_of_the_configuration(
    context: str | None,
    multicast: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    group, port = multicast["channel"], multicast["port"]
    monkeypatch.setenv("HOME", str(tmp_path))
    if context:
        (tmp_path / ".canrc").write_text(f"[LAB]\ninterface = udp_multicast\nchannel = {group}\n")
        configured = PythonCanBus(config_context=context, port=port)
    else:
        monkeypatch.setenv("CAN_CHANNEL", group)
        configured = PythonCanBus("udp_multicast", port=port)
    named = PythonCanBus(**multicast)
    configured.send(Frame(1))
    assert named.receive(GUARD_S) == Frame(1)
    configured.close()
    named.close()


def test_group_without_any_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_CONFIG"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(can.util, "CONFIG_FILES", [])
    opened: list[tuple[object, ...]] = []
    monkeypatch.setattr(
        UdpMulticastBus, "__init__", lambda self, *options, **_: opened.append(options)
    )
    monkeypatch.setattr(UdpMulticastBus, "shutdown", lambda self: None)
    bus = open_bus({"interface": "udp_multicast", "channel": None})
    assert isinstance(bus, MulticastBus)
    assert opened == [(bus.group,)] == [(UdpMulticastBus.DEFAULT_GROUP_IPv6,)]
    bus._is_shutdown = True
