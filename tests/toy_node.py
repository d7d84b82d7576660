"""A node simple enough to see through: echoes, reports its time at SYNC and every fifth ms.

Run as a program it is a node on a multicast bus, for tests that need another process:
``python toy_node.py CHANNEL PORT``.
"""

import sys

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.port import Clock, Identifiers
from smarttac_can.host.process_signals import stop_on_signals
from smarttac_can.host.python_can import PythonCanBus
from smarttac_can.host.runner import run_node

SYNC = Frame(0x080)
REQUEST, REPLY = 0x600, 0x580
AT_SYNC, TICKER = 0x180, 0x280
BOOT_UP, OFF = 0x700, 0x300
EMERGENCY = 0x080
SEGMENT = 0x380
TICKER_US = 5000


class ToyNode:
    def __init__(self, node_id: int = 1, follows: int | None = None) -> None:
        self.node_id = node_id
        self.follows = follows
        self.heard: list[Frame] = []
        self.advances: list[int] = []
        self.failures = 0
        self.late: list[int] = []
        self.passed: list[Frame] = []
        self.clock = Clock()
        self._ticker = self.clock.timer(self._tick)
        self._out: list[Frame] = []
        self.ids = Identifiers(
            frozenset({SYNC.can_id, AT_SYNC + node_id})
            | {base + other for base in (BOOT_UP, REPLY, REQUEST, OFF) for other in (1, 2)},
            frozenset({AT_SYNC + node_id, TICKER + node_id, EMERGENCY + node_id}),
            EMERGENCY + node_id,
        )

    @property
    def time(self) -> int:
        return self.clock.now

    def start(self) -> list[Frame]:
        self._ticker.start(TICKER_US, periodic=True)
        return [Frame(BOOT_UP + self.node_id, b"\0")]

    def receive(self, frame: Frame) -> list[Frame]:
        self.heard.append(frame)
        if frame == SYNC or frame == Frame(AT_SYNC + self.node_id, rtr=True):
            return [Frame(AT_SYNC + self.node_id, self.time.to_bytes(8, "little"))]
        if frame.can_id == REQUEST + self.node_id or frame.can_id == self.follows:
            return [Frame(REPLY + self.node_id, frame.data)]
        return []

    def bus_off(self) -> list[Frame]:
        return []

    def bus_recovered(self) -> list[Frame]:
        return []

    def advance(self, microseconds: int) -> list[Frame]:
        self.advances.append(microseconds)
        self.clock.advance(microseconds)
        out, self._out = self._out, []
        return out

    def overtaken(self, frame: Frame) -> list[Frame]:
        self.passed.append(frame)
        return self.receive(frame)

    def overdue(self) -> list[Frame]:
        self.late.append(self.time)
        return []

    def transmit_failed(self) -> list[Frame]:
        self.failures += 1
        return [Frame(EMERGENCY + self.node_id, bytes(8))]

    def segments(self, most: int) -> list[Frame]:
        return []

    def shutdown(self) -> list[Frame]:
        return [Frame(OFF + self.node_id, bytes(2))]

    def _tick(self) -> None:
        self._out.append(Frame(TICKER + self.node_id, self.time.to_bytes(8, "little")))


class StreamingNode(ToyNode):
    """Follows its answer by as many segments as the first byte of the request says."""

    def __init__(self, node_id: int = 1) -> None:
        super().__init__(node_id)
        self.left: list[Frame] = []

    def receive(self, frame: Frame) -> list[Frame]:
        if frame.can_id == REQUEST + self.node_id:
            self.left = [Frame(SEGMENT + self.node_id, bytes((k,))) for k in range(frame.data[0])]
        return super().receive(frame)

    def segments(self, most: int) -> list[Frame]:
        taken, self.left = self.left[:most], self.left[most:]
        return taken


def main() -> None:
    channel, port = sys.argv[1:]
    with stop_on_signals() as stop:
        run_node(ToyNode(), PythonCanBus("udp_multicast", channel, port=int(port)), stop)


if __name__ == "__main__":
    main()
