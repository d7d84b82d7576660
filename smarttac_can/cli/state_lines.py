"""One line of text for every change of state of a node, and none per cycle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from smarttac_can.device.nmt import NMTState
from smarttac_can.host.bus import BusError, QueueFullError
from smarttac_can.nodes.plain_node import PlainNode
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.cia import UNCONFIGURED
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

_DOUBLE: Final = 1 << Watchdog.DOUBLE


class StateLines:
    """Writes what state a node is in, as an `Observer` of its run.

    Parameters
    ----------
    name
        What to call it.
    where
        Name of the bus.
    node
        The node.
    say
        Takes a line, and does not wait.
    meanwhile
        Called whenever the run has time.
    """

    def __init__(
        self,
        name: str,
        where: str,
        node: StimulatorNode | PlateNode | PlainNode,
        say: Callable[[str], None],
        meanwhile: Callable[[], None] | None = None,
    ) -> None:
        self._name = name
        self._where = where
        self._say = say
        self._device = node.device
        self._mode = node.od["Mode display"] if isinstance(node, StimulatorNode) else None
        self._diagnosis = _diagnosis(node.od) if isinstance(node, StimulatorNode) else None
        self._plate = node.block if isinstance(node, PlateNode) else None
        self._farewell = "stopped" if isinstance(node, PlainNode) else "stopped at 0 V"
        self._said = self._now()
        self._bit_rate: int | None = None
        self._collision = 0
        self._meanwhile = meanwhile

    def started(self) -> None:
        """Say that the node is ready."""
        self._said = self._now()
        if self._device.storage_torn:
            self._say(
                f"{self._title} has its defaults: the --storage is torn, or of another device"
            )
        self._say(f"{self._title} ready on {self._where}")

    def follow(self) -> None:
        """Say what has changed."""
        if self._meanwhile is not None:
            self._meanwhile()
        if self._device.bit_rate != self._bit_rate:
            self._bit_rate = self._device.bit_rate
            self._say(f"{self._title} {self._bit_rate} kbit/s by LSS: not switched, only stored")
        if self._device.collision != self._collision:
            self._collision = self._device.collision
            self._say(f"{self._title} {self._double}")
        now = self._now()
        if now == self._said:
            return
        state, mode, reason = now
        state_before, mode_before, reason_before = self._said
        self._said = now
        if state != state_before:
            self._say(f"{self._title} {state.name.lower().replace('_', '-')}")
        if mode != mode_before:
            self._say(f"{self._title} mode {Mode(mode).name.lower()}")
        if reason and reason != reason_before:
            self._say(f"{self._title} {reason}")

    def stopped(self) -> None:
        """Say that the node was shut down, a plate at 0 V."""
        self._say(f"{self._title} {self._farewell}")

    def lost(self, reason: BusError) -> None:
        """Say that the bus has failed, and why."""
        self._say(f"{self._title} lost {self._where}, at 0 V: {reason}")

    def back(self) -> None:
        """Say that the bus is there again."""
        self._say(f"{self._title} back on {self._where}")

    def full(self, reason: QueueFullError) -> None:
        """Say that the transmit queue of the bus has no room for a frame of the loop."""
        self._say(f"{self._title} {reason}")

    @property
    def _title(self) -> str:
        node_id = self._device.node_id
        return f"{self._name} {'without node-ID' if node_id == UNCONFIGURED else node_id}"

    @property
    def _double(self) -> str:
        if not self._collision:
            return "alone again with its identifiers"
        cure = (
            ": one producer of SYNC is enough" if self._collision == self._device.ids.sync else ""
        )
        return f"another node sends with an identifier of this one, {self._collision:03X}h{cure}"

    @property
    def _reason(self) -> str:
        """Say why stimulator or front end do not drive; empty if there is nothing to say."""
        if self._plate is not None:
            trouble = self._plate.backend.trouble
            return f"front end: {trouble}" if trouble else ""
        if self._diagnosis is None:
            return ""
        message, first, latched = self._diagnosis
        if not message.value:
            return ""
        code, text = first.value, message.value
        if latched.value & _DOUBLE:
            # It may be noticed after what it has led to, and explains that.
            code, text = WATCHDOGS[Watchdog.DOUBLE].code, WATCHDOGS[Watchdog.DOUBLE].text
        return f"fault {code:04X}h: {text}" if code else str(text)

    def _now(self) -> tuple[NMTState, int, str]:
        mode = self._mode.value if self._mode is not None else 0
        return self._device.nmt_state, mode, self._reason


def _diagnosis(od: ObjectDictionary) -> tuple[Entry, Entry, Entry]:
    return od["Message"], od["Diagnosis.Code"], od["Diagnosis.Latched"]
