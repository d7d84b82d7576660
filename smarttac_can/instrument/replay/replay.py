"""Replay of a log of frames against a stimulator that receives them; no clock, no file.

What a log proves
-----------------
A log has what the bus carried, in its order. It does not have the clock of the node, nor what the
node knew before its boot-up message, nor what an operating system did to its process. So a replay
takes nothing from time stamps that the frames do not say themselves:

* **SYNC is the clock.** Each SYNC advances the recomputed node by one tick, in lockstep and in real
  time, whoever produces it. Time passes beyond the last SYNC only where a frame of the
  node shows that it did.
* **A frame of another node waits** until a frame that the node has sent needs it. Frames of others
  are received in the order of the log, and before a SYNC of the node itself only if the node has
  answered them before it, or has sent 100 SYNCs since and owes no answer.
* **A drive names its tick.** It answers the measurement of that tick. After a start the first drive
  tells which measurement the node received first; from then on each one has to be answered.
* **A frame that a timer sends** has the values of a recent cycle. Which cycle, and when, is decided
  by the clock of the node.
* **Missed deadlines** are what the node says that it has counted.

In lockstep the node has no clock but SYNC, and its bench waits for every answer. Nothing is left to
decide there, so each frame is compared in its order, and each one that is computed has to be in the
log before the next SYNC but one.

What cannot be judged is not a difference, and not the same. It is reported as `Unjudged`, up to the
next boot-up message: what the node sent before the first one; what follows a fault that only the
clock of the node decides, where log and replay do not agree on it; a node that sends nothing any
more though it owes an answer or a heartbeat; a node that ends at 0 V without all the frames of a
shutdown.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from smarttac_can.canopen.device.frame import Frame
from smarttac_can.canopen.device.mapping import Direction
from smarttac_can.canopen.device.nmt import NMTState
from smarttac_can.canopen.device.port import NEVER
from smarttac_can.canopen.od import cia
from smarttac_can.canopen.od.cia import EmergencyCode, NMTCommand
from smarttac_can.canopen.od.dictionary import ObjectDictionary
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode
from smarttac_can.instrument.replay.difference import INITIATED, Difference, difference, mapped
from smarttac_can.vocabulary.faults import FaultCode
from smarttac_can.vocabulary.signals import DRIVE_TPDO, MEASUREMENT_RPDOS, TICK_US

_RESETS: Final = (NMTCommand.RESET_NODE, NMTCommand.RESET_COMMUNICATION)
_LOOK_US: Final = 100_000
"""Time in us of the log between two searches for frames that are missing."""
_LACKING_TICKS: Final = 100
"""Ticks after which a computed frame that is not in the log counts as missing."""
_BACKWARDS_US: Final = 1_000_000
"""Larger steps back in time are errors; frames that overtake each other differ by much less."""
_BOOTING_US: Final = 20_000
"""Time in us before a boot-up message in which a node that was reset may have queued frames."""
_MOST_WAITING: Final = 1000
"""Most frames of others that wait, if none of them has to be answered; bounds the memory."""
_MOST_SAMPLES: Final = 100
"""Most cycles by which a frame that a timer sends may be late."""
_SILENT_US: Final = 1_000_000
"""Time in us of silence after which the rest is not judged; a process may pause for less."""
_SILENT_HEARTBEATS: Final = 2
"""Heartbeat periods without any frame after which a node is silent."""
_BY_CLOCK: Final = frozenset(
    (
        FaultCode.MISSED_TIME,
        FaultCode.TRANSMIT_QUEUE,
        FaultCode.HEARTBEAT_LOST,
        FaultCode.BUS_OFF,
        FaultCode.SYNC_LOST,
        FaultCode.SYNC_IRREGULAR,
        FaultCode.MEASUREMENT_LOST,
        FaultCode.SETPOINT_LOST,
        EmergencyCode.ERROR_CONTROL,
        EmergencyCode.BUS_OFF_RECOVERED,
        EmergencyCode.RPDO_TIME_OUT,
    )
)
"""Emergencies that the clock of the node, its process or its CAN controller decides."""
_MISSED: Final = "Cycle.Missed deadlines"
_TICKS: Final = 1 << 8
"""Modulus of the tick in a drive."""
Stamped = tuple[int, Frame]
"""A frame with a time in us."""


class Unjudged(NamedTuple):
    """A part of a log that a replay cannot judge."""

    begun_s: float
    """Time in s of its begin, since the first frame of the log."""
    ended_s: float
    """Time in s of its end."""
    frames: int
    """Number of frames of the node in it."""
    why: str

    def __str__(self) -> str:
        """Return the part in one line."""
        return f"{self.begun_s:.3f} s to {self.ended_s:.3f} s, {self.why}"


class Replayed(NamedTuple):
    """Extent of a comparison."""

    frames: int
    """Number of frames in the log."""
    compared: int
    """Number of frames of the node that were recomputed and are equal."""
    drives: int
    """Number of drives among them, one per cycle."""
    begun_s: float
    """Time in s of the first boot-up message, since the first frame of the log."""
    ended_s: float
    """Time in s of the last frame."""
    power_ons: int
    """How often the node was switched on."""
    unjudged: tuple[Unjudged, ...]
    """Parts that could not be judged; empty if all frames of the node were recomputed."""

    @property
    def unjudged_share(self) -> float:
        """Share of the time of the log that could not be judged, 0..1."""
        lost = sum(part.ended_s - part.begun_s for part in self.unjudged)
        return lost / self.ended_s if self.ended_s else float(bool(self.unjudged))


class DifferenceError(ValueError):
    """A log differs from its replay.

    Attributes
    ----------
    difference
        First difference.
    so_far
        Extent of the comparison before it.
    """

    def __init__(self, difference: Difference, so_far: Replayed) -> None:
        super().__init__(str(difference))
        self.difference = difference
        self.so_far = so_far


class Replay:
    """Compares the frames of a log, given one after the other.

    The comparison begins with the boot-up message of the node: from then on the log holds
    everything that the node received.

    Parameters
    ----------
    power_on
        Function that makes the node as its process did.
    node_id
        Node-ID of the node.
    lockstep
        Whether SYNC was the clock of the node.
    """

    def __init__(
        self, power_on: Callable[[], StimulatorNode], node_id: int, *, lockstep: bool
    ) -> None:
        self._power_on = power_on
        self._node_id = node_id
        self._lockstep = lockstep
        self._boot_up = Frame(cia.HEARTBEAT_ID + node_id, cia.BOOT_UP)
        self._node: ReplayedNode | None = None
        self._sent = ReplayedNode(power_on(), 0, lockstep=lockstep).sent
        self._keeps = False
        self._queued: deque[Stamped] | None = None
        self._sync = False
        self._before_sync: DifferenceError | None = None
        self._shutdown: DifferenceError | None = None
        self._shutdown_at = 0
        self._parts: list[Unjudged] = []
        self._why = ""
        self._since = self._unjudged = 0
        self._first = self._time = self._looked = self._begun = 0
        self._frames = self._compared = self._drives = self._power_ons = 0

    def take(self, time: int, frame: Frame) -> None:
        """Handle the next frame of the log, with its time stamp in us.

        Raises
        ------
        DifferenceError
            If the node sent the frame and computes another one or none, or the log lacks a frame.
        ValueError
            If the time runs backwards.
        """
        if not self._frames:
            self._first = self._time = self._since = time
        elif time < self._time - _BACKWARDS_US:
            raise ValueError(
                f"time runs backwards after frame {self._frames}, at {time * 1e-6:.6f}"
            )
        self._frames += 1
        self._time = time = max(time, self._time)
        node = self._node
        if node is None:
            self._await_boot_up(frame)
        elif frame == self._boot_up and not node.boots:
            self._end_life(node)
            self._switch_on()
        elif node.sends(frame):
            self._compare(node, frame)
        else:
            node.hear(time, frame)
        if self._node is not None:
            self._look(self._node, frame)

    def _look(self, node: ReplayedNode, frame: Frame) -> None:
        """Look for SYNC, and now and then for frames that the log lacks."""
        self._sync = self._sync or frame.can_id == node.sync_id
        if self._sync and self._before_sync is not None:
            raise self._before_sync
        if self._time >= self._looked + _LOOK_US:
            self._looked = self._time
            self._require_none_lacking(node, _LACKING_TICKS)
            self._require_frames(node, _SILENT_US)

    def end(self) -> Replayed:
        """Return the extent of the comparison, at the end of the log.

        Raises
        ------
        DifferenceError
            If the log lacks a frame.
        ValueError
            If no drive was compared; the message says what the log lacks.
        """
        node_id = self._node_id
        if not self._frames:
            raise ValueError("the log is empty: there is no frame in it")
        if not self._power_ons:
            raise ValueError(
                f"no boot-up message of node {node_id}: what the controllers knew before is not in "
                f"a log, so begin it before node {node_id} is switched on, or have it reset (NMT "
                "reset node) while it does not drive"
            )
        if self._node is not None:
            self._end_life(self._node)
        self._close()
        if not self._drives:
            if self._parts and self._parts[-1].begun_s >= self._seconds(self._begun):
                raise ValueError(f"no drive of node {node_id} could be judged: {self._parts[-1]}")
            raise ValueError(
                f"no drive of node {node_id} after its boot-up message: a replay needs SYNC, the "
                "measurements of the plate node, and the drives"
            )
        if self._before_sync is not None:
            raise self._before_sync
        return self._so_far()

    def _so_far(self) -> Replayed:
        return Replayed(
            self._frames,
            self._compared,
            self._drives,
            self._seconds(self._begun),
            self._seconds(self._time),
            self._power_ons,
            tuple(self._parts),
        )

    def _seconds(self, time: int) -> float:
        return (time - self._first) * 1e-6

    def _await_boot_up(self, frame: Frame) -> None:
        """Begin with a boot-up, except after a communication reset, which keeps the state."""
        self._unjudged += frame.can_id in self._sent and not frame.rtr and frame != self._boot_up
        if frame == self._boot_up:
            if not self._keeps:
                self._close()
                self._switch_on()
                self._hear_queued()
            self._keeps = False
        elif (command := reset_command(frame, self._node_id)) is not None:
            self._keeps = command == NMTCommand.RESET_COMMUNICATION
            self._queued = deque() if command == NMTCommand.RESET_NODE else None
        elif self._queued is not None:
            self._queued.append((self._time, frame))
            while self._queued[0][0] < self._time - _BOOTING_US:
                self._queued.popleft()

    def _hear_queued(self) -> None:
        """Receive the frames after the reset: they waited until the node had booted."""
        node = self._node
        assert node is not None
        for time, frame in self._queued or ():
            if time >= self._time - _BOOTING_US and not node.sends(frame):
                node.hear(self._time, frame)
        self._queued = None

    def _switch_on(self) -> None:
        if not self._power_ons:
            self._begun = self._time
        self._power_ons += 1
        self._node = node = ReplayedNode(self._power_on(), self._time, lockstep=self._lockstep)
        self._compare(node, self._boot_up)

    def _compare(self, node: ReplayedNode, frame: Frame) -> None:
        computed = node.answer(self._time, frame)
        if computed == frame:
            self._compared += 1
            self._drives += node.drives(frame)
            return
        found = self._differs(node, frame, computed)
        if self._shutdown is not None:
            raise self._shutdown
        if computed is None and node.shuts_down(frame):
            self._shutdown, self._shutdown_at = found, self._time
            self._compared += 1
            self._drives += 1
        elif node.clock_decides(frame):
            self._give_up("after a fault that only the clock of the node decides", self._time, 1)
        elif not self._sync:
            # Without any SYNC the log is not one of a loop, which `end` reports instead.
            self._before_sync = self._before_sync or found
        else:
            raise found

    def _require_none_lacking(self, node: ReplayedNode, ticks: int) -> None:
        lacking = node.overdue(ticks)
        if lacking is None or self._shutdown is not None:
            return
        if node.clock_decides(lacking):
            self._give_up("after a fault that only the clock of the node decides", self._time)
        else:
            raise self._differs(node, None, lacking)

    def _require_frames(self, node: ReplayedNode, least: int) -> None:
        """Give up if the node has been silent for so many us."""
        why, since = node.silence(self._time)
        if why and self._node is not None and self._shutdown is None and self._time - since > least:
            self._give_up(why, since)

    def _end_life(self, node: ReplayedNode) -> None:
        """Judge the end of a node: a shutdown, a silence, or the end of the log."""
        if self._shutdown is not None:
            if not node.is_shut_down:
                why = f"node {self._node_id} ends at 0 V without all the frames of a shutdown"
                self._give_up(why, self._shutdown_at)
        else:
            node.end()
            self._require_none_lacking(node, node.patience)
            self._require_frames(node, 0)
        self._node = self._shutdown = None
        self._close()

    def _give_up(self, why: str, since: int, frames: int = 0) -> None:
        """Judge nothing until the next boot-up message."""
        assert self._node is not None
        self._sent = self._node.sent
        self._node = self._shutdown = None
        self._why, self._since, self._unjudged = why, since, frames

    def _close(self) -> None:
        """End the part of the log that is not judged, if there is one."""
        begun, ended = self._seconds(self._since), self._seconds(self._time)
        if self._why or self._unjudged:
            why = self._why or f"before the boot-up message of node {self._node_id}"
            self._parts.append(Unjudged(begun, ended, self._unjudged, why))
        self._why, self._unjudged = "", 0

    def _differs(
        self, node: ReplayedNode, recorded: Frame | None, computed: Frame | None
    ) -> DifferenceError:
        found = difference(node.od, self._frames, self._seconds(self._time), recorded, computed)
        return DifferenceError(found, self._so_far())


def reset_command(frame: Frame, node_id: int) -> int | None:
    """Return the command of an NMT frame that resets a node; None for other frames."""
    if frame.can_id != cia.NMT_ID or len(frame.data) != len(("command", "node-ID")):
        return None
    command, addressed = frame.data
    return command if command in _RESETS and addressed in (0, node_id) else None


class ReplayedNode:
    """A node with the frames that it computes.

    Parameters
    ----------
    node
        Node to switch on now.
    time
        Time in us in the log of its boot-up message.
    lockstep
        Whether SYNC is the clock of the node.

    Attributes
    ----------
    od
        Object dictionary of the node.
    """

    def __init__(self, node: StimulatorNode, time: int, *, lockstep: bool) -> None:
        self.od = node.od
        self._node = node
        self._clock = node.clock
        self._lockstep = lockstep
        self._last_sent = self._synced = time
        self._waiting: deque[Stamped] = deque()
        self._computed: dict[int, deque[Stamped]] = {}
        self._samples: dict[int, deque[Frame]] = {}
        self._syncs: deque[int] = deque(maxlen=_LACKING_TICKS)
        self._drove = lockstep
        self._half_heard: int | None = None
        self._shutdown: list[Frame] | None = None
        node_id = node.od.node_id
        self._sdo, self._emcy = cia.SDO_TX_ID + node_id, cia.EMCY_ID + node_id
        self._heartbeat = cia.HEARTBEAT_ID + node_id
        self._put(node.start())

    @property
    def sent(self) -> frozenset[int]:
        """Identifiers with which only the node sends."""
        return self._node.ids.sent

    def sends(self, frame: Frame) -> bool:
        """Return whether a frame of the log was sent by the node itself."""
        return frame.can_id in self._node.ids.sent and not frame.rtr

    @property
    def sync_id(self) -> int:
        """Identifier of SYNC in the present configuration of the node."""
        return self._node.ids.sync

    @property
    def boots(self) -> bool:
        """Whether a boot-up message follows from a reset, so that no new process has sent it."""
        return self._shutdown is None and (
            bool(self._computed.get(self._heartbeat))
            or any(reset_command(frame, self.od.node_id) for _, frame in self._waiting)
        )

    @property
    def patience(self) -> int:
        """Ticks within which a node that is there answers, at the end of a log."""
        return 1 if self._lockstep else int(self._node.block.deadline.ms)

    @property
    def is_shut_down(self) -> bool:
        """Whether all frames of a shutdown are in the log; not proven in real time.

        In real time the other frames of a shutdown look like those that a timer sends.
        """
        return self._lockstep and not self._shutdown

    def drives(self, frame: Frame) -> bool:
        """Return whether a frame is a drive."""
        return frame.can_id == _can_id(self.od, cia.TPDO_COMMUNICATION + DRIVE_TPDO - 1)

    def hear(self, time: int, frame: Frame) -> None:
        """Queue a frame of another party."""
        if self._lockstep and frame.can_id == self.sync_id:
            self._hear_all()  # the bench waits for all answers before it sends SYNC
        self._waiting.append((time, frame))
        if len(self._waiting) > _MOST_WAITING and self._owed() is None:
            self._hear_unless_held(self._waiting.popleft())

    def end(self) -> None:
        """Take the end of the log; in lockstep the node has received all of it."""
        if self._lockstep:
            self._hear_all()

    def answer(self, time: int, frame: Frame) -> Frame | None:
        """Return what the node computes for a frame that it has sent; None if nothing.

        Of the frames that it may have received before, as few as explain the frame are used.
        """
        if frame.can_id == self.sync_id and self._node.device.sync.produces:
            self._hear_old(time)
            self._produce()
        self._last_sent = time
        if self._shutdown is not None and frame in self._shutdown:
            self._shutdown.remove(frame)
            return frame
        queue = self._computed.setdefault(frame.can_id, deque())
        if not queue and frame.can_id == self._sdo:
            self._put(self._node.segments(1))
        self._hear_for(frame)
        if not self._lockstep:
            self._pass_time_for(frame, time - self._synced)
        if self._is_sample(frame):
            return frame
        if queue:
            return self._with_own_count(frame, queue.popleft()[1])
        return self._timed().get(frame.can_id)

    def shuts_down(self, drive: Frame) -> bool:
        """Return whether a drive that nothing explains is the first frame of a shutdown.

        If so, `answer` takes the others from now on.
        """
        if not self.drives(drive) or self._shutdown is not None:
            return False
        expected = self._node.shutdown()
        if drive not in expected:
            return False
        expected.remove(drive)
        self._shutdown = expected
        return True

    def clock_decides(self, frame: Frame) -> bool:
        """Return whether a frame, or a computed EMCY, reports what the clock of the node decides.

        Always False in lockstep.
        """
        frames = [frame, *[found for _, found in self._computed.get(self._emcy, ())]]
        codes = {int.from_bytes(f.data[:2], "little") for f in frames if f.can_id == self._emcy}
        return not self._lockstep and not codes.isdisjoint(_BY_CLOCK)

    def overdue(self, ticks: int) -> Frame | None:
        """Return a frame that was computed so many ticks ago or more, and is not in the log."""
        latest = self._clock.now - ticks * TICK_US
        for queue in self._computed.values():
            if queue and queue[0][0] <= latest:
                return queue[0][1]
        return None

    def silence(self, time: int) -> tuple[str, int]:
        """Return why a node is silent at a time in us, and since when; empty if it is not.

        In real time it is silent if it owes an answer to a measurement, or heartbeats. In lockstep
        what it owes is `overdue`.
        """
        if self._lockstep:
            return "", time
        name = f"node {self.od.node_id}"
        owed, period = self._owed(), self.od.number(cia.HEARTBEAT_PRODUCER) * 1000
        if owed is not None and time - owed > self.patience * TICK_US:
            return f"{name} answers no measurement", owed
        if period and time - self._last_sent > _SILENT_HEARTBEATS * period:
            return f"{name} sends nothing", self._last_sent
        return "", time

    def _owed(self) -> int | None:
        """Return the time of the first measurement that waits for its answer; None without one."""
        frames = [frame.can_id for _, frame in self._waiting]
        if not self._drove or cia.NMT_ID in frames:
            return None
        return next((time for time, frame in self._waiting if self._is_measurement(frame)), None)

    def _hear_all(self) -> None:
        while self._waiting:
            self._hear(*self._waiting.popleft())

    def _hear_for(self, frame: Frame) -> None:
        """Receive waiting frames until they explain a frame that the node has sent."""
        held: list[Stamped] = []
        for _ in range(self._reach(frame)):
            if self._explains(frame):
                break
            one = self._waiting.popleft()
            if not self._hear_unless_held(one):
                held.append(one)
        self._waiting.extendleft(reversed(held))

    def _hear_old(self, time: int) -> None:
        """Receive the frames that came before the last 100 SYNCs of the node itself.

        Nothing that it sends may need them, such as the heartbeats of a plate that is not started.
        """
        self._syncs.append(time)
        if len(self._syncs) < _LACKING_TICKS or self._owed() is not None:
            return
        held: list[Stamped] = []
        while self._waiting and self._waiting[0][0] < self._syncs[0]:
            one = self._waiting.popleft()
            if not self._hear_unless_held(one):
                held.append(one)
        self._waiting.extendleft(reversed(held))

    def _hear_unless_held(self, one: Stamped) -> bool:
        """Receive a frame, unless it is a measurement of which no drive has told that it was."""
        if not self._drove and self._is_measurement(one[1]):
            return False
        self._hear(*one)
        return True

    def _reach(self, frame: Frame) -> int:
        """Return how many waiting frames the node may have received before it sent a frame.

        For a drive these are the ones up to the measurement of its tick. If that does not wait, the
        drive was not caused by a measurement, unless its first frame was received before.
        """
        waiting = self._waiting
        if not self.drives(frame):
            return len(waiting)
        last = self._measurement_ids()[-1]
        ends = [place for place, (_, one) in enumerate(waiting) if one.can_id == last]
        tick = self._tick(cia.TPDO_MAPPING + DRIVE_TPDO - 1, Direction.TRANSMIT, frame)
        for place in range(len(waiting) - 1, -1, -1):
            if tick is not None and tick == self._begins_tick(waiting[place][1]):
                end = next((end for end in ends if end > place), place)
                return end + 1 - self._leave_out(place)
        if not ends:
            return len(waiting)
        return ends[0] + (tick is not None and tick == self._half_heard)

    def _leave_out(self, place: int) -> int:
        """Drop the measurements before the first one that was answered; return how many frames."""
        if self._drove:
            return 0
        self._drove = True
        waiting = list(self._waiting)
        before = [one for one in waiting[:place] if not self._is_measurement(one[1])]
        self._waiting = deque([*before, *waiting[place:]])
        return place - len(before)

    def _is_measurement(self, frame: Frame) -> bool:
        return frame.can_id in self._measurement_ids()

    def _measurement_ids(self) -> tuple[int, ...]:
        numbers = (cia.RPDO_COMMUNICATION + rpdo - 1 for rpdo in MEASUREMENT_RPDOS)
        return tuple(_can_id(self.od, number) for number in numbers)

    def _begins_tick(self, frame: Frame) -> int | None:
        """Return the tick of the measurement that a frame begins, modulo that of a drive."""
        if frame.can_id != self._measurement_ids()[0]:
            return None
        return self._tick(cia.RPDO_MAPPING + MEASUREMENT_RPDOS[0] - 1, Direction.RECEIVE, frame)

    def _tick(self, index: int, direction: Direction, frame: Frame) -> int | None:
        """Return the tick in a PDO, modulo that of a drive; None if it has no tick."""
        values = mapped(self.od, index, direction, frame)
        return next((raw % _TICKS for entry, raw in values if entry.name.endswith("Tick")), None)

    def _hear(self, time: int, frame: Frame) -> None:
        if frame.can_id == self.sync_id:
            self._synced = time
            self._put(self._node.advance(TICK_US))
        if (tick := self._begins_tick(frame)) is not None:
            self._half_heard = tick
        elif frame.can_id == self._measurement_ids()[-1]:
            self._half_heard = None
        device = self._node.device
        was = device.nmt_state
        self._put(self._node.receive(frame))
        if was is NMTState.OPERATIONAL is not device.nmt_state:
            self._drove = self._lockstep

    def _produce(self) -> None:
        """Let the node produce its next SYNC; that is a tick later."""
        sync = self._node.device.sync
        while sync.due == NEVER and self._waiting:
            self._hear(*self._waiting.popleft())
        if sync.due != NEVER:
            self._put(self._node.advance(max(0, sync.due - self._clock.now)))

    def _pass_time_for(self, frame: Frame, most: int) -> None:
        """Let up to so many us pass without a SYNC, until a timer explains a frame."""
        end = min(self._clock.now + most, self._node.device.sync.due - 1)
        while self._clock.next_due <= end and not self._explains(frame):
            self._put(self._node.advance(max(0, self._clock.next_due - self._clock.now)))

    def _explains(self, frame: Frame) -> bool:
        """Return whether a frame was computed that the node may have sent as this one."""
        return bool(self._computed.get(frame.can_id)) or self._is_sample(frame)

    def _timed(self) -> dict[int, Frame]:
        """Return the frames that timers of the node may send now, by identifier.

        In lockstep there are none that have to be told apart: their moment is known.
        """
        return {} if self._lockstep else self._node.device.timer_frames()

    def _is_sample(self, frame: Frame) -> bool:
        """Return whether a timer may have sent a frame, with the values of a cycle.

        A later frame cannot have the values of an earlier cycle.
        """
        samples = self._samples.get(frame.can_id)
        if samples and frame in samples:
            while samples[0] != frame:
                samples.popleft()
            return True
        return self._timed().get(frame.can_id) == frame

    def _with_own_count(self, recorded: Frame, computed: Frame) -> Frame:
        """Take from an SDO answer how many deadlines the node has missed by its own clock."""
        entry = self.od[_MISSED]
        if (
            self._lockstep
            or computed.can_id != self._sdo
            or recorded.data[:4] != computed.data[:4]
            or computed.data[0] >> 5 not in INITIATED
            or computed.data[1:4] != entry.index.to_bytes(2, "little") + bytes((entry.subindex,))
        ):
            return computed
        entry.value = int.from_bytes(recorded.data[4:], "little")
        return recorded

    def _put(self, frames: Sequence[Frame]) -> None:
        if not frames:
            return
        timed, sent = self._timed(), self._node.ids.sent
        for frame in frames:
            boots = frame.can_id == self._heartbeat and frame.data == cia.BOOT_UP
            if frame.can_id in sent and (frame.can_id not in timed or boots):
                self._computed.setdefault(frame.can_id, deque()).append((self._clock.now, frame))
        for frame in timed.values():
            samples = self._samples.setdefault(frame.can_id, deque(maxlen=_MOST_SAMPLES))
            if not samples or samples[-1] != frame:
                samples.append(frame)


def _can_id(od: ObjectDictionary, communication: int) -> int:
    return od.number(communication, cia.PDO_COB_ID) & cia.CAN_ID_MASK
