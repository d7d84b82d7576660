"""Replay of a log of frames against a stimulator that receives them; no clock, no file."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from operator import itemgetter
from typing import Final, NamedTuple

from smarttac_can.device.frame import Frame
from smarttac_can.device.mapping import Direction, compile_mapping
from smarttac_can.device.nmt import NMTState
from smarttac_can.device.port import NEVER
from smarttac_can.nodes.loop_frames import DRIVE_TPDO, MEASUREMENT_RPDOS
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.cia import (
    BOOT_UP,
    CAN_ID_MASK,
    EMCY_ID,
    FRAME_BYTES,
    HEARTBEAT_ID,
    NMT_ID,
    PDO_COB_ID,
    PDO_COUNT,
    RPDO_COMMUNICATION,
    RPDO_MAPPING,
    SDO_TX_ID,
    TPDO_COMMUNICATION,
    TPDO_MAPPING,
    NMTCommand,
)
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.meanings import emergency_text, meaning, meaning_of_bytes
from smarttac_can.vocabulary.signals import TICK_US

_RESETS: Final = (NMTCommand.RESET_NODE, NMTCommand.RESET_COMMUNICATION)
_LACKING_US: Final = 100_000
"""Time in us after which a due frame that is not in the log counts as missing."""
_BACKWARDS_US: Final = 1_000_000
"""Larger steps back in time are errors; frames that overtake each other differ by much less."""
_SHUTDOWN: Final = 4
"""Frames that a node sends after its last drive, of 0 V, when its process ends."""
LATE_US: Final = 20_000
"""Time in us within which a running process handles a frame, and acts on due timers."""
_STILL_US: Final = 100_000
"""Longer time in us for a process that sends nothing, because it may be paused."""
_CREEP_US: Final = 0.1
"""Most us by which a period of SYNC differs between two clocks: 100 ppm of 1 ms, more than for
quartz clocks."""
Stamped = tuple[int, Frame]
"""A frame with a time of the log in us."""
_MOST_HELD: Final = 300
"""Most frames that are kept: 100 measurements, more than a running process ever misses."""
_TICKS: Final = 1 << 8
"""Modulus of the tick in a drive."""
NOTHING: Final = "nothing"
_INITIATED: Final = (2, 3)
"""Command specifiers of SDO answers that name the object."""
_SERVICES: Final = {EMCY_ID: "EMCY", SDO_TX_ID: "SDO answer", HEARTBEAT_ID: "heartbeat"}


class Field(NamedTuple):
    """A difference in a frame."""

    name: str
    """Name of the object, or of the part of the frame."""
    recorded: str
    recomputed: str


class Difference(NamedTuple):
    """The first frame in which a log and its replay differ."""

    number: int
    """Number of the frame in the log, from 1; if the log lacks a frame, the number before it."""
    time_s: float
    """Time in s since the first frame of the log."""
    what: str
    """Kind of the frame."""
    can_id: int
    recorded: Frame | None
    recomputed: Frame | None
    fields: tuple[Field, ...]
    """Differences; empty if one of the two frames is missing."""

    def __str__(self) -> str:
        """Return the difference in one line."""
        where = f"frame {self.number} at {self.time_s:.6f} s"
        what = f"{self.what} ({self.can_id:03X}h)"
        if self.recorded is None:
            return f"after {where}: the log lacks the {what} that is recomputed there"
        if self.recomputed is None:
            return f"{where}: nothing that the log has makes the node send this {what}"
        shown = [
            f"{f.name} is {f.recorded} in the log, {f.recomputed} recomputed" for f in self.fields
        ]
        return f"{where}, {what}: {'; '.join(shown)}"

    def as_json(self) -> dict[str, object]:
        """Return the difference for JSON."""
        return {
            "frame": self.number,
            "time_s": round(self.time_s, 6),
            "what": self.what,
            "can_id": self.can_id,
            "recorded": None if self.recorded is None else self.recorded.data.hex(),
            "recomputed": None if self.recomputed is None else self.recomputed.data.hex(),
            "objects": [field._asdict() for field in self.fields],
        }


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
        self._boot_up = Frame(HEARTBEAT_ID + node_id, BOOT_UP)
        self._node: ReplayedNode | None = None
        self._keeps = False
        self._seen: set[int] = set()
        self._queued: deque[Stamped] | None = None
        self._doubt: DifferenceError | None = None
        self._doubted = 0
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
            self._first = self._time = time
        elif time < self._time - _BACKWARDS_US:
            raise ValueError(
                f"time runs backwards after frame {self._frames}, at {time * 1e-6:.6f}"
            )
        self._frames += 1
        self._time = time = max(time, self._time)
        node = self._node
        self._seen.add(frame.can_id)
        if node is None:
            self._await_boot_up(frame)
        elif self._doubt is not None:
            self._follow_doubt(node, frame, self._doubt)
        else:
            node.go_on(time)
            if node.sends(frame):
                self._compare(node, frame)
            else:
                node.hear(time, frame)
            if time >= self._looked + _LACKING_US:
                self._looked = time
                self._require_none_lacking(node)

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
        if self._node is None:
            raise ValueError(
                f"no boot-up message of node {node_id}: what the controllers knew before is not in "
                f"a log, so begin it before node {node_id} is switched on, or have it reset (NMT "
                "reset node) while it does not drive"
            )
        if self._doubt is None:
            self._require_none_lacking(self._node)
        if not self._drives:
            raise ValueError(
                f"no drive of node {node_id} after its boot-up message: a replay needs SYNC, the "
                "measurements of the plate node, and the drives"
            )
        return self._so_far()

    def _so_far(self) -> Replayed:
        return Replayed(
            self._frames,
            self._compared,
            self._drives,
            (self._begun - self._first) * 1e-6,
            (self._time - self._first) * 1e-6,
            self._power_ons,
        )

    def _await_boot_up(self, frame: Frame) -> None:
        """Begin with a boot-up, except after a communication reset, which keeps the state."""
        if frame == self._boot_up:
            if not self._keeps:
                self._begun = self._time
                self._switch_on()
                self._hear_queued()
            self._keeps = False
        elif frame.can_id == NMT_ID and len(frame.data) == len(("command", "node-ID")):
            command, node_id = frame.data
            if node_id in (0, self._node_id) and command in _RESETS:
                self._keeps = command == NMTCommand.RESET_COMMUNICATION
                self._queued = deque() if command == NMTCommand.RESET_NODE else None
                return
        if self._queued is not None:
            self._queued.append((self._time, frame))
            while self._queued[0][0] < self._time - LATE_US:
                self._queued.popleft()

    def _hear_queued(self) -> None:
        """Receive the frames after the reset: they waited until the node had booted."""
        node = self._node
        assert node is not None
        for time, frame in self._queued or ():
            if time >= self._time - LATE_US and not node.sends(frame):
                node.hear(self._time, frame)
        self._queued = None

    def _switch_on(self) -> None:
        self._doubt, self._doubted = None, 0
        self._power_ons += 1
        self._node = node = ReplayedNode(self._power_on(), self._time, lockstep=self._lockstep)
        self._compare(node, self._boot_up)

    def _compare(self, node: ReplayedNode, frame: Frame) -> None:
        computed = node.answer(self._time, frame)
        drives = node.drives(frame)
        if computed == frame:
            self._compared += 1
            self._drives += drives
        elif frame == self._boot_up:
            self._switch_on()
        else:
            found = self._differs(node, frame, computed)
            # A process that ends leaves the plate at 0 V, and no frame announces this. If the log
            # has no SYNC at all, it is not one of a loop, and `end` reports that instead.
            if node.sync_id in self._seen and not (drives and drive_voltage(node.od, frame) == 0):
                raise found
            self._doubt = found

    def _follow_doubt(self, node: ReplayedNode, frame: Frame, doubt: DifferenceError) -> None:
        """Accept an unexplained drive of 0 V if only the frames of a shutdown follow."""
        if frame == self._boot_up:
            self._switch_on()
        elif node.sync_id in self._seen and node.sends(frame):
            self._doubted += 1
            if self._doubted > _SHUTDOWN:
                raise doubt

    def _require_none_lacking(self, node: ReplayedNode) -> None:
        lacking = node.overdue(_LACKING_US)
        if lacking is not None:
            raise self._differs(node, None, lacking[1])

    def _differs(
        self, node: ReplayedNode, recorded: Frame | None, computed: Frame | None
    ) -> DifferenceError:
        time_s = (self._time - self._first) * 1e-6
        found = difference(node.od, self._frames, time_s, recorded, computed)
        return DifferenceError(found, self._so_far())


class ReplayedNode:
    """A node with the frames that it computes.

    A log does not tell when the node received a frame of another party. So each frame waits until a
    frame that the node has sent requires it, or until the node has sent one over 20 ms later.

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
        self._offset = float(time)
        self._time = self._last_sent = time
        self._waiting: deque[Stamped] = deque()
        self._computed: dict[int, deque[Stamped]] = {}
        self._first = FirstMeasurements(node.od)
        self._before: deque[tuple[int, dict[int, Frame]]] = deque()
        self._sdo = SDO_TX_ID + node.od.node_id
        self._put(node.start())

    def sends(self, frame: Frame) -> bool:
        """Return whether a frame of the log was sent by the node itself."""
        return frame.can_id in self._node.ids.sent and not frame.rtr

    @property
    def sync_id(self) -> int:
        """Identifier of SYNC in the present configuration of the node."""
        return self._node.ids.sync

    def drives(self, frame: Frame) -> bool:
        """Return whether a frame is a drive."""
        return self._first.is_drive(frame)

    def hear(self, time: int, frame: Frame) -> None:
        """Queue a frame of another party."""
        self._waiting.append((time, frame))

    def go_on(self, time: int) -> None:
        """Advance the time, and do what a process cannot have delayed any longer."""
        self._time = time
        done = max(self._last_sent - LATE_US, time - _STILL_US)
        while self._waiting and self._waiting[0][0] < done:
            self._hear(*self._waiting.popleft())
        if not self._lockstep:
            self._pass_time(self._device_time(done))

    def answer(self, time: int, frame: Frame) -> Frame | None:
        """Return what the node computes for a frame that it has sent; None if nothing.

        Of the frames that it may have received before, as few as explain the frame are used.
        """
        if frame.can_id == self.sync_id and self._node.device.sync.produces:
            self._produce(time)
        self._last_sent = time
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
        return frame if self._timed(frame) else self._node.device.timer_frames().get(frame.can_id)

    def overdue(self, age: int) -> Stamped | None:
        """Return a frame, with its time, that was computed over `age` us ago and is not in the log.

        In lockstep SYNC is the clock for this as well, because a process may pause for any time.
        """
        for queue in self._computed.values():
            if queue and queue[0][0] < self._now - age:
                return queue[0]
        return None

    @property
    def _now(self) -> int:
        return self._clock.now if self._lockstep else self._time

    def _timed(self, frame: Frame) -> bool:
        """Return whether a timer may have sent the frame; its time is then that of the log.

        Always False in lockstep. Such a frame waits for urgent ones of the node, so it may be of an
        earlier cycle.
        """
        if self._lockstep:
            return False
        can_id = frame.can_id
        if self._node.device.timer_frames().get(can_id) == frame:
            return True
        return any(timed.get(can_id) == frame for _, timed in self._before)

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
            self._before.append((time, device.timer_frames()))
            while self._before[0][0] < time - LATE_US:
                self._before.popleft()

    def _device_time(self, time: int) -> int:
        return round(time - self._offset)

    def _await_first(self, drive: Frame) -> None:
        """Put the held measurements among the others, from the one the drive answers."""
        others = [one for one in self._waiting if not self._first.hold(*one)]
        self._waiting = deque(sorted([*self._first.heard(drive), *others], key=itemgetter(0)))

    def _pass_time(self, now: int) -> None:
        """Advance device time, in us, but not beyond the next SYNC that the node produces."""
        now = min(now, self._node.device.sync.due - 1)
        while self._expire(now):
            pass
        self._clock.now = max(self._clock.now, now)

    def _expire(self, end: int) -> bool:
        """Let the next timer expire that is due until `end`; return whether there is one."""
        clock = self._clock
        if clock.next_due > min(end, self._node.device.sync.due - 1):
            return False
        clock.now = max(clock.now, clock.next_due)
        self._act()
        return True

    def _produce(self, time: int) -> None:
        """Let the node produce a SYNC when it is due, or as late as in the log.

        The clock of the node slowly follows the SYNCs of the log, which another clock has stamped.
        """
        while self._waiting and not self._first.undecided:
            self._hear(*self._waiting.popleft())
        due = self._node.device.sync.due
        if due == NEVER:
            return
        late = time - self._offset - due
        self._offset += max(-_CREEP_US, min(late, _CREEP_US))
        self._pass_time(due - 1)
        self._clock.now = max(due, self._device_time(time))
        self._act()

    def _act(self) -> None:
        """Act on what is due now; the log tells when the frames of timers were sent."""
        frames = self._node.advance(0)
        timed = self._node.device.timer_frames()
        self._put([frame for frame in frames if frame.can_id not in timed])

    def _put(self, frames: list[Frame]) -> None:
        sent = self._node.ids.sent
        for frame in frames:
            if frame.can_id in sent:
                self._computed.setdefault(frame.can_id, deque()).append((self._now, frame))


class FirstMeasurements:
    """Holds measurements from the start of a node until its first drive shows which it received.

    The logger may have received the start before a measurement that the node received before it.
    And a filter of the bus of the node may have dropped the first measurements.

    Parameters
    ----------
    od
        Object dictionary of the stimulator.

    Attributes
    ----------
    open
        Whether measurements are held.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self._od = od
        self._held: deque[Stamped] = deque(maxlen=_MOST_HELD)
        self.open = False

    def begin(self) -> None:
        """Hold the measurements from now on."""
        self._held.clear()
        self.open = True

    def hold(self, time: int, frame: Frame) -> bool:
        """Hold a frame if it is a measurement and measurements are held; return whether it was."""
        held = self.open and frame.can_id in map(self._measured, MEASUREMENT_RPDOS)
        if held:
            self._held.append((time, frame))
        return held

    @property
    def undecided(self) -> bool:
        """Whether a measurement is held, so that it is unknown what the node has received since."""
        return self.open and bool(self._held)

    def heard(self, drive: Frame) -> list[Stamped]:
        """Return the held measurements from the one that a drive answers, and stop holding.

        If the drive answers none of them, return an empty list and go on holding.
        """
        tick = self._tick(TPDO_MAPPING + DRIVE_TPDO - 1, Direction.TRANSMIT, drive)
        first = MEASUREMENT_RPDOS[0]
        mapping = RPDO_MAPPING + first - 1
        held = list(self._held)
        for place, (_, frame) in enumerate(held):
            if frame.can_id == self._measured(first) and tick == self._tick(
                mapping, Direction.RECEIVE, frame
            ):
                self.open = False
                return held[place:]
        return []

    def is_drive(self, frame: Frame) -> bool:
        """Return whether a frame has the identifier of the drive."""
        return frame.can_id == self._can_id(TPDO_COMMUNICATION + DRIVE_TPDO - 1)

    def _measured(self, rpdo: int) -> int:
        return self._can_id(RPDO_COMMUNICATION + rpdo - 1)

    def _can_id(self, communication: int) -> int:
        return self._od.number(communication, PDO_COB_ID) & CAN_ID_MASK

    def _tick(self, index: int, direction: Direction, frame: Frame) -> int | None:
        """Return the tick in a PDO, modulo that of a drive; None if it has no tick."""
        values = mapped(self._od, index, direction, frame)
        return next((raw % _TICKS for entry, raw in values if entry.name.endswith("Tick")), None)


def difference(
    od: ObjectDictionary,
    number: int,
    time_s: float,
    recorded: Frame | None,
    recomputed: Frame | None,
) -> Difference:
    """Return the difference of two frames with one identifier, one of which may be missing.

    Parameters
    ----------
    od
        Object dictionary of the node in its present state.
    number, time_s
        Number and time in s in the log.
    recorded, recomputed
        Frame in the log, and frame of the replay.
    """
    frame = recorded or recomputed
    assert frame is not None
    tpdo = _tpdo(od, frame.can_id)
    if tpdo:
        what = f"drive, TPDO {tpdo}" if tpdo == DRIVE_TPDO else f"TPDO {tpdo}"
    elif frame.can_id == od.sync_id:
        what = "SYNC"
    else:
        what = _SERVICES.get(frame.can_id - od.node_id, "frame")
    fields: tuple[Field, ...] = ()
    if recorded is not None and recomputed is not None:
        fields = tuple(_fields(od, tpdo, recorded, recomputed)) or (_bytes(recorded, recomputed),)
    return Difference(number, time_s, what, frame.can_id, recorded, recomputed, fields)


def drive_voltage(od: ObjectDictionary, frame: Frame) -> int | None:
    """Return the raw voltage of a drive; None if it has another length."""
    values = mapped(od, TPDO_MAPPING + DRIVE_TPDO - 1, Direction.TRANSMIT, frame)
    return next((raw for entry, raw in values if entry.name.endswith("Voltage")), None)


def _tpdo(od: ObjectDictionary, can_id: int) -> int:
    """Return the number of the TPDO with an identifier; 0 if there is none."""
    for number in range(1, PDO_COUNT + 1):
        communication = od.get(TPDO_COMMUNICATION + number - 1, PDO_COB_ID)
        if communication is None:
            return 0
        if communication.value & CAN_ID_MASK == can_id:
            return number
    return 0


def mapped(
    od: ObjectDictionary, index: int, direction: Direction, frame: Frame
) -> list[tuple[Entry, int]]:
    """Return the entries that a PDO maps, with their raw values; [] if the length differs."""
    mapping = compile_mapping(od, index, direction)
    if mapping.size != len(frame.data):
        return []
    return list(zip(mapping.entries, mapping.read(frame.data), strict=True))


def _fields(od: ObjectDictionary, tpdo: int, recorded: Frame, recomputed: Frame) -> Iterator[Field]:
    if tpdo:
        index = TPDO_MAPPING + tpdo - 1
        both = [mapped(od, index, Direction.TRANSMIT, frame) for frame in (recorded, recomputed)]
        for (entry, there), (_, here) in zip(*both, strict=False):
            if there != here:
                yield Field(entry.name, meaning(entry, there), meaning(entry, here))
    elif len(recorded.data) == len(recomputed.data) == FRAME_BYTES:
        if recorded.can_id == EMCY_ID + od.node_id:
            yield Field("error", _emergency(recorded), _emergency(recomputed))
        elif recorded.data[:4] == recomputed.data[:4] and recorded.data[0] >> 5 in _INITIATED:
            yield from _read_field(od, recorded, recomputed)


def _read_field(od: ObjectDictionary, recorded: Frame, recomputed: Frame) -> Iterator[Field]:
    entry = od.get(recorded.data[1] | recorded.data[2] << 8, recorded.data[3])
    if entry is None:
        return
    there, here = (meaning_of_bytes(entry, frame.data[4:]) for frame in (recorded, recomputed))
    yield Field(entry.name, there, here)


def _bytes(recorded: Frame, recomputed: Frame) -> Field:
    there, here = recorded.data.hex(), recomputed.data.hex()
    return Field("it", there or NOTHING, here or NOTHING)


def _emergency(frame: Frame) -> str:
    code = int.from_bytes(frame.data[:2], "little")
    return f"{code:04X}h, {emergency_text(code)} ({frame.data.hex()})"
