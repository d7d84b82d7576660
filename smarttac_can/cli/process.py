"""A node as the process of a command: its pace, its bus, and its lines on the terminal."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from functools import wraps
from typing import Any, Final, NamedTuple

import click

from smarttac_can.cli.shared import BusChoice, Command, lockstep_option, with_options
from smarttac_can.device.nmt import NMTState
from smarttac_can.host.bus import BusError, QueueFullError
from smarttac_can.host.process_signals import stop_on_signals
from smarttac_can.host.realtime import (
    collecting_between_cycles,
    keep_processors_awake,
    request_real_time,
    request_short_slices,
)
from smarttac_can.host.reconnecting_bus import ReconnectingBus
from smarttac_can.host.runner import run_node
from smarttac_can.host.terminal import LineWriter
from smarttac_can.nodes.device_node import DeviceNode
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.od.cia import UNCONFIGURED
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry
from smarttac_can.vocabulary.modes import Mode
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog

_DOUBLE: Final = 1 << Watchdog.DOUBLE


class StateLines:
    """Writes what state a node is in, as an `Observer` of its run: a line for every change.

    Parameters
    ----------
    name
        What to call it.
    where
        Name of the bus.
    node
        The node.
    write
        Takes a line, and does not wait.
    meanwhile
        Called when the run has time, and each 50 ms at least.
    """

    def __init__(
        self,
        name: str,
        where: str,
        node: DeviceNode,
        write: Callable[[str], None],
        meanwhile: Callable[[], None] | None = None,
    ) -> None:
        self._name = name
        self._where = where
        self._write = write
        self._device = node.device
        self._mode = node.od["Mode display"] if isinstance(node, StimulatorNode) else None
        self._diagnosis = _diagnosis(node.od) if isinstance(node, StimulatorNode) else None
        self._plate = node.block if isinstance(node, PlateNode) else None
        self._shut_down = "stopped" if type(node) is DeviceNode else "stopped at 0 V"
        self._shown = self._now()
        self._bit_rate: int | None = None
        self._collision = 0
        self._meanwhile = meanwhile

    def started(self) -> None:
        """Report that the node is ready."""
        self._shown = self._now()
        if self._device.storage_torn:
            self._write(
                f"{self._title} has its defaults: the --storage is torn, or of another device"
            )
        self._write(f"{self._title} ready on {self._where}")

    def follow(self) -> None:
        """Report what has changed."""
        if self._meanwhile is not None:
            self._meanwhile()
        if self._device.bit_rate != self._bit_rate:
            self._bit_rate = self._device.bit_rate
            self._write(f"{self._title} {self._bit_rate} kbit/s by LSS: not switched, only stored")
        if self._device.collision != self._collision:
            self._collision = self._device.collision
            self._write(f"{self._title} {self._double}")
        now = self._now()
        if now == self._shown:
            return
        state, mode, reason = now
        state_before, mode_before, reason_before = self._shown
        self._shown = now
        if state != state_before:
            self._write(f"{self._title} {state.name.lower().replace('_', '-')}")
        if mode != mode_before:
            self._write(f"{self._title} mode {Mode(mode).name.lower()}")
        if reason and reason != reason_before:
            self._write(f"{self._title} {reason}")

    def stopped(self) -> None:
        """Report that the node was shut down, a plate at 0 V."""
        self._write(f"{self._title} {self._shut_down}")

    def lost(self, reason: BusError) -> None:
        """Report that the bus has failed, and why."""
        self._write(f"{self._title} lost {self._where}, at 0 V: {reason}")

    def back(self) -> None:
        """Report that the bus is there again."""
        self._write(f"{self._title} back on {self._where}")

    def full(self, reason: QueueFullError) -> None:
        """Report that the transmit queue of the bus has no room for a frame of the loop."""
        self._write(f"{self._title} {reason}")

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
        """Why stimulator or front end do not drive; empty if they can."""
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


class Pace(NamedTuple):
    """What a node follows: SYNC, or the clock, and how punctually."""

    lockstep: bool = False
    priority: int | None = None
    """Of SCHED_FIFO, 1..99; None for an ordinary process."""
    cpu: int | None = None

    def begin(self) -> int | None:
        """Ask the system for what was asked for, and report on stderr what it refuses.

        Raises
        ------
        click.BadParameter
            If there is no such processor.

        Returns
        -------
        int or None
            Default in ms for the deadlines of a loop over the bus; None for that of the EDS.
        """
        if self.lockstep:
            return SHORT_DEADLINE_MS
        if self.priority is None:
            request_short_slices()
            return None
        try:
            refused = request_real_time(self.priority, self.cpu)
        except ValueError as error:
            raise click.BadParameter(f"--cpu: {error}") from error
        for line in refused or keep_processors_awake():
            click.echo(line, err=True)
        if refused:
            request_short_slices()
            return None
        return SHORT_DEADLINE_MS


def pace_options(command: Command) -> Command:
    """Give a command the options of the pace; it is called with ``pace``, a `Pace`."""

    @wraps(command)
    def called(
        *args: Any, lockstep: bool, realtime: int | None, cpu: int | None, **others: Any
    ) -> Any:
        if lockstep and realtime is not None:
            raise click.UsageError(
                "--realtime follows the clock, --lockstep does not: leave out one"
            )
        if cpu is not None and realtime is None:
            raise click.UsageError("--cpu is for --realtime PRIORITY: none is given")
        return command(*args, pace=Pace(lockstep, realtime, cpu), **others)

    return with_options(
        lockstep_option,
        click.option(
            "--realtime",
            type=click.IntRange(1, 99),
            metavar="PRIORITY",
            help="Run at this priority of SCHED_FIFO, 1..99, with the memory locked, processors"
            f" kept awake and deadlines of {SHORT_DEADLINE_MS} ms. Needs CAP_SYS_NICE, or rtprio in"
            " limits.conf.",
        ),
        click.option(
            "--cpu",
            type=click.IntRange(min=0),
            metavar="N",
            help="Stay on this processor, with --realtime.",
        ),
    )(called)


def run_in_process(name: str, node: DeviceNode, bus: BusChoice, pace: Pace) -> None:
    """Run a node until a signal ends it, with a line on stdout for each change of its state."""
    with ExitStack() as stack:
        stop = stack.enter_context(stop_on_signals())
        writer = stack.enter_context(LineWriter(_stdout()))
        meanwhile = None
        if not pace.lockstep:
            meanwhile = stack.enter_context(collecting_between_cycles())
        lines = StateLines(name, bus.where, node, writer.say, meanwhile)
        lasting = ReconnectingBus(bus.open, node, lost=lines.lost, back=lines.back)
        run_node(
            node,
            lasting,
            stop,
            lockstep=pace.lockstep,
            observer=lines,
            resting=pace.priority is not None,
        )


def _stdout() -> int:
    """Return the descriptor of stdout; one that swallows everything where there is none."""
    try:
        return sys.stdout.fileno()
    except (OSError, AttributeError, ValueError):
        return os.open(os.devnull, os.O_WRONLY)
