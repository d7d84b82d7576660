"""The buses that one set of tests runs over, each with a master and nodes on it."""

import threading
import time
from collections import deque
from collections.abc import Callable

from nodes_on_a_bus import GUARD_S

from smarttac_can.canopen.bus.local_bus import LocalBus
from smarttac_can.canopen.bus.node import HostedNode
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.host.runner import run_node


class LocalLine:
    """A master and nodes on a `LocalBus`."""

    def __init__(self) -> None:
        self.bus = LocalBus()
        self.inbox: deque[Frame] = deque()
        self.port = self.bus.connect(self.inbox.append)
        self.clocked = False

    def run(self, node: HostedNode, *, lockstep: bool) -> None:
        self.clocked |= not lockstep
        self.bus.attach(node, lockstep=lockstep)

    def send(self, frame: Frame) -> None:
        self.port.send(frame)

    def receive(self) -> Frame:
        for _ in range(100):
            if self.inbox or not self.clocked:
                break
            self.bus.advance(1000)
        return self.inbox.popleft()

    def stop(self) -> None:
        self.bus.shutdown()

    def close(self) -> None:
        self.port.close()


class PythonCanLine:
    """A master and nodes on a bus of python-can, each with a connection, nodes in threads."""

    def __init__(self, connect: Callable[[], PythonCanBus]) -> None:
        self.connect = connect
        self.master = connect()
        self.stopping = threading.Event()
        self.threads: list[threading.Thread] = []

    def run(self, node: HostedNode, *, lockstep: bool) -> None:
        bus = self.connect()
        thread = threading.Thread(
            target=lambda: run_node(node, bus, self.stopping.is_set, lockstep=lockstep)
        )
        thread.start()
        self.threads.append(thread)

    def send(self, frame: Frame) -> None:
        self.master.send(frame)

    def receive(self) -> Frame:
        end = time.monotonic() + GUARD_S
        while time.monotonic() < end:
            frame = self.master.receive(0.1)
            if frame is not None:
                return frame
        raise TimeoutError("no frame came")

    def stop(self) -> None:
        self.stopping.set()
        for thread in self.threads:
            thread.join(GUARD_S)

    def close(self) -> None:
        self.stop()
        self.master.close()


Line = LocalLine | PythonCanLine
