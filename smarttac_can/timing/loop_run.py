"""A run of the 1 kHz loop on a bus of sockets, timed by who only listens."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Any, Final

from smarttac_can.bench.simulation import PLATE_ID, plate_od, stimulator_od
from smarttac_can.bench.stimulator import Stimulator
from smarttac_can.master.errors import BenchError
from smarttac_can.timing.loop_processes import (
    listening,
    node_process,
    require_free,
    require_quiet,
)
from smarttac_can.timing.loop_timing import LoopTiming
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.states import State

COF: Final = 0.35
"""Friction that a timed run regulates."""
_POLL_S: Final = 0.1
_TRIES: Final = 5


@dataclass(frozen=True)
class LoopRun:
    """Outcome of a timed run of the loop."""

    timing: LoopTiming
    ran: bool
    """Whether it ever was in RUNNING."""
    state: State | None
    """State of the stimulator at the end; None if it did not say."""
    message: str
    """Why it did not run, or not to the end; empty if it did, or was not to."""
    refused: tuple[str, ...]
    """What the system refused its processes of their real-time priority, a line each."""


def regulate_friction(bench: Stimulator) -> None:
    """Start a run in mode friction, with a finger that strokes, and fail as `Stimulator` does."""
    bench.disarm()
    bench.reset_fault()
    bench.finger.stroke(2, force=0.5, speed=50.0)
    bench.start_run()
    bench.tare()
    bench.cof = COF
    bench.mode = Mode.FRICTION


def measure_loop(
    bus: Mapping[str, Any],
    *,
    plate_node: int | None,
    realtime: int | None,
    seconds: float,
    stop: Callable[[], bool],
    progress: Callable[[float, LoopTiming], None],
) -> LoopRun:
    """Start a stimulator, and its plate unless it is there; time the loop; end what was started.

    Parameters
    ----------
    bus
        Options of `can.Bus`.
    plate_node
        Node-ID of a plate that is there already, which stays at 0 V; None simulates one, with a
        finger, and regulates its friction.
    realtime
        SCHED_FIFO priority of the processes; None without.
    seconds
        How long to measure.
    stop
        Ends it early; asked ten times a second.
    progress
        Called as often with the seconds that have passed and what there is until now.

    Raises
    ------
    BenchError
        If a process ends, a node does not answer, or another loop runs on the bus, or a node with
        the node-ID of one that would be started.
    BusError
        If the bus cannot be opened, or has no time stamps.
    """
    require_free(bus, stimulator_od(), *([plate_od()] if plate_node is None else []))
    require_quiet(bus)
    plate_id = PLATE_ID if plate_node is None else plate_node
    commands: list[tuple[str, ...]] = [("node", "--plate-node", str(plate_id), "--produce-sync")]
    if plate_node is None:
        commands.insert(0, ("plate",))
    with ExitStack() as stack:
        nodes = [stack.enter_context(node_process(each, bus, realtime)) for each in commands]
        bench = stack.enter_context(_connected(plate_id, bus))
        reason = _try_to_run(bench) if plate_node is None else ""
        timing = LoopTiming(plate_od(plate_id))
        with listening(bus, timing.can_ids, timing.feed):
            start = monotonic()
            while not stop() and (left := start + seconds - monotonic()) > 0:
                sleep(min(left, _POLL_S))
                for node in nodes:
                    node.require_alive()
                progress(monotonic() - start, timing)
        refused = tuple(dict.fromkeys(line for node in nodes for line in node.refused))
        return LoopRun(timing, plate_node is None and not reason, *_end(bench, reason), refused)


@contextmanager
def _connected(plate_id: int, bus: Mapping[str, Any]) -> Iterator[Stimulator]:
    bench = Stimulator.connect(plate_node_id=plate_id, **bus)
    try:
        yield bench
    finally:
        # It need not answer any more: the nodes end next, which leaves 0 V as well.
        with suppress(BenchError), bench:
            pass


def _try_to_run(bench: Stimulator) -> str:
    """Regulate friction, at the first try or a later one; return what is wrong with the last."""
    reason = ""
    for _ in range(_TRIES):
        try:
            regulate_friction(bench)
        except BenchError as error:
            reason = str(error)
        else:
            return ""
    return reason


def _end(bench: Stimulator, reason: str) -> tuple[State | None, str]:
    """Return the state at the end, and why it is not RUNNING."""
    try:
        return bench.state, reason or bench.message
    except BenchError as error:
        return None, str(error)
