"""A log of frames, frame by frame, against a stimulator that hears it; no clock, no file."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

from smarttac_can.device.frame import Frame
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.cia import BOOT_UP, HEARTBEAT_ID, NMT_ID, NMTCommand
from smarttac_can.replay.difference import Difference, difference, drive_voltage
from smarttac_can.replay.first_measurements import Stamped
from smarttac_can.replay.replayed_node import LATE_US, ReplayedNode

_RESETS: Final = (NMTCommand.RESET_NODE, NMTCommand.RESET_COMMUNICATION)
_LACKING_US: Final = 100_000
"""A frame that is not in the log so long after it was due is not in the log."""
_BACKWARDS_US: Final = 1_000_000
"""Stamps of frames that cross one another may be out of order, by much less."""
_FAREWELL: Final = 4
"""Frames that a node sends behind its last drive, of 0 V, when its process ends."""


class Replayed(NamedTuple):
    """What was compared."""

    frames: int
    """Frames of the log."""
    compared: int
    """Those of the node that were recomputed and are the same."""
    drives: int
    """Drives among them, one a cycle."""
    begun_s: float
    """When the first boot-up message came, since the first frame of the log."""
    ended_s: float
    """When the last frame came."""
    power_ons: int
    """How often the node was switched on."""


class DifferenceError(ValueError):
    """A log is not what its replay gives.

    Attributes
    ----------
    difference
        The first one.
    so_far
        What was compared before.
    """

    def __init__(self, difference: Difference, so_far: Replayed) -> None:
        super().__init__(str(difference))
        self.difference = difference
        self.so_far = so_far


class Replay:
    """Compares the frames of a log, given one after the other.

    The node begins with its boot-up message, from when on the log says all that it heard.

    Parameters
    ----------
    power_on
        Makes the node, as its process did at that time.
    node_id
        Its node-ID.
    lockstep
        Whether SYNC was its clock.
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
        """Take the next frame of the log, with its time stamp in us.

        Raises
        ------
        DifferenceError
            If the node sent it and computes another, or none; or if the log lacks one.
        ValueError
            If time runs backwards.
        """
        if not self._frames:
            self._first = self._time = time
        elif time < self._time - _BACKWARDS_US:
            raise ValueError(
                f"time runs backwards behind frame {self._frames}, at {time * 1e-6:.6f}"
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
        """Return what was compared, at the end of the log.

        Raises
        ------
        DifferenceError
            If the log lacks a frame.
        ValueError
            If nothing of the loop was compared, with what the log needs.
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
        """Begin with a boot-up, but for that of a reset communication, which keeps the rest."""
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
        """Hear what came behind the reset: it waited until the node had booted."""
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
            # Who ends a process leaves the plate at 0 V, and no frame says that this was so. And
            # a log without any SYNC is no log of a loop: that is what to say of it.
            if node.sync_id in self._seen and not (drives and drive_voltage(node.od, frame) == 0):
                raise found
            self._doubt = found

    def _follow_doubt(self, node: ReplayedNode, frame: Frame, doubt: DifferenceError) -> None:
        """Believe a drive of 0 V that nothing explains, if the node says little more than that."""
        if frame == self._boot_up:
            self._switch_on()
        elif node.sync_id in self._seen and node.sends(frame):
            self._doubted += 1
            if self._doubted > _FAREWELL:
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
