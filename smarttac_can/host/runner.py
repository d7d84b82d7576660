"""Run a sans-IO node on a bus: in real time by the clock, or in lockstep by SYNC."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import closing, suppress
from time import monotonic_ns

from smarttac_can.device.frame import Frame
from smarttac_can.host.bus import Bus, BusError
from smarttac_can.host.node import Node
from smarttac_can.nodes.loop_period import TICK_US
from smarttac_can.od.cia import SYNC_ID

_TICK_NS = TICK_US * 1000
_STOP_POLL_S = 0.05
_HEARD_PER_TICK = 8
"""Frames heard between two ticks even by a node that is late: those of the loop, and SDO."""
_SEGMENTS = 8


def run_node(
    node: Node,
    bus: Bus,
    stop: Callable[[], bool],
    *,
    lockstep: bool = False,
    sync_id: int = SYNC_ID,
    clock: Callable[[], int] = monotonic_ns,
) -> None:
    """Start a node, run it until told to stop, shut it down and close the bus.

    In real time the node advances by ticks of 1000 us as the clock passes them. Whatever is late by
    n whole ticks is made up in one call of `advance`, after ``node.missed(n)`` if the node counts
    its missed deadlines.

    In lockstep the node advances by 1000 us just before each SYNC it receives, and by nothing else.

    Parameters
    ----------
    node
        The node; shut down on every way out, so that the plate is left at 0 V.
    bus
        Belongs to the run: closed on every way out.
    stop
        Asked at least every 50 ms.
    lockstep
        Whether SYNC is the clock.
    sync_id
        COB-ID of that SYNC.
    clock
        Monotonic time in ns.

    Raises
    ------
    BusError
        If the bus carries no more frames.
    """
    with closing(bus):
        try:
            _send(bus, node.start())
            if lockstep:
                _follow_sync(node, bus, stop, sync_id)
            else:
                _keep_pace(node, bus, stop, clock)
        except BaseException:
            # The first failure is the one to report, not that a dead bus refuses the farewell.
            with suppress(BusError):
                _send(bus, node.shutdown())
            raise
        _send(bus, node.shutdown())


def _follow_sync(node: Node, bus: Bus, stop: Callable[[], bool], sync_id: int) -> None:
    while not stop():
        frame = bus.receive(_STOP_POLL_S)
        if frame is None:
            continue
        if frame.can_id == sync_id:
            _send(bus, node.advance(TICK_US))
        _hear(bus, node, frame)


def _keep_pace(node: Node, bus: Bus, stop: Callable[[], bool], clock: Callable[[], int]) -> None:
    # Only a node that is paced by a clock has deadlines to miss, so counting them is optional.
    count_missed: Callable[[int], None] | None = getattr(node, "missed", None)
    deadline = clock() + _TICK_NS
    heard, silent = 0, True
    while not stop():
        left = deadline - clock()
        missed = -left // _TICK_NS
        # What piled up while the node was late is heard before its own deadlines run out.
        if left <= 0 and (silent or heard >= _HEARD_PER_TICK * (missed + 1)):
            if missed and count_missed is not None:
                count_missed(missed)
            _send(bus, node.advance((missed + 1) * TICK_US))
            deadline += (missed + 1) * _TICK_NS
            heard, silent = 0, False
            continue
        frame = bus.receive(max(left, 0) * 1e-9)
        silent = frame is None
        if frame is not None:
            heard += 1
            _hear(bus, node, frame)


def _hear(bus: Bus, node: Node, frame: Frame) -> None:
    _send(bus, node.receive(frame))
    while frames := node.segments(_SEGMENTS):
        _send(bus, frames)


def _send(bus: Bus, frames: Iterable[Frame]) -> None:
    for frame in frames:
        bus.send(frame)
