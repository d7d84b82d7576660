"""Rules for every bus: a module of tests gives its ``line`` and imports all of this."""

import struct
import time
from typing import Final

import pytest
from bus_lines import Line, LocalLine
from nodes_on_a_bus import until
from read_once import read_once
from rich_eds import RICH
from toy_node import (
    AT_SYNC,
    BOOT_UP,
    OFF,
    REPLY,
    REQUEST,
    SEGMENT,
    SYNC,
    TICKER,
    TICKER_US,
    StreamingNode,
    ToyNode,
)

from smarttac_can.canopen.device.device import Device
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.master import requests
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import NMTCommand
from smarttac_can.instrument.nodes.device_node import DeviceNode

NODE_ID: Final = 0x20
ROUNDS: Final = 20
RPDO_ID: Final = 0x200 + NODE_ID
"""Of RPDO 1 after a reset."""
OTHER_IDS: Final = (0x2A0, 0x3A1)
ALIKE: Final = read_once(RICH, NODE_ID)
VALUE, COB_ID = ALIKE.entry(0x2100, 1), ALIKE.entry(0x1400, 1)


def received_of(line: Line, can_id: int, count: int) -> list[Frame]:
    """The next frames with an identifier, past whatever else is on the bus."""
    found: list[Frame] = []
    while len(found) < count:
        frame = line.receive()
        if frame.can_id == can_id:
            found.append(frame)
    return found


def times(frames: list[Frame]) -> list[int]:
    return [int.from_bytes(frame.data, "little") for frame in frames]


def test_boot_up_is_the_first_frame(line: Line) -> None:
    line.run(ToyNode(), lockstep=True)
    assert line.receive() == Frame(BOOT_UP + 1, b"\0")


def test_frames_of_every_length_come_back_unchanged(line: Line) -> None:
    line.run(ToyNode(), lockstep=True)
    line.receive()
    for length in range(9):
        line.send(Frame(REQUEST + 1, bytes(range(0xF0, 0xF0 + length))))
        assert line.receive() == Frame(REPLY + 1, bytes(range(0xF0, 0xF0 + length)))


def test_all_segments_follow_the_answer(line: Line) -> None:
    line.run(StreamingNode(), lockstep=True)
    line.receive()
    line.send(Frame(REQUEST + 1, b"\x7f"))
    assert line.receive() == Frame(REPLY + 1, b"\x7f")
    assert [line.receive() for _ in range(127)] == [
        Frame(SEGMENT + 1, bytes((k,))) for k in range(127)
    ]


def test_a_burst_is_answered_in_order_and_once(line: Line) -> None:
    line.run(ToyNode(), lockstep=True)
    line.receive()
    for number in range(40):
        line.send(Frame(REQUEST + 1, bytes([number])))
    line.send(SYNC)
    replies = [line.receive() for _ in range(41)]
    assert replies == [Frame(REPLY + 1, bytes([n])) for n in range(40)] + [
        Frame(AT_SYNC + 1, (1000).to_bytes(8, "little"))
    ]


def test_lockstep_is_moved_by_sync_and_by_nothing_else(line: Line) -> None:
    node = ToyNode()
    line.run(node, lockstep=True)
    line.receive()
    seen = []
    for _ in range(20):
        line.send(SYNC)
        seen += received_of(line, AT_SYNC + 1, 1)
        line.send(Frame(REQUEST + 1))
        received_of(line, REPLY + 1, 1)
    assert times(seen) == [1000 * k for k in range(1, 21)]
    assert node.advances == [1000] * 20


def test_lockstep_timer_falls_due_before_the_answer_to_sync(line: Line) -> None:
    line.run(ToyNode(), lockstep=True)
    line.receive()
    for _ in range(4):
        line.send(SYNC)
        line.receive()
    line.send(SYNC)
    assert [line.receive().can_id, line.receive().can_id] == [TICKER + 1, AT_SYNC + 1]


def test_real_time_moves_by_the_clock_and_not_by_sync(line: Line) -> None:
    node = ToyNode()
    line.run(node, lockstep=False)
    first = times(received_of(line, TICKER + 1, 3))
    for _ in range(50):
        line.send(SYNC)
    at_sync = times(received_of(line, AT_SYNC + 1, 50))
    line.stop()
    assert [t // TICKER_US for t in first] == sorted({t // TICKER_US for t in first})
    assert at_sync == sorted(at_sync)
    if isinstance(line, LocalLine):
        assert node.time == sum(node.advances) == 1000 * len(node.advances)
    else:
        assert set(node.advances) == {0}, "what is due is asked for at the clock's time"


def test_remote_frame_stays_one(line: Line) -> None:
    node = ToyNode()
    line.run(node, lockstep=True)
    line.receive()
    line.send(Frame(AT_SYNC + 1, rtr=True))
    assert line.receive() == Frame(AT_SYNC + 1, bytes(8))
    assert node.heard == [Frame(AT_SYNC + 1, rtr=True)]


def test_nodes_hear_each_other_once_and_nobody_hears_himself(line: Line) -> None:
    first = ToyNode(1)
    second = ToyNode(2, follows=REPLY + 1)
    line.run(first, lockstep=True)
    line.receive()
    line.run(second, lockstep=True)
    line.receive()
    # python-can's virtual bus hands a frame to one party after the other.
    until(lambda: len(first.heard) == 1)
    for number in range(10):
        line.send(Frame(REQUEST + 1, bytes([number])))
        assert [line.receive(), line.receive()] == [
            Frame(REPLY + 1, bytes([number])),
            Frame(REPLY + 2, bytes([number])),
        ]
    until(lambda: len(first.heard) == 21 and len(second.heard) == 20)
    line.stop()
    requests = [Frame(REQUEST + 1, bytes([number])) for number in range(10)]
    assert [f for f in first.heard if f.can_id != OFF + 2] == [
        Frame(BOOT_UP + 2, b"\0"),
        *(f for n, r in enumerate(requests) for f in (r, Frame(REPLY + 2, bytes([n])))),
    ]
    replies = [Frame(REPLY + 1, bytes([number])) for number in range(10)]
    heard = [f for f in second.heard if f.can_id != OFF + 1]
    # Between processes the reply of one node may reach another before the request does.
    assert [f for f in heard if f.can_id == REQUEST + 1] == requests
    assert [f for f in heard if f.can_id != REQUEST + 1] == replies
    if isinstance(line, LocalLine):
        assert heard == [f for pair in zip(requests, replies, strict=True) for f in pair]


def test_equal_frames_of_two_parties_are_not_taken_for_an_echo(line: Line) -> None:
    line.run(ToyNode(1), lockstep=True)
    line.receive()
    line.send(Frame(REPLY + 1, b"same"))
    line.send(Frame(REQUEST + 1, b"same"))
    assert line.receive() == Frame(REPLY + 1, b"same")


def test_stop_leaves_the_plate_at_zero(line: Line) -> None:
    line.run(ToyNode(), lockstep=True)
    line.receive()
    line.stop()
    assert line.receive() == Frame(OFF + 1, bytes(2))


# From here on: frames that depend on a command and follow it at once, with nothing in between.


def nmt(command: NMTCommand) -> Frame:
    return requests.nmt(command, NODE_ID)


START: Final = nmt(NMTCommand.START)
COMMANDS: Final = {
    NMTState.STOPPED: NMTCommand.STOP,
    NMTState.PRE_OPERATIONAL: NMTCommand.ENTER_PRE_OPERATIONAL,
}
"""Commands to enter an NMT state."""


def switched_on(line: Line, *, lockstep: bool) -> DeviceNode:
    node = DeviceNode(Device(read_once(RICH, NODE_ID), node_id=NODE_ID))
    line.run(node, lockstep=lockstep)
    line.receive()
    return node


def value_after(line: Line, *before: Frame) -> int:
    """The value of RPDO 1, read right after some frames."""
    request = requests.upload(NODE_ID, VALUE)
    for frame in (*before, request):
        line.send(frame)
    while not requests.answers(answer := line.receive(), request):
        pass
    return int(requests.value(answer, VALUE))


def rpdo(can_id: int, value: int) -> Frame:
    return Frame(can_id, struct.pack("<HIh", value, 4_339_000, 0))


def moved(can_id: int) -> list[Frame]:
    """Give RPDO 1 another identifier, for which it is switched off in between."""
    return [requests.download(NODE_ID, COB_ID, raw) for raw in (can_id | cia.COB_INVALID, can_id)]


def enter(line: Line, node: DeviceNode, state: NMTState) -> None:
    line.send(nmt(COMMANDS[state]))
    until(lambda: node.device.nmt_state is state, pause=0.0005)
    # The host acts on the new state after that.
    time.sleep(0.002)


@pytest.mark.parametrize("command", [NMTCommand.START, NMTCommand.ENTER_PRE_OPERATIONAL])
@pytest.mark.parametrize("lockstep", [False, True])
def test_sdo_right_after_the_command_that_ends_stopped(
    line: Line, lockstep: bool, command: NMTCommand
) -> None:
    node = switched_on(line, lockstep=lockstep)
    for _ in range(ROUNDS):
        enter(line, node, NMTState.STOPPED)
        assert value_after(line, nmt(command)) == 0


@pytest.mark.parametrize("lockstep", [False, True])
def test_rpdo_right_after_start(line: Line, lockstep: bool) -> None:
    node = switched_on(line, lockstep=lockstep)
    for number in range(1, ROUNDS + 1):
        enter(line, node, (NMTState.STOPPED, NMTState.PRE_OPERATIONAL)[number % 2])
        assert value_after(line, START, rpdo(RPDO_ID, number)) == number


@pytest.mark.parametrize("lockstep", [False, True])
def test_rpdo_right_after_its_new_identifier(line: Line, lockstep: bool) -> None:
    switched_on(line, lockstep=lockstep)
    assert value_after(line, START) == 0
    for number in range(1, ROUNDS + 1):
        can_id, old = OTHER_IDS[number % 2], OTHER_IDS[(number + 1) % 2]
        sent = (*moved(can_id), rpdo(old, 9999), rpdo(can_id, number))
        assert value_after(line, *sent) == number


@pytest.mark.parametrize("lockstep", [False, True])
def test_rpdo_right_after_a_reset(line: Line, lockstep: bool) -> None:
    switched_on(line, lockstep=lockstep)
    resets = nmt(NMTCommand.RESET_NODE), nmt(NMTCommand.RESET_COMMUNICATION)
    for number in range(1, ROUNDS + 1):
        value_after(line, *moved(OTHER_IDS[0]), START)
        assert value_after(line, resets[number % 2], START, rpdo(RPDO_ID, number)) == number


@pytest.mark.parametrize("lockstep", [False, True])
def test_sdo_right_after_the_first_node_id(line: Line, lockstep: bool) -> None:
    node = DeviceNode(Device(read_once(RICH, NODE_ID), node_id=cia.UNCONFIGURED))
    line.run(node, lockstep=lockstep)
    until(lambda: node.ids.heard != frozenset())
    commands = ((0x04, 1), (0x11, NODE_ID), (0x04, 0))
    lss = [Frame(cia.LSS_MASTER_ID, bytes(command).ljust(8, b"\0")) for command in commands]
    assert value_after(line, *lss, START, rpdo(RPDO_ID, 7)) == 7
