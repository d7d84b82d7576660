"""A stimulator node that hears what a log has, at the times of the log."""

from __future__ import annotations

from collections import deque
from operator import itemgetter
from typing import Final

from smarttac_can.device.frame import Frame
from smarttac_can.device.nmt import NMTState
from smarttac_can.device.timer import NEVER
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.cia import SDO_TX_ID
from smarttac_can.replay.first_measurements import FirstMeasurements, Stamped
from smarttac_can.vocabulary.signals import TICK_US

LATE_US: Final = 20_000
"""A process that runs hears a frame, and acts on what is due, within this time."""
_STILL_US: Final = 100_000
"""One that says nothing may be held up for longer."""
_CREEP_US: Final = 0.1
"""By how much a period of SYNC may differ by two clocks: 100 ppm of a millisecond, more than quartz
does."""


class ReplayedNode:
    """A node, and the frames that it computes.

    A log does not say when the node heard a frame that another party sent. So each waits until
    something that the node sent then needs it, or until the node goes on for 20 ms without.

    Parameters
    ----------
    node
        Switched on now.
    time
        Time in the log in us at which its boot-up message came.
    lockstep
        Whether SYNC is its clock.

    Attributes
    ----------
    od
        Its object dictionary.
    """

    def __init__(self, node: StimulatorNode, time: int, *, lockstep: bool) -> None:
        self.od = node.od
        self._node = node
        self._clock = node.clock
        self._lockstep = lockstep
        self._offset = float(time)
        self._time = self._said = time
        self._waiting: deque[Stamped] = deque()
        self._computed: dict[int, deque[Stamped]] = {}
        self._first = FirstMeasurements(node.od)
        self._before: deque[tuple[int, dict[int, Frame]]] = deque()
        self._sdo = SDO_TX_ID + node.od.node_id
        self._put(node.start())

    def sends(self, frame: Frame) -> bool:
        """Whether a frame of the log is one of the node itself."""
        return frame.can_id in self._node.ids.sent and not frame.rtr

    @property
    def sync_id(self) -> int:
        """Identifier of SYNC, as the node is configured now."""
        return self._node.ids.sync

    def drives(self, frame: Frame) -> bool:
        """Whether a frame is a drive."""
        return self._first.is_drive(frame)

    def hear(self, time: int, frame: Frame) -> None:
        """Take a frame of somebody else."""
        self._waiting.append((time, frame))

    def go_on(self, time: int) -> None:
        """Let time pass, so that nothing is left undone for longer than a process may be late."""
        self._time = time
        done = max(self._said - LATE_US, time - _STILL_US)
        while self._waiting and self._waiting[0][0] < done:
            self._hear(*self._waiting.popleft())
        if not self._lockstep:
            self._pass_time(self._device_time(done))

    def answer(self, time: int, frame: Frame) -> Frame | None:
        """Return what the node computes for a frame that it sent; None if nothing.

        Of what it may have heard before, it hears as little as explains the frame.
        """
        if frame.can_id == self.sync_id and self._node.device.produces_sync:
            self._produce(time)
        self._said = time
        queue = self._computed.setdefault(frame.can_id, deque())
        if not queue and frame.can_id == self._sdo:
            self._put(self._node.segments(1))
        end = self._device_time(time + LATE_US)
        while not queue and not self._timed(frame):
            if self._first.open and self._first.is_drive(frame):
                self._await_first(frame)
            if self._waiting:
                self._hear(*self._waiting.popleft())
            elif self._lockstep or not self._expire(end):
                break
        if queue and (queue[0][1] == frame or not self._timed(frame)):
            return queue.popleft()[1]
        return frame if self._timed(frame) else self._node.device.unasked().get(frame.can_id)

    def overdue(self, age: int) -> Stamped | None:
        """Return a frame computed longer ago than an age in us that the log lacks, and when.

        In lockstep SYNC is the clock of that as well: a process may stand still for any time.
        """
        for queue in self._computed.values():
            if queue and queue[0][0] < self._now - age:
                return queue[0]
        return None

    @property
    def _now(self) -> int:
        return self._clock.now if self._lockstep else self._time

    def _timed(self, frame: Frame) -> bool:
        """Whether it is what a timer may have sent: when, the log knows better, but in lockstep.

        Such a frame waits for the urgent ones of the node, so it may be of a cycle before.
        """
        if self._lockstep:
            return False
        can_id = frame.can_id
        if self._node.device.unasked().get(can_id) == frame:
            return True
        return any(unasked.get(can_id) == frame for _, unasked in self._before)

    def _hear(self, time: int, frame: Frame) -> None:
        if self._lockstep:
            if frame.can_id == self.sync_id:
                self._put(self._node.advance(TICK_US))
            self._put(self._node.receive(frame))
            return
        self._pass_time(self._device_time(time))
        if self._first.hold(time, frame):
            return
        device = self._node.device
        drove = device.nmt_state is NMTState.OPERATIONAL
        frames = self._node.receive(frame)
        self._put(frames)
        if not drove and device.nmt_state is NMTState.OPERATIONAL:
            self._first.begin()
        if frames:
            self._before.append((time, device.unasked()))
            while self._before[0][0] < time - LATE_US:
                self._before.popleft()

    def _device_time(self, time: int) -> int:
        return round(time - self._offset)

    def _await_first(self, drive: Frame) -> None:
        """Put the first measurement, which the first drive tells, in its place among the rest."""
        others = [one for one in self._waiting if not self._first.hold(*one)]
        self._waiting = deque(sorted([*self._first.heard(drive), *others], key=itemgetter(0)))

    def _pass_time(self, now: int) -> None:
        """Move device time on, in us, but not beyond the next SYNC of its own."""
        now = min(now, self._node.device.sync_due - 1)
        while self._expire(now):
            pass
        self._clock.now = max(self._clock.now, now)

    def _expire(self, end: int) -> bool:
        """Let the next timer expire that is due up to a device time, if there is one."""
        clock = self._clock
        if clock.next_due > min(end, self._node.device.sync_due - 1):
            return False
        clock.now = max(clock.now, clock.next_due)
        self._act()
        return True

    def _produce(self, time: int) -> None:
        """Let the node produce a SYNC, when it is due or as late as the log has it.

        Its clock slowly follows the SYNCs of the log, which another clock may have stamped.
        """
        while self._waiting and not self._first.undecided:
            self._hear(*self._waiting.popleft())
        due = self._node.device.sync_due
        if due == NEVER:
            return
        late = time - self._offset - due
        self._offset += max(-_CREEP_US, min(late, _CREEP_US))
        self._pass_time(due - 1)
        self._clock.now = max(due, self._device_time(time))
        self._act()

    def _act(self) -> None:
        """Do what is due now; of what timers send the log knows better when they did."""
        frames = self._node.advance(0)
        unasked = self._node.device.unasked()
        self._put([frame for frame in frames if frame.can_id not in unasked])

    def _put(self, frames: list[Frame]) -> None:
        sent = self._node.ids.sent
        for frame in frames:
            if frame.can_id in sent:
                self._computed.setdefault(frame.can_id, deque()).append((self._now, frame))
