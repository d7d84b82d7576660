"""A node in a thread: it runs while the block does, and threads switch often meanwhile."""

import sys

import pytest
from nodes_on_a_bus import GUARD_S
from toy_node import BOOT_UP, OFF, REPLY, REQUEST, ToyNode

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.host.runner import node_in_thread


def test_node_thread_runs_for_its_block_with_frequent_switches() -> None:
    before = sys.getswitchinterval()
    master = PythonCanBus("virtual", "toy")
    with node_in_thread(ToyNode(), PythonCanBus("virtual", "toy"), lockstep=True):
        assert sys.getswitchinterval() == pytest.approx(2e-4)
        assert master.receive(GUARD_S) == Frame(BOOT_UP + 1, b"\0")
        master.send(Frame(REQUEST + 1))
        assert master.receive(GUARD_S) == Frame(REPLY + 1)
    assert master.receive(GUARD_S) == Frame(OFF + 1, bytes(2))
    assert sys.getswitchinterval() == before
    master.close()


def test_node_thread_raises_the_error_of_its_run_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = sys.getswitchinterval()
    node = ToyNode()
    monkeypatch.setattr(node, "start", lambda: 1 / 0)
    with (
        pytest.raises(ZeroDivisionError),
        node_in_thread(node, PythonCanBus("virtual", "toy")),
    ):
        pass
    assert sys.getswitchinterval() == before
