"""Commands and what depends on them, sent to a node of ``rich.eds`` with nothing in between."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Final

from nodes_on_a_bus import until
from read_once import read_once
from rich_eds import RICH

from smarttac_can.device.device import Device
from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.master import requests
from smarttac_can.nodes.device_node import DeviceNode
from smarttac_can.od.cia import COB_INVALID, LSS_MASTER_ID, UNCONFIGURED, NMTCommand

NODE_ID: Final = 0x20
ROUNDS: Final = 20
_RPDO_ID: Final = 0x200 + NODE_ID
"""Of RPDO 1 after a reset."""
_OTHER_IDS: Final = (0x2A0, 0x3A1)


class Client:
    """The other end of the bus: every call sends its frames in a row, and then waits.

    Parameters
    ----------
    send, receive
        Send a frame, and return the next one of the node.
    """

    def __init__(self, send: Callable[[Frame], None], receive: Callable[[], Frame]) -> None:
        self._send = send
        self._receive = receive
        self.od = read_once(RICH, NODE_ID)
        self._value = self.od.entry(0x2100, 1)
        self.cob_id = self.od.entry(0x1400, 1)

    def send(self, *frames: Frame) -> None:
        for frame in frames:
            self._send(frame)

    def value(self, *before: Frame) -> int:
        """What RPDO 1 has set, read right behind some frames; raises TimeoutError or IndexError."""
        request = requests.upload(NODE_ID, self._value)
        self.send(*before, request)
        while not requests.answers(frame := self._receive(), request):
            pass
        return int(requests.value(frame, self._value))

    def rpdo(self, can_id: int, value: int) -> Frame:
        return Frame(can_id, struct.pack("<HIh", value, 4_339_000, 0))

    def moved(self, can_id: int) -> tuple[Frame, Frame]:
        """Give RPDO 1 another identifier, for which it is switched off in between."""
        off, on = (
            requests.download(NODE_ID, self.cob_id, raw) for raw in (can_id | COB_INVALID, can_id)
        )
        return off, on


def _nmt(command: NMTCommand) -> Frame:
    return requests.nmt(command, NODE_ID)


def _enter(client: Client, node: DeviceNode, command: NMTCommand, state: NMTState) -> None:
    client.send(_nmt(command))
    until(lambda: node.device.nmt_state is state, pause=0.0005)
    # What the host does with the new state comes behind it.
    time.sleep(0.002)


START = _nmt(NMTCommand.START)
_PRE_OPERATIONAL = _nmt(NMTCommand.ENTER_PRE_OPERATIONAL)
_RESETS = (_nmt(NMTCommand.RESET_NODE), _nmt(NMTCommand.RESET_COMMUNICATION))


def start_and_sdo(client: Client, node: DeviceNode) -> None:
    for _ in range(ROUNDS):
        _enter(client, node, NMTCommand.STOP, NMTState.STOPPED)
        assert client.value(START) == 0


def pre_operational_and_sdo(client: Client, node: DeviceNode) -> None:
    for _ in range(ROUNDS):
        _enter(client, node, NMTCommand.STOP, NMTState.STOPPED)
        assert client.value(_PRE_OPERATIONAL) == 0


def start_and_rpdo(client: Client, node: DeviceNode) -> None:
    for number in range(1, ROUNDS + 1):
        command = (NMTCommand.STOP, NMTCommand.ENTER_PRE_OPERATIONAL)[number % 2]
        state = (NMTState.STOPPED, NMTState.PRE_OPERATIONAL)[number % 2]
        _enter(client, node, command, state)
        assert client.value(START, client.rpdo(_RPDO_ID, number)) == number


def another_cob_id_and_rpdo(client: Client, node: DeviceNode) -> None:
    assert client.value(START) == 0
    for number in range(1, ROUNDS + 1):
        can_id, old = (_OTHER_IDS[(number + other) % 2] for other in range(2))
        own = client.rpdo(can_id, number)
        assert client.value(*client.moved(can_id), client.rpdo(old, 9999), own) == number


def reset_and_rpdo(client: Client, node: DeviceNode) -> None:
    for number in range(1, ROUNDS + 1):
        assert client.value(*client.moved(_OTHER_IDS[0]), START) >= 0
        reset = _RESETS[number % 2]
        assert client.value(reset, START, client.rpdo(_RPDO_ID, number)) == number


CASES: Final = {
    case.__name__: case
    for case in (
        start_and_sdo,
        pre_operational_and_sdo,
        start_and_rpdo,
        another_cob_id_and_rpdo,
        reset_and_rpdo,
    )
}
"""What is done with a node that was just switched on."""


def node_id_and_sdo(client: Client) -> None:
    """Give a node without node-ID one by LSS, start it and read it, all in a row."""
    commands = ((0x04, 1), (0x11, NODE_ID), (0x04, 0))
    lss = [Frame(LSS_MASTER_ID, bytes(command).ljust(8, b"\0")) for command in commands]
    assert client.value(*lss, START, client.rpdo(_RPDO_ID, 7)) == 7


def make_node(node_id: int = NODE_ID) -> DeviceNode:
    return DeviceNode(Device(read_once(RICH, NODE_ID), node_id=node_id))


def make_node_without_id() -> DeviceNode:
    return make_node(UNCONFIGURED)
