"""A node as the process of a command: its pace, its bus, and its lines on the terminal."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from functools import wraps
from typing import Any, NamedTuple

import click

from smarttac_can.cli.options import BusChoice, Command, with_options
from smarttac_can.cli.state_lines import StateLines
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
from smarttac_can.nodes.plain_node import PlainNode
from smarttac_can.nodes.plate_node import PlateNode
from smarttac_can.nodes.stimulator_node import StimulatorNode
from smarttac_can.vocabulary.signals import SHORT_DEADLINE_MS


class Pace(NamedTuple):
    """What a node follows: SYNC, or the clock, and how punctually."""

    lockstep: bool = False
    priority: int | None = None
    """Of SCHED_FIFO, 1..99; None for an ordinary process."""
    cpu: int | None = None

    def begin(self) -> int | None:
        """Ask the system for what was asked for, and say on stderr what it refuses.

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


lockstep_option = click.option(
    "--lockstep",
    is_flag=True,
    help="Let SYNC be the only clock: for simulated time at any pace.",
)


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


def run_in_process(
    name: str, node: StimulatorNode | PlateNode | PlainNode, bus: BusChoice, pace: Pace
) -> None:
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
