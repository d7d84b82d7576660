"""State changes, faults and heartbeats of a stimulator as a stream of events."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from queue import Empty, SimpleQueue
from time import monotonic
from typing import Final, Literal, NamedTuple, Self

from smarttac_can.bench.given import stays_in_process, within
from smarttac_can.bench.link import Link, Row
from smarttac_can.canopen.device.nmt import state_text
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.canopen.od import cia
from smarttac_can.host.process_signals import interrupt_waits
from smarttac_can.vocabulary.meanings import emergency_text, spoken
from smarttac_can.vocabulary.states import State, known_state, state_in

_STATUS: Final = "Statusword"
_LOOK_S: Final = 0.1
"""Period in s at which lost heartbeats are looked for."""
_MOST_S: Final = 604_800
_NONE: Final = -1
"""Replaces the NMT state of a node whose heartbeat is lost."""
_CYCLE_S: Final = 1e-3


class Event(NamedTuple):
    """A change of a stimulator or its plate node."""

    node_id: int
    """Node-ID of the node."""
    kind: Literal["state", "fault", "heartbeat"]
    """New state of the stimulator, emergency message of a node, or new NMT state."""
    text: str
    """State, text of the fault, NMT state in the heartbeat, or ``lost``."""
    state: State | None = None
    """State of the stimulator if `kind` is ``state``, else None."""


class Events:
    """Events during a ``with`` block, created by `Stimulator.events`.

    It only listens. Events during `Stimulator.run`, or while a script handles another event, are
    kept.

    Parameters
    ----------
    link
        Link to the stimulator.
    node_id
        Node-ID of the stimulator.
    """

    __reduce_ex__ = stays_in_process("a block of events")

    def __init__(self, link: Link, node_id: int) -> None:
        self._link = link
        self._node_id = node_id
        self._waiting: SimpleQueue[Event] = SimpleQueue()
        self._block: AbstractContextManager[None] | None = None
        self._nmt: dict[int, int] = {}
        self._lost: set[int] = set()

    def __enter__(self) -> Self:
        """Begin to receive.

        Raises
        ------
        BenchError
            If no TPDO of the stimulator maps the statusword.
        """
        source = self._link.source()
        carriers = [pdo for pdo in source.published if _STATUS in pdo.names]
        if not carriers:
            raise BenchError(
                f"no TPDO of node {self._node_id} maps the {_STATUS}, so a bench does not receive "
                "changes of the state: restore the default mapping"
            )
        self._clocked, self._carrier = source.clocked, carriers[0]
        self._state: State | None = state_in(self._link.read(_STATUS))
        self._block = self._link.frames(self._hear, every_cycle=False)
        self._block.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        """End receiving."""
        block, self._block = self._block, None
        assert block is not None
        block.__exit__(None, None, None)

    def within(self, seconds: float) -> Iterator[Event]:
        """Wait for a time, and yield events as they come, first those that are waiting.

        Parameters
        ----------
        seconds
            Time in s, 0 to 604800. In lockstep and in a simulation it is loop time, and this call
            runs the loop; otherwise it is time of the clock. 0 yields only waiting events.

        Raises
        ------
        ValueError
            If `seconds` is not a finite number within its bounds.
        BenchError
            Outside a ``with`` block; in lockstep and in a simulation, as `Stimulator.run`.
        """
        length = within("seconds", seconds, 0, _MOST_S, "s")
        if self._block is None:
            raise BenchError("events come only inside a with block")
        return self._wait(length) if self._clocked else self._run(length)

    def _wait(self, seconds: float) -> Iterator[Event]:
        end = monotonic() + seconds
        while True:
            left = end - monotonic()
            try:
                yield self._waiting.get(timeout=min(max(left, 0.0), _LOOK_S))
            except Empty:
                before, self._lost = self._lost, set(self._link.silent())
                for node_id in sorted(self._lost - before):
                    # So the next heartbeat is an event as well.
                    self._nmt[node_id] = _NONE
                    self._waiting.put(Event(node_id, "heartbeat", "lost"))
                if left <= 0 and self._waiting.empty():
                    return

    def _run(self, seconds: float) -> Iterator[Event]:
        left = round(seconds / _CYCLE_S)
        while True:
            while not self._waiting.empty():
                yield self._waiting.get()
            if left <= 0:
                return
            rows: list[Row] = []
            with interrupt_waits() as interrupted:
                self._link.run(left, rows, lambda: not self._waiting.empty() or interrupted())
                if interrupted():
                    raise KeyboardInterrupt
            left -= max(len(rows), 1)

    def _hear(self, can_id: int, data: bytes) -> None:
        service, node_id = can_id & ~cia.LAST_NODE_ID, can_id & cia.LAST_NODE_ID
        if can_id == self._carrier.can_id:
            layout = self._carrier.layout
            if len(data) == layout.size:
                values = dict(zip(self._carrier.names, layout.unpack(data), strict=True))
                state = known_state(values[_STATUS])
                before, self._state = self._state, state
                if state is not None and state is not before:
                    self._waiting.put(Event(self._node_id, "state", spoken(state), state))
        elif service == cia.EMCY_ID and (code := int.from_bytes(data[:2], "little")):
            self._waiting.put(Event(node_id, "fault", emergency_text(code)))
        elif service == cia.HEARTBEAT_ID and data:
            shown = data[0] & cia.LAST_NODE_ID
            if self._nmt.get(node_id, shown) != shown or not shown:  # a boot-up is always an event
                self._waiting.put(Event(node_id, "heartbeat", state_text(shown)))
            self._nmt[node_id] = shown
