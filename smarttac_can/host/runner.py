"""Run a sans-IO node on a bus: in real time by the clock, or in lockstep by SYNC.

The loop in real time handles what is overdue, reads the bus, acts on due timers, transmits, and
waits. As long as the process gets processor time, whatever comes over the bus:

* device time is never more than 20 ms behind the clock, or the time of three frames if longer;
* if the process was late, frames that waited are handled for at most 10 ms before time goes on;
* nothing waits for a bus that takes no frames.
"""

from __future__ import annotations

import sys
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from time import monotonic_ns, sleep
from typing import Final, Protocol

from smarttac_can.canopen.bus.bus import Bus, BusError, QueueFullError
from smarttac_can.canopen.bus.node import HostedNode, is_overtaken
from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.port import Identifiers
from smarttac_can.host.outbox import Outbox
from smarttac_can.host.reconnecting_bus import ReconnectingBus
from smarttac_can.vocabulary.signals import TICK_US

_LATE_US: Final = 2000
"""A timer that is overdue by so many us shows that the process did not run: waiting frames may be
older than the timer."""
_CATCH_UP_US: Final = 9000
"""Longest time in us for which such a process handles frames before it acts on due timers."""
_READING_US: Final = 1000
"""Longest time in us for which frames are read without a break."""
_SLOWEST_US: Final = 5000
"""Longest time in us that a bus needs for a frame; a longer time is a pause of the process."""
_MOST_WAITING: Final = 256
"""Most frames that are read and not handled yet; then no more are read."""
_BEFORE: Final = 4
"""Most frames that a punctual process handles before it acts on due timers: the three of a
measurement, and another one."""
_HEARD_US: Final = 1000
"""Longest time in us for these frames, and for the frames between two cycles of a node whose cycles
take longer than a tick."""
_ENDLESS: Final = 1 << 30
_SENDING_US: Final = 2000
"""Longest time in us for which frames are handed over without a break."""
_SEGMENTS: Final = 8
"""Frames of an SDO transfer handed over before the bus is read again."""
_SEND_RETRY_US: Final = 200
_STOP_POLL_US: Final = 50_000
_FOLLOW_US: Final = 10_000
"""Time in us after which the observer is called when there is time."""
_PUNCTUAL_US: Final = 200
"""A wait that ends at most so many us late has seen each frame that came until then."""
_FOLLOWED_FRAMES: Final = 256
"""Frames in lockstep after which the observer is called, even without SYNC."""
_SPARE_US: Final = 500
"""Time in us before the next timer that is long enough for other work."""
_PARTING_US: Final = 100_000
_PASSED_OVER: Final = 100
"""Ignored frames of an identifier after which the bus is asked to drop it."""
_WORK_US: Final = 10_000
_WORK_SOON_US: Final = 8_000
"""Working time in us after which work of low priority waits for a rest at a suitable time."""
_REST_US: Final = 500
"""Least waiting time in us of a process per `_WORK_US`."""
_WAKING_US: Final = 20
"""A shorter wait is the duration of the call, and does not count as a rest."""
_SWITCH_S: Final = 2e-4
"""Longest time in s for which a thread keeps a node waiting; the default 5 ms are 5 cycles."""
_END_S: Final = 10.0
"""Longest time in s that a node in a thread takes to end."""


class Observer(Protocol):
    """What follows the state of a node for people."""

    def started(self) -> None:
        """Handle that the node has been switched on."""

    def follow(self) -> None:
        """Check the node: every 10 to 50 ms, when there is time, and at SYNC in lockstep."""

    def full(self, reason: QueueFullError) -> None:
        """Handle that the bus has begun to refuse urgent frames."""

    def stopped(self) -> None:
        """Handle that the node was shut down."""


class _Nobody:
    """The observer of a node that nobody follows."""

    def started(self) -> None: ...

    def follow(self) -> None: ...

    def full(self, reason: QueueFullError) -> None: ...

    def stopped(self) -> None: ...


_NOBODY: Final = _Nobody()


def run_node(
    node: HostedNode,
    bus: Bus,
    stop: Callable[[], bool],
    *,
    lockstep: bool = False,
    observer: Observer = _NOBODY,
    resting: bool = False,
    clock: Callable[[], int] = monotonic_ns,
    rest: Callable[[float], None] = sleep,
) -> None:
    """Start a node, run it until `stop` returns True, shut it down and close the bus.

    In real time, device time is set to that of the clock in us when a timer is due, and before each
    frame. In lockstep the node advances only by 1000 us just before each SYNC that it receives.

    Parameters
    ----------
    node
        Node to run; always shut down at the end, so that the plate is left at 0 V.
    bus
        Bus of the node; always closed at the end.
    stop
        Function called at least every 50 ms; True ends the run.
    lockstep
        Whether SYNC is the clock.
    observer
        Observer of the node.
    resting
        Whether the process waits for at least 0.5 ms in 10 ms, whatever comes. At a real-time
        priority no other process gets the processor before.
    clock, rest
        Function that returns monotonic time in ns, and function that waits for a time in s.

    Raises
    ------
    BusError
        If the bus fails and is not a `ReconnectingBus`.
    """
    run = _Run(
        node, bus, lockstep=lockstep, observer=observer, resting=resting, clock=clock, rest=rest
    )
    with closing(bus):
        try:
            run.begin()
            while not stop():
                try:
                    if lockstep:
                        run.follow_sync(stop)
                    else:
                        run.keep_pace(stop)
                except BusError as error:
                    run.forget()
                    _lose(bus, error)
            observer.follow()
        except BaseException:
            # Report the first failure, not that a failed bus refuses the last frames.
            with suppress(BusError):
                run.end()
            raise
        try:
            run.end()
        except BusError as error:
            _lose(bus, error)


def _lose(bus: Bus, error: BusError) -> None:
    """Give up a bus that reconnects; raise the error of any other bus."""
    if not isinstance(bus, ReconnectingBus):
        raise error
    bus.lose(error)


class _Run:
    """State of a running node: the node, its bus, and the frames between them."""

    def __init__(
        self,
        node: HostedNode,
        bus: Bus,
        *,
        lockstep: bool,
        observer: Observer,
        resting: bool,
        clock: Callable[[], int],
        rest: Callable[[float], None],
    ) -> None:
        self._node = node
        self._bus = bus
        self._lockstep = lockstep
        self._observer = observer
        self._clock = clock
        self._rest = rest
        self._resting = resting
        self._outbox = Outbox(node, bus, observer.full)
        self._ids = Identifiers()
        self._listened: frozenset[int] = frozenset()
        self._passed: Counter[int] = Counter()
        self._blocked: frozenset[int] = frozenset()
        self._waiting: deque[Frame] = deque()
        """Frames that were read and not handled yet."""
        self._more = False
        """Whether more frames may wait on the bus."""
        self._slow = 0
        """Longest time in us of a call of `Bus.read`."""
        self._flooded = False
        """Whether frames were left over when a timer was due; reset when the bus is empty."""
        self._silent = False
        """Whether the last wait ended punctually and without a frame."""
        self._epoch = clock() // 1000 - node.clock.now
        self._followed = self._busy_since = self._now()
        self._waited = 0

    def begin(self) -> None:
        """Switch the node on, and queue its first frames."""
        self._outbox.put(self._node.start())
        self._listen()
        self._observer.started()

    def keep_pace(self, stop: Callable[[], bool]) -> None:
        """Run the node by the clock."""
        timers = self._node.clock
        self._hand_over()
        now = self._now()
        while not stop():
            timers.now = now
            if timers.next_due <= now:
                self._transmit(self._node.overdue())
            waiting = len(self._waiting)
            if self._silent:
                self._silent = False
            elif not waiting or (waiting < _MOST_WAITING and not self._flooded):
                now = self._read(now)
            if self._waiting:
                now = self._drain(now)
            if timers.next_due <= now:
                now = self._act(now)
            if timers.next_due > now:
                now = self._go_on(now)
            if now - self._followed >= _STOP_POLL_US:
                now = self._follow()
            if self._resting and now - self._busy_since >= _WORK_US:
                now = self._rest_for(_REST_US - self._waited)

    def follow_sync(self, stop: Callable[[], bool]) -> None:
        """Run the node by SYNC; the clock is not read."""
        node, outbox, waiting = self._node, self._outbox, self._waiting
        frames_since = 0
        self._hand_over()
        while not stop():
            if not waiting:
                more = self._bus.read(waiting)
                if not waiting and not more:
                    self._observer.follow()
                    self._bus.wait(1e-6 * (_STOP_POLL_US if outbox.empty else _SEND_RETRY_US))
                    self._bus.read(waiting)
            self._hand_over()
            if waiting:
                frame = waiting.popleft()
                if frame.can_id not in self._listened:
                    self._pass_over(frame.can_id)
                else:
                    ticks = frame.can_id == self._ids.sync
                    if ticks:
                        self._transmit(node.advance(TICK_US))
                    self._transmit(node.receive(frame))
                    if ticks:
                        self._observer.follow()
            while outbox.empty and (frames := node.segments(_SEGMENTS)):
                self._transmit(frames)
            frames_since += 1
            if frames_since >= _FOLLOWED_FRAMES:
                frames_since = 0
                self._observer.follow()

    def forget(self) -> None:
        """Drop the frames read from a lost bus: they are outdated."""
        self._waiting.clear()
        self._more = self._flooded = self._silent = False
        if not self._lockstep:
            self._node.clock.now = self._now()

    def end(self) -> None:
        """Shut the node down, and wait up to 0.1 s until the bus has taken its frames."""
        try:
            if not self._lockstep:
                self._node.clock.now = self._now()
            self._transmit(self._node.shutdown())
            end = self._now() + _PARTING_US
            while not self._outbox.empty and self._now() < end:
                self._rest(_SEND_RETRY_US * 1e-6)
                self._hand_over()
        finally:
            self._observer.stopped()

    def _now(self) -> int:
        """Return the clock's time as device time in us."""
        return self._clock() // 1000 - self._epoch

    def _listen(self) -> None:
        self._ids = self._node.ids
        # In lockstep a node that waits for a node-ID needs SYNC as its time as well.
        heard = self._ids.heard | {self._ids.sync} if self._lockstep else self._ids.heard
        self._listened = heard
        if self._blocked & heard:
            self._blocked -= heard
            self._passed = Counter(dict.fromkeys(self._blocked, _PASSED_OVER))
            self._bus.block(self._blocked)

    def _pass_over(self, can_id: int) -> None:
        """Count an ignored frame; after 100 of an identifier ask the bus to drop them."""
        self._passed[can_id] += 1
        if self._passed[can_id] == _PASSED_OVER:
            self._blocked |= {can_id}
            self._bus.block(self._blocked)

    def _transmit(self, frames: list[Frame]) -> None:
        """Transmit frames of the node, after those that wait for the bus."""
        # First accept new identifiers: a commander may send its heartbeat right after the answer.
        if self._node.ids is not self._ids:
            self._listen()
        if not frames:
            return
        outbox = self._outbox
        if not outbox.empty:
            outbox.put(frames)
            self._hand_over()
            return
        end = self._clock() + 1000 * _SENDING_US if len(frames) > 1 else 0
        for at, frame in enumerate(frames):
            if at and self._clock() >= end:
                outbox.put(frames[at:])
                return
            try:
                self._bus.send(frame)
            except QueueFullError:
                outbox.put(frames[at:])
                return

    def _hand_over(self) -> None:
        """Hand over waiting frames until the bus refuses one or the time is up."""
        if self._outbox.empty:
            return
        end = self._now() + _SENDING_US
        while self._outbox.hand_over() and self._now() < end:
            pass

    def _read(self, now: int) -> int:
        """Read waiting frames for about 1 ms at most; return the time."""
        end = now + _READING_US
        due = self._node.clock.next_due
        if now < due < end:
            end = due
        self._slow = 0
        while True:
            self._more = self._bus.read(self._waiting)
            before, now = now, self._now()
            self._slow = max(self._slow, min(now - before, _SLOWEST_US))
            if not self._more and not self._waiting:
                self._flooded = False
            if not self._more or now >= end or len(self._waiting) >= _MOST_WAITING:
                return now

    def _drain(self, now: int) -> int:
        """Handle waiting frames before due timers, within bounds; return the time."""
        timers = self._node.clock
        overdue = now - timers.next_due
        if overdue < 0:
            return self._hear(now, min(timers.next_due, now + _HEARD_US), _ENDLESS)
        if self._flooded:
            # Endless frames, not a pause, have delayed the timer, so the timer comes first.
            return now
        if overdue >= _LATE_US:
            now = self._hear(now, now + _CATCH_UP_US, _ENDLESS)
        else:
            now = self._hear(now, now + _HEARD_US, _BEFORE)
            if now - timers.next_due >= _LATE_US and self._waiting:
                return self._drain(now)
        self._flooded = bool(self._waiting) or self._more
        return now

    def _hear(self, now: int, end: int, most: int) -> int:
        """Handle waiting frames, at least one, until a time in us; return the time."""
        waiting, timers = self._waiting, self._node.clock
        longest = 0
        while most:
            if not waiting:
                if not self._more:
                    break
                now = self._read(now)
                if not waiting:
                    break
            before = now
            frame = waiting.popleft()
            if frame.can_id in self._listened:
                most -= 1
                timers.now = now
                if timers.next_due <= now:
                    self._transmit(self._node.overdue())
                overtaken = waiting and is_overtaken(frame, waiting)
                node = self._node
                self._transmit(node.overtaken(frame) if overtaken else node.receive(frame))
            else:
                self._pass_over(frame.can_id)
            now = self._now()
            longest = max(longest, now - before)
            if now + longest + self._slow > end:
                break
        if not waiting and not self._more:
            self._flooded = False
        return now

    def _act(self, now: int) -> int:
        timers = self._node.clock
        timers.now = now
        self._transmit(self._node.advance(0))
        now = self._now()
        if timers.next_due <= now and (self._waiting or self._more):
            now = self._hear(now, now + _HEARD_US, _ENDLESS)
        return now

    def _go_on(self, now: int) -> int:
        """Transmit, do other work, or wait for the next frame; return the time."""
        timers = self._node.clock
        left = timers.next_due - now
        idle = not self._waiting and not self._more
        if not self._outbox.empty:
            self._hand_over()
            left = min(left, _SEND_RETRY_US)
        elif self._resting and now - self._busy_since >= _WORK_SOON_US:
            left = min(left, _REST_US - self._waited)
        elif frames := self._node.segments(_SEGMENTS):
            self._transmit(frames)
            return self._now()
        elif idle and left > _SPARE_US and now - self._followed >= _FOLLOW_US:
            before, now = now, self._follow()
            left -= now - before
        if not idle or left <= 0:
            return self._now()
        came = self._bus.wait(min(left, _STOP_POLL_US) * 1e-6)
        before, now = now, self._now()
        self._silent = not came and now - timers.next_due <= _PUNCTUAL_US
        if self._resting and now - before >= _WAKING_US:
            self._waited += now - before
            if self._waited >= _REST_US:
                self._busy_since, self._waited = now, 0
        return now

    def _follow(self) -> int:
        self._observer.follow()
        self._followed = now = self._now()
        return now

    def _rest_for(self, owed: int) -> int:
        self._rest(owed * 1e-6)
        self._busy_since, self._waited = self._now(), 0
        return self._busy_since


@contextmanager
def node_in_thread(node: HostedNode, bus: Bus, *, lockstep: bool = False) -> Iterator[None]:
    """Run a node until the block ends, and let the threads of this process switch more often.

    Parameters
    ----------
    node, bus, lockstep
        As for `run_node`, which closes the bus.

    Raises
    ------
    Exception
        At the end of the block: the error that ended the run.
    """
    stop = threading.Event()
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, _SWITCH_S))
    try:
        with ThreadPoolExecutor(max_workers=1, thread_name_prefix="node") as executor:
            running = executor.submit(run_node, node, bus, stop.is_set, lockstep=lockstep)
            try:
                yield
            finally:
                stop.set()
        running.result(timeout=_END_S)
    finally:
        sys.setswitchinterval(before)
