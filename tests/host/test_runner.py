"""The loop alone, on a scripted bus and clock."""

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from toy_node import AT_SYNC, BOOT_UP, OFF, REPLY, REQUEST, SYNC, TICKER, ToyNode

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import BusError
from smarttac_can.host.runner import run_node

TICK_NS = 1_000_000


class ScriptedBus:
    """Hands out a script of (ns that pass, frame); the clock only moves while it waits."""

    def __init__(self, *script: tuple[int | None, Frame | None]) -> None:
        self.script = list(script)
        self.now = 0
        self.sent: list[Frame] = []
        self.closed = 0
        self.broken = False

    def clock(self) -> int:
        return self.now

    def send(self, frame: Frame) -> None:
        if self.broken:
            raise BusError(f"broken at {frame.can_id:03X}")
        self.sent.append(frame)

    def receive(self, timeout: float) -> Frame | None:
        passes, frame = self.script.pop(0)
        self.now += round(timeout * 1e9) if passes is None else passes
        return frame

    def close(self) -> None:
        self.closed += 1

    def at_end(self) -> bool:
        return not self.script


class CountingNode(ToyNode):
    def __init__(self) -> None:
        super().__init__()
        self.calls: list[tuple[str, int]] = []

    def missed(self, ticks: int) -> None:
        self.calls.append(("missed", ticks))

    def advance(self, microseconds: int) -> list[Frame]:
        self.calls.append(("advance", microseconds))
        return super().advance(microseconds)


ON_TIME = (None, None)
NEVER_ASKED = (0, None)


def run(node: ToyNode, bus: ScriptedBus, *, lockstep: bool = False) -> None:
    run_node(node, bus, bus.at_end, lockstep=lockstep, clock=bus.clock)


def test_on_time_no_deadline_is_missed() -> None:
    node, bus = CountingNode(), ScriptedBus(*[ON_TIME] * 8, NEVER_ASKED)
    run(node, bus)
    assert node.calls == [("advance", 1000)] * 8
    assert [frame.can_id for frame in bus.sent] == [BOOT_UP + 1, TICKER + 1, OFF + 1]


def test_late_ticks_are_made_up_in_one_call_and_counted_first() -> None:
    bus = ScriptedBus((4 * TICK_NS + 300_000, None), ON_TIME, NEVER_ASKED)
    node = CountingNode()
    run(node, bus)
    assert node.calls == [("missed", 3), ("advance", 4000), ("advance", 1000)]
    assert bus.now == 5 * TICK_NS


def test_node_that_counts_nothing_is_made_up_all_the_same() -> None:
    node, bus = ToyNode(), ScriptedBus((3 * TICK_NS, None), NEVER_ASKED)
    run(node, bus)
    assert node.advances == [3000]


def test_flood_of_frames_does_not_hold_up_the_ticks() -> None:
    node = ToyNode()
    bus = ScriptedBus(*[(100_000, Frame(REQUEST + 1))] * 100, NEVER_ASKED)
    run(node, bus)
    assert node.advances == [1000] * 10
    assert sum(frame.can_id == REPLY + 1 for frame in bus.sent) == 100


def test_node_that_is_always_late_still_hears_the_bus() -> None:
    class SlowNode(CountingNode):
        def advance(self, microseconds: int) -> list[Frame]:
            bus.now += 2 * TICK_NS
            return super().advance(microseconds)

    node = SlowNode()
    bus = ScriptedBus(ON_TIME, *[(0, Frame(REQUEST + 1))] * 24, NEVER_ASKED)
    run(node, bus)
    assert sum(frame.can_id == REPLY + 1 for frame in bus.sent) == 24
    assert len([call for call, _ in node.calls if call == "advance"]) in (2, 3, 4)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.integers(0, 10 * TICK_NS), min_size=1, max_size=30))
def test_no_tick_is_lost_or_invented(stalls: list[int]) -> None:
    node, bus = CountingNode(), ScriptedBus(*[(stall, None) for stall in stalls], NEVER_ASKED)
    run(node, bus)
    ticks = node.time // 1000
    missed = sum(count for call, count in node.calls if call == "missed")
    assert node.time % 1000 == 0
    assert bus.now // TICK_NS - 1 <= ticks <= bus.now // TICK_NS
    assert missed == ticks - len(node.advances)


def test_lockstep_knows_no_clock() -> None:
    node = ToyNode()
    bus = ScriptedBus(
        (50 * TICK_NS, None),
        (0, SYNC),
        (50 * TICK_NS, Frame(REQUEST + 1)),
        (0, SYNC),
    )
    run(node, bus, lockstep=True)
    assert node.advances == [1000, 1000]
    assert bus.sent == [
        Frame(BOOT_UP + 1, b"\0"),
        Frame(AT_SYNC + 1, (1000).to_bytes(8, "little")),
        Frame(REPLY + 1),
        Frame(AT_SYNC + 1, (2000).to_bytes(8, "little")),
        Frame(OFF + 1, bytes(2)),
    ]


def fail(frame: Frame) -> list[Frame]:
    raise ZeroDivisionError


@pytest.mark.parametrize("lockstep", [False, True])
def test_failing_node_is_shut_down_and_the_bus_closed(
    lockstep: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    node, bus = ToyNode(), ScriptedBus((0, Frame(1)), NEVER_ASKED)
    monkeypatch.setattr(node, "receive", fail)
    with pytest.raises(ZeroDivisionError):
        run(node, bus, lockstep=lockstep)
    assert bus.sent[-1] == Frame(OFF + 1, bytes(2))
    assert bus.closed == 1


def test_dead_bus_is_reported_by_its_first_failure() -> None:
    node, bus = ToyNode(), ScriptedBus((0, SYNC), NEVER_ASKED)
    shut_down: list[Callable[[], list[Frame]]] = []

    def receive(frame: Frame) -> list[Frame]:
        bus.broken = True
        return [Frame(0x111)]

    def shutdown() -> list[Frame]:
        shut_down.append(shutdown)
        return [Frame(0x222)]

    node.receive, node.shutdown = receive, shutdown  # type: ignore[method-assign]
    with pytest.raises(BusError, match="broken at 111"):
        run(node, bus)
    assert len(shut_down) == 1
    assert bus.closed == 1
