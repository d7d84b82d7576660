"""The command that shows a stimulator live: ``watch``."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from importlib.util import find_spec
from typing import Final

import click

from smarttac_can.bench import Stimulator, plate_od, stimulator_od
from smarttac_can.cli.options import BusChoice, stimulator_options
from smarttac_can.cli.plain_errors import plain_errors
from smarttac_can.watch.listener import Listener
from smarttac_can.watch.watcher import Watcher

_BIT_RATE: Final = 1_000_000


@click.command(
    epilog="\b\nExamples:\n  smarttac watch --interface socketcan --channel can0\n"
    "  smarttac watch --interface socketcan --channel can0 --plate-node 33 --drive"
)
@stimulator_options
@click.option("--drive", is_flag=True, help="Start the nodes, and take set-points and a stop key.")
@click.option(
    "--no-sdo",
    is_flag=True,
    help="Send nothing at all: set-points, counts and latched faults are not shown.",
)
def watch(
    *, bus: BusChoice, node_id: int, plate_node: int | None, drive: bool, no_sdo: bool
) -> None:
    """Show a stimulator live in the terminal: friction, drive, state, faults, counts and bus.

    It listens to what the nodes publish, and reads by SDO, seldom and one object at a time, what
    they do not. With --drive it is a bench of its own, watched by its heartbeat: Esc disarms.
    """
    if drive and no_sdo:
        raise click.UsageError("--drive writes by SDO: leave out --no-sdo")
    if find_spec("textual") is None:
        raise click.ClickException("watch needs Textual: pip install 'smarttac-can[watch]'")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise click.ClickException("watch needs a terminal; for a file, take a log of the bus")
    from smarttac_can.watch.screen import WatchScreen  # noqa: PLC0415 - Textual is an extra

    with plain_errors(), ExitStack() as stack:
        watcher = Watcher(
            stimulator_od(node_id),
            None if plate_node is None else plate_od(plate_node),
            bit_rate=bus.bitrate or _BIT_RATE,
            reads=not no_sdo,
        )
        listener = stack.enter_context(Listener(bus.open))
        stimulator = None
        if drive:
            stimulator = Stimulator.connect(
                node_id=node_id, plate_node_id=plate_node, **bus.options
            )
            stack.enter_context(stimulator)
        WatchScreen(watcher, listener, bus.where, stimulator).run()
