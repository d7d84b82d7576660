"""Run a sans-IO node on a bus: in real time by the clock, or in lockstep by SYNC.

The promise in real time, for a process that runs and whatever comes over the bus: device time is
never more than 20 ms behind the clock, or the time that three frames take if that is longer; frames
that were there when the process came late are heard for at most 10 ms before time goes on; and
nothing waits for a bus that takes no frames.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, suppress
from time import monotonic_ns, sleep, thread_time_ns
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.device.port import Identifiers
from smarttac_can.host.bus import Bus, BusError, QueueFullError
from smarttac_can.host.node import HostedNode
from smarttac_can.host.outbox import Outbox
from smarttac_can.host.processor_share import ProcessorShare
from smarttac_can.host.read_ahead import LATE_US, ReadAhead
from smarttac_can.vocabulary.signals import TICK_US

_CATCH_UP_US: Final = 9000
"""For how long in us a process that came late hears frames before it acts on what is due."""
_BEFORE: Final = 4
"""Frames that wait and are heard before what is due, at most, since a punctual process has heard
what came before it: those of a measurement, and another."""
_HEARD_US: Final = 1000
"""For how long in us they are, and others between two cycles that take longer than a tick."""
_SENDING_US: Final = 2000
"""Longest time in us for which frames are handed over in a row."""
_SEGMENTS: Final = 8
"""Frames of an SDO transfer handed over before the bus is heard again."""
_SEND_RETRY_US: Final = 200
_STOP_POLL_US: Final = 50_000
_SPARE_US: Final = 500
"""Time in us before the next timer that is long enough for other work."""
_FAREWELL_US: Final = 100_000


def _nothing() -> None:
    """Do nothing: the default for work to do when there is time."""


def _not_told(_reason: QueueFullError) -> None:
    """Do nothing: the default for being told of a full transmit queue."""


def run_node(
    node: HostedNode,
    bus: Bus,
    stop: Callable[[], bool],
    *,
    lockstep: bool = False,
    full: Callable[[QueueFullError], None] = _not_told,
    spare: Callable[[], None] = _nothing,
    clock: Callable[[], int] = monotonic_ns,
    rest: Callable[[float], None] = sleep,
    worked: Callable[[], int] = thread_time_ns,
) -> None:
    """Start a node, run it until told to stop, shut it down and close the bus.

    In real time, device time is the clock's, in us: when a timer is due, and before each frame. In
    lockstep the node advances by 1000 us just before each SYNC it receives, and by nothing else.

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
    full
        Told when the bus has begun not to take what the loop needs.
    spare
        Called in real time when there is nothing to do for half a millisecond at least.
    clock, rest, worked
        Monotonic time in ns, a wait of so many s, and the processor time of this thread in ns.

    Raises
    ------
    BusError
        If the bus carries no more frames.
    """
    run = _Run(node, bus, lockstep, full, clock, ProcessorShare(clock, worked, rest))
    with closing(bus):
        try:
            run.say(node.start())
            if lockstep:
                run.follow_sync(stop)
            else:
                run.keep_pace(stop, spare)
        except BaseException:
            # The first failure is the one to report, not that a dead bus refuses the farewell.
            with suppress(BusError):
                run.farewell()
            raise
        run.farewell()


class _Run:
    """A node, its bus, and what is between them."""

    def __init__(
        self,
        node: HostedNode,
        bus: Bus,
        lockstep: bool,
        full: Callable[[QueueFullError], None],
        clock: Callable[[], int],
        share: ProcessorShare,
    ) -> None:
        self._node = node
        self._bus = bus
        self._lockstep = lockstep
        self._outbox = Outbox(node, bus, full)
        self._inbox = ReadAhead(bus, clock)
        self._clock = clock
        self._ids = Identifiers()
        self._epoch = clock() // 1000 - node.clock.now
        self._share = share
        self._flooded = False
        self._slow = 0

    def say(self, frames: list[Frame]) -> None:
        """Put frames of the node on the bus, and listen to what it listens to from now on."""
        # Before the answer: who is told that it is watched may send its first heartbeat at once.
        if self._node.ids is not self._ids:
            self._ids = self._node.ids
            # In lockstep SYNC is the time of a node that waits for a node-ID, too.
            heard = self._ids.heard | {self._ids.sync} if self._lockstep else self._ids.heard
            self._inbox.listen_to(heard)
        if frames:
            self._outbox.put(frames)
            self._send()

    def keep_pace(self, stop: Callable[[], bool], spare: Callable[[], None]) -> None:
        """Follow the clock."""
        timers = self._node.clock
        outbox = self._outbox
        while not stop():
            now = self._now()
            left = timers.next_due - now
            if left <= -LATE_US and not self._flooded:
                self._catch_up()
            elif left <= 0:
                if not self._flooded:
                    self._hear_before(now)
                    now = self._now()
                    if timers.next_due <= now - LATE_US:
                        continue
                timers.now = now
                self.say(self._node.advance(0))
                if timers.next_due <= self._now():
                    self._hear(self._now() + _HEARD_US)
                    self._share.rest_if_owed()
            else:
                if not outbox.empty:
                    timers.now = now
                    self._send()
                    left = min(left, _SEND_RETRY_US)
                elif owed := self._share.owed():
                    left = min(left, owed)
                elif self._stream():
                    left = 0
                elif left > _SPARE_US:
                    spare()
                self._listen(min(left, _STOP_POLL_US))

    def follow_sync(self, stop: Callable[[], bool]) -> None:
        """Follow SYNC; the clock is only asked how long to wait for a frame."""
        node = self._node
        outbox = self._outbox
        while not stop():
            wait_us = _STOP_POLL_US if outbox.empty else _SEND_RETRY_US
            frame = self._bus.receive(wait_us * 1e-6)
            self._send()
            if frame is not None:
                if frame.can_id == self._ids.sync:
                    self.say(node.advance(TICK_US))
                self.say(node.receive(frame))
            while outbox.empty and self._stream():
                pass

    def farewell(self) -> None:
        """Shut the node down; a bus that takes no frames has 0.1 s to do so."""
        self.say(self._node.shutdown())
        end = self._now() + _FAREWELL_US
        while not self._outbox.empty and self._now() < end:
            self._share.rest(_SEND_RETRY_US * 1e-6)
            self._send()

    def _send(self) -> None:
        """Hand over what waits, as long as the bus takes it and it does not take long."""
        end = self._now() + _SENDING_US
        while self._outbox.hand_over() and self._now() < end:
            pass

    def _stream(self) -> bool:
        """Hand over some frames of transfers that go on as fast as the bus takes them, if any."""
        frames = self._node.segments(_SEGMENTS)
        self.say(frames)
        return bool(frames)

    def _now(self) -> int:
        """Return the clock's time as device time in us."""
        return self._clock() // 1000 - self._epoch

    def _listen(self, wait_us: int) -> None:
        """Hear the next frame, or wait until something is due."""
        frame = self._inbox.receive(0.0)
        if frame is None:
            # A frame that comes before the wait is over does not tell whether there was one.
            self._flooded = False
            if wait_us == 0:
                return
            before = self._clock()
            frame = self._inbox.receive(wait_us * 1e-6)
            self._share.waited(self._clock() - before)
        if frame is not None and self._inbox.late:
            self._act_overdue(self._now())
            self._inbox.put_back(frame)
            self._read_ahead()
            return
        if frame is not None:
            self._take(frame)
        self._share.rest_if_owed()

    def _act_overdue(self, now: int) -> None:
        """Have the node act on what must not wait for a frame."""
        timers = self._node.clock
        timers.now = now
        if timers.next_due <= now:
            self.say(self._node.overdue())

    def _take(self, frame: Frame) -> None:
        """Have the node hear a frame; what must not wait for one comes before it."""
        self._act_overdue(self._now())
        if frame.can_id == self._ids.sync:
            self._inbox.look_behind()
            self._act_overdue(self._now())
        overtaken = self._inbox.overtaken(frame)
        self.say(self._node.overtaken(frame) if overtaken else self._node.receive(frame))

    def _read_ahead(self) -> None:
        """Read the frames that wait, and note what the bus took for one at most."""
        self._slow = self._inbox.read() // 1000

    def _catch_up(self) -> None:
        """Hear what came meanwhile before what is due without it."""
        now = self._now()
        self._act_overdue(now)
        self._read_ahead()
        self._hear(now + _CATCH_UP_US)
        self._node.clock.now = self._now()
        self.say(self._node.advance(0))
        self._share.rest_if_owed()

    def _hear_before(self, now: int) -> None:
        """Hear what waits before what is due, but for what must not wait."""
        self._act_overdue(now)
        end = now + _HEARD_US
        for _ in range(_BEFORE):
            frame = self._inbox.receive(0.0, (end - now) * 1e-6)
            if frame is None:
                return
            self._take(frame)
            now = self._now()
            if now >= end:
                return
        # More may wait; what is due next does not wait for those, too.
        self._flooded = True

    def _hear(self, end: int) -> None:
        """Hear frames that are there, one at least, and not beyond a time in us."""
        now = self._now()
        # What was read ahead comes at once, and does not tell what those behind it take.
        slow, self._slow = self._slow, 0
        longest = 0
        while True:
            frame = self._inbox.receive(0.0, (end - now) * 1e-6)
            if frame is None:
                self._flooded = False
                return
            before = now
            self._take(frame)
            now = self._now()
            longest = max(longest, now - before)
            if now + longest + slow > end:
                break
        # Without an end to the frames it is not a pause that makes it late, and time comes first.
        self._flooded = True
