"""Frames right behind the command that makes them wanted, on SocketCAN."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest
from back_to_back import CASES, Client, make_node, make_node_without_id, node_id_and_sdo
from nodes_on_a_bus import GUARD_S, until
from processes import CHANNEL

from smarttac_can.device.frame import Frame
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.host.runner import node_in_thread
from smarttac_can.nodes.device_node import DeviceNode


@contextmanager
def client_of(node: DeviceNode, *, lockstep: bool) -> Iterator[Client]:
    """Run a node on vcan0 while the block does."""

    def receive() -> Frame:
        frame = master.receive(GUARD_S)
        if frame is None:
            raise TimeoutError("no frame came")
        return frame

    with (
        closing(PythonCanBus("socketcan", CHANNEL)) as master,
        node_in_thread(node, PythonCanBus("socketcan", CHANNEL), lockstep=lockstep),
    ):
        yield Client(master.send, receive)


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_what_follows_a_command_at_once_is_not_lost(case: str, lockstep: bool) -> None:
    node = make_node()
    with client_of(node, lockstep=lockstep) as client:
        CASES[case](client, node)


@pytest.mark.parametrize("lockstep", [False, True])
def test_what_follows_the_first_node_id_at_once_is_not_lost(lockstep: bool) -> None:
    node = make_node_without_id()
    with client_of(node, lockstep=lockstep) as client:
        until(lambda: node.ids.heard)
        node_id_and_sdo(client)
